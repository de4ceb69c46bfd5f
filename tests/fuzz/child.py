"""The process that reads changed files, one after the other, and judges each: a result, a named error, or a finding."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import sysconfig
import tempfile
import time
import traceback
import warnings
from collections.abc import Hashable, Sequence
from pathlib import Path
from random import Random
from typing import Any

from fuzz.mutations import LARGEST_INPUT, changed_bytes
from fuzz.reader import Reader, secrets
from grasp_refine.core.errors import GraspRefineError

MEMORY_LIMIT = 2**28
"""Bytes by which the memory that is held may grow with one input."""
ADDRESSES = 2**33
"""Bytes of addresses that the process may have, so that nothing else on the machine suffers."""
LARGEST_CORPUS = 400
"""Inputs that showed something new are changed further; so many are kept."""
LONGEST_MESSAGE = 4000
"""Letters of a message."""

NEVER = ("socket.", "subprocess.", "os.system", "os.exec", "os.spawn", "os.posix_spawn", "os.fork", "pty.", "urllib.")
"""Events of Python that no reader may cause: connections and programs."""
NEVER += ("pickle.find_class", "ctypes.dlopen", "ftplib.", "http.client.", "code.__new__", "webbrowser.")
CHANGING = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.chmod", "os.truncate")
"""Events that change files, which only the folder of the reader may see."""


class Hang(BaseException):
    """An input takes longer than it may."""


class Watch:
    """Hears what Python opens and starts, and notes what a reader may not."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader, self.folder = reader, folder.resolve()
        places = [*sysconfig.get_paths().values(), sys.base_prefix, *sys.path, str(Path(__file__).parents[2])]
        self.installed = tuple({str(Path(place).resolve()) for place in places if place} - {"/"})
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self.hear)

    def hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        # Whatever is looked at here must not be heard again.
        self.on = False
        try:
            if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
                writes = isinstance(arguments[1], str) and set(arguments[1]) & set("wxa+")
                writes = writes or (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR))
                if not self.may(os.fsdecode(arguments[0]), bool(writes)):
                    self.seen.append(f"{'write' if writes else 'open'} {os.fsdecode(arguments[0])[:200]}")
            elif event.startswith(NEVER) and not (event == "subprocess.Popen" and self.reader.starts_programs):
                self.seen.append(f"{event} {str(arguments)[:200]}")
            elif event.startswith(CHANGING):
                # What is moved or linked has a second name, where it goes.
                names = [os.fsdecode(name) for name in arguments[:2] if isinstance(name, str | bytes | os.PathLike)]
                if not all(self.may(name, True) for name in names):
                    self.seen.append(f"{event} {' '.join(names)[:200]}")
        finally:
            self.on = True

    def may(self, name: str, writes: bool) -> bool:
        """Whether a file may be opened."""
        path = Path(os.path.realpath(name))
        if path.is_relative_to(self.folder) or str(path) in ("/dev/null", "/dev/urandom"):
            return True
        known = any(path.is_relative_to(place) for place in self.installed)
        system = str(path).startswith(("/proc/", "/sys/", "/usr/share/zoneinfo"))
        return not writes and (known or system or self.reader.beyond(path))


class Judge:
    """Reads inputs in a folder and tells what is wrong with how that ends."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader, self.folder = reader, folder / "here"
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        secrets(folder / "outside")
        reader.prepare(self.folder)
        os.chdir(self.folder)
        # Folders for intermediate files, such as CoACD's, are to lie in it, too.
        tempfile.tempdir = str(self.folder)
        os.environ["GRASP_REFINE_CACHE"] = str(self.folder / "cache")
        os.environ["HOME"] = str(self.folder)
        self.watch = Watch(reader, self.folder)
        self.noise = os.fstat(2).st_size

    def warm_up(self) -> None:
        """Read the sound files, so that all modules are there."""
        for name, content in self.reader.seeds():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_bytes(content)
            with contextlib.suppress(GraspRefineError):
                self.reader.read(self.folder / name)
            (self.folder / name).unlink(missing_ok=True)
        self.noise = os.fstat(2).st_size

    def judged(self, name: str, content: bytes) -> tuple[Hashable, list[tuple[str, str, str]]]:
        """What kind of ending it is, and findings: kind, where, and what was said."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        before = _memory("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        findings: list[tuple[str, str, str]] = []
        self.watch.seen = []
        ending: Hashable
        warned: list[tuple[str, str]] = []

        def warn(message: Warning, category: type[Warning], filename: str, line: int, *_: Any) -> None:
            frames = [frame for frame in traceback.extract_stack() if "grasp_refine" in frame.filename]
            place = frames[-1] if frames else traceback.FrameSummary(filename, line, "")
            warned.append((f"{Path(place.filename).name}:{place.lineno}", f"{filename}:{line}: {message}"))

        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = warn
            signal.setitimer(signal.ITIMER_PROF, self.reader.cpu_limit)
            self.watch.on = True
            try:
                ending = ("read", self.reader.read(path))
            except GraspRefineError as error:
                ending = ("refused", type(error).__name__, _way(error))
                findings += _faults(str(error))
            except (Exception, Hang) as error:
                ending = ("finding", type(error).__name__, _way(error))
                said = "".join(traceback.format_exception(error))[-3000:]
                findings.append(("hang" if isinstance(error, Hang) else type(error).__name__, _last(error), said))
            finally:
                self.watch.on = False
                signal.setitimer(signal.ITIMER_PROF, 0)
        findings += [("outside", re.sub(r"[0-9a-f]{6,}", "", seen)[:60], seen) for seen in self.watch.seen]
        findings += [("warning", *said) for said in warned]
        grown = _memory("VmHWM") - before
        if grown > MEMORY_LIMIT:
            findings.append(("memory", "", f"{grown / 2**20:.0f} MiB more for {len(content)} bytes"))
        sys.stdout.flush()
        sys.stderr.flush()
        if (said := os.fstat(2).st_size) != self.noise:
            text = Path("/proc/self/fd/2").read_bytes()[self.noise :][:500].decode(errors="replace")
            findings.append(("noise", re.sub(r"\d+", "", text)[:40], text))
            self.noise = said
        path.unlink(missing_ok=True)
        return ending, findings


def _memory(key: str) -> int:
    """What Linux says of the memory of this process, in bytes: now VmRSS, at most VmHWM."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(f"{key}:")]
    return int(line.split()[1]) * 1024


def _faults(message: str) -> list[tuple[str, str, str]]:
    """What is wrong with a message to a person."""
    where = re.sub(r"\W.*", "", message.partition(": ")[2])[:30]
    if not message.isprintable():
        return [("message", f"{where} unprintable", ascii(message[:500]))]
    if not message:
        return [("message", "empty", "")]
    return [("message", f"{where} long", message[:500])] if len(message) > LONGEST_MESSAGE else []


def _way(error: BaseException | None) -> Hashable:
    """The lines that lead to an error and to what caused it."""
    way = []
    while error is not None:
        way += [(frame.f_code.co_name, line) for frame, line in traceback.walk_tb(error.__traceback__)]
        error = error.__cause__ or error.__context__
    # Recursion as deep as a file is no other way.
    return tuple(dict.fromkeys(way))


def _last(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "grasp_refine" in frame.filename] or frames
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"


def drawn(reader: Reader, random: Random, corpus: Sequence[tuple[str, bytes]], roots: int) -> tuple[str, bytes]:
    """A changed one of some files, of which so many at the beginning are sound."""
    name, content = corpus[random.randrange(len(corpus)) if random.random() < 0.6 else random.randrange(roots)]
    kind = random.random()
    if kind < 0.75:
        # A change may not be possible: NumPy, for instance, stores no 40 lists within each other.
        with contextlib.suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content = reader.change(random, name, content)[:LARGEST_INPUT]
    if kind > 0.6:
        others = [data for other, data in corpus if Path(other).suffix == Path(name).suffix]
        content = changed_bytes(random, content, reader.words, others)
    return name, content


def run(reader: Reader, folder: Path, seed: int, seconds: float, most: int) -> None:
    """Read changed files for so many seconds or so many times.

    `folder` gets the file `findings`, a line of JSON for each, and `current`: name, number of executions, of refusals
    and of different endings, and the contents of the last input.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**28, 2**28))

    def too_long(*_: Any) -> None:
        raise Hang(f"more than {reader.cpu_limit:g} s of CPU")

    signal.signal(signal.SIGPROF, too_long)
    random = Random(f"{reader.name} {seed}")
    judge = Judge(reader, folder)
    judge.warm_up()
    corpus = list(reader.seeds())
    roots = len(corpus)
    known: set[Hashable] = set()
    reported: set[tuple[str, str]] = set()
    start = time.monotonic()
    refused = executions = 0
    with (folder / "findings").open("w", encoding="utf-8") as report:
        while executions < most and time.monotonic() - start < seconds:
            name, content = drawn(reader, random, corpus, roots)
            executions += 1
            state = folder / "current"
            state.write_bytes(json.dumps([name, executions, refused, len(known)]).encode() + b"\n" + content)
            ending, findings = judge.judged(name, content)
            refused += isinstance(ending, tuple) and ending[0] == "refused"
            if ending not in known and len(corpus) < LARGEST_CORPUS:
                known.add(ending)
                corpus.append((name, content))
            for kind, where, details in findings:
                if (kind, where) not in reported:
                    reported.add((kind, where))
                    found = {"kind": kind, "where": where, "details": details, "name": name, "content": content.hex()}
                    report.write(json.dumps(found) + "\n")
                    report.flush()
            state.write_bytes(json.dumps([name, executions, refused, len(known)]).encode() + b"\n" + content)
