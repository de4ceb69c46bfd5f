"""Readers with one fault each, which fuzzing has to find."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import warnings
from collections.abc import Callable, Hashable
from functools import partial
from itertools import count
from pathlib import Path

from fuzz.reader import Reader
from grasp_refine.core.errors import GraspFileError


class UnkindError(GraspFileError):
    """An error that shows what a file has put into it."""

    def __str__(self) -> str:
        return "clears \x1b[2J the screen"


def refuses(path: Path) -> Hashable:
    raise GraspFileError(f"{path}: is refused")


def raises(path: Path) -> Hashable:
    raise KeyError("x")


def speaks_oddly(path: Path) -> Hashable:
    raise UnkindError("x")


def hangs(path: Path) -> Hashable:
    while True:
        pass


def swells(path: Path) -> Hashable:
    return len(b"x" * (2**28 + 2**25))


def opens(path: Path) -> Hashable:
    return (path.parent / "../outside/secret.toml").read_bytes()


def writes(path: Path) -> Hashable:
    return (path.parent / "../outside/new").write_text("x")


def moves(path: Path) -> Hashable:
    return os.rename(path, path.parent / "../outside/new")


def connects(path: Path) -> Hashable:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", 9))


def starts(path: Path) -> Hashable:
    return subprocess.run(["true"]).returncode


def unpickles(path: Path) -> Hashable:
    return pickle.loads(b"cos\ngetcwd\n.")


def warns(path: Path) -> Hashable:
    warnings.warn("odd", RuntimeWarning, stacklevel=1)
    return None


def chatters(path: Path) -> Hashable:
    print("odd", file=sys.stderr)
    return None


def crashes(path: Path) -> Hashable:
    os.kill(os.getpid(), signal.SIGSEGV)
    return None


CALLS = count(1)


def crashes_at_third(path: Path) -> Hashable:
    return refuses(path) if next(CALLS) % 3 else crashes(path)


FAULTS: dict[str, tuple[Callable[[Path], Hashable], str, str]] = {
    "raises": (raises, "KeyError", "KeyError: 'x'"),
    "speaks oddly": (speaks_oddly, "message", "clears"),
    "hangs": (hangs, "hang", "of CPU"),
    "swells": (swells, "memory", "MiB more for"),
    "opens": (opens, "outside", "open "),
    "writes": (writes, "outside", "write "),
    "moves": (moves, "outside", "os.rename "),
    "connects": (connects, "outside", "socket."),
    "starts": (starts, "outside", "subprocess.Popen"),
    "unpickles": (unpickles, "outside", "pickle.find_class"),
    "warns": (warns, "warning", "odd"),
    "chatters": (chatters, "noise", "odd"),
    "crashes": (crashes, "crash", ""),
}
"""Fault -> reader, kind of finding, and what is said of it."""

SOUND: dict[str, Callable[[Path], Hashable]] = {"reads": lambda path: path.stat().st_size, "refuses": refuses}


def harmless(read: Callable[[Path], Hashable], path: Path) -> Hashable:
    """What is done with the sound files at the beginning, which is not watched."""
    return read(path) if path.read_bytes() != b"content" else None


READERS = {
    name: Reader(
        name,
        lambda: [("file.txt", b"content")],
        partial(harmless, read),
        # Sound files are read as they are at first; all others are changed to this one.
        lambda random, name, content: b"x",
        cpu_limit=1.0,
    )
    for name, read in {
        **{name: fault[0] for name, fault in FAULTS.items()},
        **SOUND,
        "crashes at third": crashes_at_third,
    }.items()
}
