"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from grasp_refine.errors import GraspRefineError


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
    partial = path.with_name(f".{os.getpid()}.partial.{path.name}")
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
