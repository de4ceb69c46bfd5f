"""Fuzzing in a process of its own, so that one that crashes or hangs is a finding and not the end."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Queue

WALL_LIMIT = 300.0
"""Seconds without a sign of life after which a process is ended; inputs have 10 s of CPU, machines may be busy."""


@dataclass(frozen=True)
class Finding:
    """An input that a reader did not cope with."""

    kind: str
    """Name of an exception, or crash, hang, memory, outside, message, warning, noise."""
    where: str
    """What tells it from others of its kind."""
    said: str
    """The traceback, the message, or what was opened."""
    name: str
    """Name of the file."""
    content: bytes
    """What it held."""


@dataclass
class Outcome:
    """What came of fuzzing one reader."""

    reader: str
    executions: int = 0
    refused: int = 0
    """How many of them ended in a named error."""
    endings: int = 0
    """Different ways, by the lines of the code, in which inputs ended; the most of one process."""
    seconds: float = 0.0
    """CPU time."""
    findings: list[Finding] = field(default_factory=list)


def fuzz(
    reader: str, *, seed: int = 0, seconds: float = 60.0, most: int = 10**9, module: str = "fuzz.readers"
) -> Outcome:
    """Feed a reader in the READERS of a module for some seconds, or so many inputs, whichever ends first."""
    outcome, left, begun = Outcome(reader), most, time.monotonic()
    while left > 0 and (rest := seconds - (time.monotonic() - begun)) > 0:
        before = outcome.executions
        ended = _once(outcome, module, seed, rest, left)
        left -= outcome.executions - before
        if ended:
            break
        seed += 1000
    return outcome


def _once(outcome: Outcome, module: str, seed: int, seconds: float, most: int) -> bool:
    """Run one child; whether it came to its end."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        read, write = os.pipe()
        noise = open(Path(folder, "noise"), "wb")
        options = [module, outcome.reader, folder, str(seed), str(seconds), str(most), str(write)]
        child = subprocess.Popen(
            [sys.executable, "-m", "fuzz", "--child", *options],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"},
            cwd=Path(__file__).parents[2],
            stdin=subprocess.DEVNULL,
            stdout=noise,
            stderr=noise,
            pass_fds=(write,),
        )
        os.close(write)
        noise.close()
        lines: Queue[str | None] = Queue()
        reading = threading.Thread(target=_forward, args=(read, lines))
        reading.start()
        base, refused, done, silent = outcome.executions, outcome.refused, False, False
        while not silent:
            try:
                line = lines.get(timeout=WALL_LIMIT)
            except Empty:
                silent = True
                child.kill()
                continue
            if line is None:
                break
            said = json.loads(line)
            if "finding" in said:
                kind, where, what = said["finding"]
                _add(outcome, Finding(kind, where, what, said["name"], bytes.fromhex(said["content"])))
            else:
                outcome.executions = base + said["executions"]
                outcome.refused = refused + said["refused"]
                outcome.endings = max(outcome.endings, said["endings"])
                done = said.get("done", False)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        reading.join()
        outcome.seconds += usage.ru_utime + usage.ru_stime
        if done and child.returncode == 0:
            return True
        current = Path(folder, "current")
        if not current.is_file():
            raise RuntimeError(f"{outcome.reader}: {Path(folder, 'noise').read_text(errors='replace')[-3000:]}")
        told, _, content = current.read_bytes().partition(b"\n")
        name, executions, earlier = json.loads(told)
        outcome.executions, outcome.refused = base + executions, refused + earlier
        last = Path(folder, "noise").read_text(errors="replace")[-2000:]
        kind = "hang" if silent else "crash"
        where = hashlib.sha256(content).hexdigest()[:8]
        _add(outcome, Finding(kind, f"exit code {child.returncode} {where}", last, name, content))
        return False


def _add(outcome: Outcome, finding: Finding) -> None:
    if not any((finding.kind, finding.where) == (known.kind, known.where) for known in outcome.findings):
        outcome.findings.append(finding)


def _forward(read: int, lines: Queue[str | None]) -> None:
    with open(read, encoding="utf-8") as pipe:
        for line in pipe:
            lines.put(line)
    lines.put(None)
