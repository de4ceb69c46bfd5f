"""Atomic files: written completely or not at all."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.machine import host

_PARTIAL_MARK = ".partial."
"""Separator between the process with its thread and the machine in the names of partial files."""


def half_written_path(path: Path) -> Path:
    """Path of the partial file that this thread of this process writes before it becomes `path`."""
    writer = f"{os.getpid()}-{threading.get_native_id()}"
    return path.with_name(f".{writer}{_PARTIAL_MARK}{_machine_id()}.{path.name}")


def half_written(name: str) -> tuple[int | None, str]:
    """Process of this machine that wrote a partial file, and the final file name; None: not such a file."""
    writer, between, rest = name.removeprefix(".").partition(_PARTIAL_MARK)
    pid, _, _ = writer.partition("-")
    host, _, whole = rest.partition(".")
    ours = name.startswith(".") and between and pid.isdecimal() and host == _machine_id()
    return (int(pid), whole) if ours else (None, name)


def _machine_id() -> str:
    """Identifier of this machine: several may write into one folder, with equal process ids."""
    return hashlib.sha256(host().encode()).hexdigest()[:8]


@contextmanager
def written_whole(path: str | Path, error: type[GraspRefineError] = GraspRefineError) -> Iterator[Path]:
    """Yield the path of a file beside `path`, with the same suffix, that replaces it when the block ends.

    Missing folders are made, and no partial file remains when the block fails. A link, a pipe or /dev/stdout is
    written to, never replaced: then `path` itself is yielded.

    Args:
        path: File to write.
        error: Class of the error raised.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    path = Path(path)
    # Beside the target, so that os.replace stays within one file system; not by tempfile, whose files only their owner
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
