"""Files for programs: JSON documents, written whole or not at all."""

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
    """Nothing, when files can be made at `paths`; found out before the work, not after it, and nothing is left there.

    Args:
        paths: The files; None is passed over.
        overwrite: Whether files that exist may be replaced.
        inside: A folder that the command makes itself; other folders have to exist.

    Raises:
        GraspRefineError: one is a folder, exists, is named twice, or lies where nothing can be written.
    """
    named: set[str] = set()
    for path in filter(None, paths):
        _check_place(path)
        if _is_device(path):
            continue
        if not overwrite and path.is_file():
            raise GraspRefineError(f"{path}: exists already; give another name or folder, or --overwrite to replace it")
        made = inside is not None and path.absolute().is_relative_to(inside.absolute())
        if not path.parent.exists() and not made:
            raise GraspRefineError(f"{path}: cannot be written, there is no folder {path.parent}")
        if os.path.abspath(path) in named:
            raise GraspRefineError(f"{path}: is to be written twice, and one would replace the other")
        named.add(os.path.abspath(path))


def _is_device(path: Path) -> bool:
    """Whether a file is written to and never replaced, such as /dev/stdout, also where that is sent to a file."""
    return path.absolute().parts[1:2] in (("dev",), ("proc",))


def _check_place(path: Path) -> None:
    """Nothing, when a file can be made or replaced at `path`.

    Raises:
        GraspRefineError: it cannot.
    """
    try:
        if path.is_dir():
            raise GraspRefineError(f"{path}: is a folder, a file is to be written there")
        if path.exists() and not os.access(path, os.W_OK):
            raise GraspRefineError(f"{path}: cannot be written, no permission")
        # A link or a pipe is written to, everything else is replaced by a new file.
        if path.exists() and (path.is_symlink() or not path.is_file()):
            return
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir():
            raise GraspRefineError(f"{path}: cannot be written, {folder} is no folder")
        # Who asks for permission alone is told that root may write to /proc.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise GraspRefineError(f"{path}: cannot be written ({error.strerror or error})") from error


def check_no_input(path: Path, inputs: Iterable[Path], say: str) -> None:
    """Nothing, when what is written to `path` takes the place of no input.

    Raises:
        GraspRefineError: it would; `say` is how that ends.
    """
    if path.exists() and any(file.exists() and path.samefile(file) for file in inputs):
        raise GraspRefineError(f"{path}: {say}")


def dumps(document: Any, indent: int | None = None) -> str:
    """The text of a document, in which whatever is not finite is null."""
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
    """Write a document; the file appears whole or not at all, and missing folders are made.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    save_text(path, dumps(document, indent=1) + "\n")


def save_text(path: Path, text: str) -> None:
    """Write a text as `save_bytes` writes bytes; what UTF-8 cannot say, such as odd file names, is escaped.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    save_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def save_bytes(path: Path, content: bytes) -> None:
    """Write a file as `written_whole` does.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    with written_whole(path) as partial:
        partial.write_bytes(content)
