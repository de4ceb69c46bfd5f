"""Files that appear whole or not at all."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError

_BETWEEN = ".partial."
"""What stands in the names of files that are being written between the process and the machine."""


def half_written_path(path: Path) -> Path:
    """Where this process writes what shall lie at `path`."""
    return path.with_name(f".{os.getpid()}{_BETWEEN}{_here()}.{path.name}")


def half_written(name: str) -> tuple[int | None, str]:
    """The process of this machine that wrote such a file, and what it would be called; None: it is none."""
    pid, between, rest = name.removeprefix(".").partition(_BETWEEN)
    host, _, whole = rest.partition(".")
    ours = name.startswith(".") and between and pid.isdecimal() and host == _here()
    return (int(pid), whole) if ours else (None, name)


def _here() -> str:
    """This machine: several may write into one folder, and have processes of the same number."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@contextmanager
def written_whole(path: str | Path, error: type[GraspRefineError] = GraspRefineError) -> Iterator[Path]:
    """Give the path of a file beside `path`, with the same ending, that replaces it once the block is done.

    Missing folders are made, and nothing is left beside `path` when the block fails. A link, a pipe or /dev/stdout
    is written to, never replaced: then `path` itself is given.

    Args:
        path: What is to be written.
        error: What is raised.

    Raises:
        GraspRefineError: It cannot be written.
    """
    path = Path(path)
    # Beside the target, so that os.replace stays within one file system; not by tempfile, whose files nobody else
    # may read.
    partial = half_written_path(path)
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            yield path
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as failure:
        raise error(f"{path}: cannot be written ({failure.strerror or failure})") from failure
