"""Files for programs: JSON documents, written whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.errors import GraspRefineError

SCHEMA = 1
"""Version of the layout of all documents."""


def check_writable(path: Path) -> None:
    """Nothing, when a file can be made at `path`; found out before the work, not after it.

    Raises:
        GraspRefineError: `path` is a folder, or lies where nothing can be written.
    """
    if path.is_dir():
        raise GraspRefineError(f"{path}: is a folder, a file is to be written there")
    if path.exists():
        writable = os.access(path, os.W_OK)
    else:
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if not folder.is_dir():
            raise GraspRefineError(f"{path}: cannot be written, {folder} is no folder")
        writable = os.access(folder, os.W_OK | os.X_OK)
    if not writable:
        raise GraspRefineError(f"{path}: cannot be written, no permission")


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
    """Write a file; it appears whole or not at all, and missing folders are made.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    try:
        # A pipe or /dev/stdout is written to, never replaced.
        if path.is_symlink() or (path.exists() and not path.is_file()):
            path.write_bytes(content)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            partial.write_bytes(content)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise GraspRefineError(f"{path}: cannot be written ({error.strerror or error})") from error
