"""JSON documents and other files for programs, written atomically."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError

SCHEMA = 1
"""Version of the layout of all documents."""


def check_writable(*paths: Path | None, overwrite: bool, inside: Path | None = None) -> None:
    """Refuse paths that cannot be written, before the work starts; leaves no file behind.

    Args:
        paths: The files; None is skipped.
        overwrite: Whether existing files may be replaced.
        inside: A folder that the command creates itself; other folders have to exist.

    Raises:
        GraspRefineError: a path is a folder, exists, is named twice, or is not writable.
    """
    named: set[str] = set()
    for path in filter(None, paths):
        _check_target(path)
        if path.absolute().parts[1:2] in (("dev",), ("proc",)):  # written to, never replaced, as /dev/stdout
            continue
        if not overwrite and path.is_file():
            raise GraspRefineError(f"{path}: exists already; give another name or folder, or `overwrite` to replace it")
        made = inside is not None and path.absolute().is_relative_to(inside.absolute())
        if not path.parent.exists() and not made:
            raise GraspRefineError(f"{path}: cannot be written, there is no folder {path.parent}")
        if os.path.abspath(path) in named:
            raise GraspRefineError(f"{path}: is to be written twice, and one would replace the other")
        named.add(os.path.abspath(path))


def _check_target(path: Path) -> None:
    """Refuse a path at which no file can be created or replaced.

    Raises:
        GraspRefineError: the path is not writable.
    """
    try:
        if path.is_dir():
            raise GraspRefineError(f"{path}: is a folder, a file is to be written there")
        if path.exists() and not os.access(path, os.W_OK):
            raise GraspRefineError(f"{path}: cannot be written, no permission")
        # A link or a pipe is written to; any other file is replaced by a new one.
        if path.exists() and (path.is_symlink() or not path.is_file()):
            return
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir():
            raise GraspRefineError(f"{path}: cannot be written, {folder} is no folder")
        # Permission bits alone would allow root to write to /proc.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise GraspRefineError(f"{path}: cannot be written ({error.strerror or error})") from error


def check_no_input(path: Path, inputs: Iterable[Path], say: str) -> None:
    """Refuse an output `path` that would replace an input.

    Raises:
        GraspRefineError: it would; `say` is the rest of the message.
    """
    if path.exists() and any(file.exists() and path.samefile(file) for file in inputs):
        raise GraspRefineError(f"{path}: {say}")


def dumps(document: Any, indent: int | None = None) -> str:
    """Text of a document; values that are not finite become null."""
    return json.dumps(_plain(document), indent=indent, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float) and not isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def save_json(path: Path, document: Any) -> None:
    """Write a document atomically; missing folders are made.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    save_text(path, dumps(document, indent=1) + "\n")


def save_text(path: Path, text: str) -> None:
    """Write a text as `save_bytes`; characters that UTF-8 cannot encode, as in odd file names, are escaped.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    save_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def save_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically, see `written_whole`.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    with written_whole(path) as partial:
        partial.write_bytes(content)
