"""A reader with one fault after the other, which fuzzing has to find, and one that crashes."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Hashable
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


def shows_control_characters(path: Path) -> Hashable:
    raise UnkindError("x")


def hangs(path: Path) -> Hashable:
    while True:
        pass


def crashes(path: Path) -> Hashable:
    os.kill(os.getpid(), signal.SIGSEGV)
    time.sleep(60.0)


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "KeyError": (raises, "KeyError: 'x'"),
    "message": (shows_control_characters, "clears"),
    "hang": (hangs, "of CPU"),
    "memory": (lambda path: len(b"x" * (2**28 + 2**25)), "MiB more for"),
    "outside open": (lambda path: (path.parent / "../outside/secret.toml").read_bytes(), "open "),
    "outside write": (lambda path: (path.parent / "../outside/new").write_text("x"), "write "),
    "outside rename": (lambda path: os.rename(path, path.parent / "../outside/new"), "os.rename "),
    "outside socket": (lambda path: socket.socket().close(), "socket."),
    "outside process": (lambda path: subprocess.run(["true"]).returncode, "subprocess.Popen"),
    "outside pickle": (lambda path: pickle.loads(b"cos\ngetcwd\n."), "pickle.find_class"),
    "warning": (lambda path: warnings.warn("odd", RuntimeWarning, stacklevel=1), "odd"),
    "noise": (lambda path: print("odd", file=sys.stderr), "odd"),
}
"""Kind of finding, with what tells it from others of its kind -> fault, and what the finding names."""

SOUND: tuple[Callable[[Path], object], ...] = (lambda path: path.stat().st_size, refuses)
CALLS = count()


def one_after_the_other(path: Path) -> Hashable:
    """Each fault, then what is sound; a seed, which is read at the beginning and not watched, is sound too."""
    functions = [*(fault for fault, _ in FAULTS.values()), *SOUND]
    return None if path.read_bytes() == b"seed" else str(functions[next(CALLS) % len(functions)](path))


def crashing(path: Path) -> Hashable:
    """Two are refused, the third ends the process."""
    return None if path.read_bytes() == b"seed" else refuses(path) if next(CALLS) < 2 else crashes(path)


READERS = {
    name: Reader(name, lambda: [("file.txt", b"seed")], read, lambda random, name, content: b"x", cpu_limit=1.0)
    for name, read in (("faulty", one_after_the_other), ("crashing", crashing))
}
