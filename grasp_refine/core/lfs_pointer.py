"""Pointers of Git LFS: short texts in place of the files, as of a clone without Git LFS or a ZIP archive of GitHub."""

from __future__ import annotations

from pathlib import Path

from grasp_refine.core.errors import GraspRefineError

FIRST_BYTES = b"version https://git-lfs.github.com/spec/"
"""Beginning of a pointer, by the specification of Git LFS."""


def refuse_lfs_pointer(path: Path, kind: str, error: type[GraspRefineError]) -> None:
    """Refuse a file that is a pointer of Git LFS; a file that cannot be read is left to its reader.

    Args:
        path: The file.
        kind: Kind of the file, for the message, as "mesh".
        error: Type of the error.

    Raises:
        GraspRefineError: of that type; the file is a pointer.
    """
    try:
        with path.open("rb") as file:
            first = file.read(len(FIRST_BYTES))
    except OSError:
        return
    if first == FIRST_BYTES:
        raise error(
            f"{path}: a Git LFS pointer, not the {kind}; fetch it with 'git lfs pull' in the clone that it comes from "
            "(a ZIP archive of GitHub holds pointers only)"
        )
