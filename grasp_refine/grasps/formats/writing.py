"""Writing grasp files of any format: they appear whole or not at all, and only once they were read back."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Int
from grasp_refine.core.atomic_files import half_written_path, written_whole
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import save_npz
from grasp_refine.grasps.formats.content import SUFFIXES
from grasp_refine.grasps.formats.folders import natural
from grasp_refine.grasps.formats.format import Format, Part
from grasp_refine.grasps.formats.hdf5_files import dump_hdf5
from grasp_refine.grasps.formats.pickled import Refused
from grasp_refine.grasps.formats.texts import dump_json, dump_yaml
from grasp_refine.grasps.formats.torch_files import dump_torch
from grasp_refine.grasps.grasp_set import GraspSet

DUMPS: dict[str, Callable[[Any], bytes]] = {".yaml": dump_yaml, ".json": dump_json, ".pt": dump_torch, ".h5": dump_hdf5}
"""Ending of a file -> bytes of its contents; the others are array files."""


def check_output(path: Path, to: Format, parts: Sequence[Part]) -> None:
    """Refuse a `path` to which the files of a format cannot be written.

    Raises:
        GraspFileError: a file is given for a folder or the other way round, or the folder exists already.
    """
    (suffix,) = {Path(part.path).suffix for part in parts}
    if as_file(path, to, parts):
        if path.suffix.lower() != suffix:
            raise GraspFileError(f"{path}: format {to.name} is one file; its name must end with {suffix}")
        if path.is_dir():
            raise GraspFileError(f"{path}: is a folder; a file would be written there")
        return
    if path.suffix.lower() in SUFFIXES:
        files = "1 file named after its object" if len(parts) == 1 else f"{len(parts)} files"
        raise GraspFileError(f"{path}: format {to.name} makes {files}: give the name of a new folder")
    if path.exists() or path.is_symlink():
        raise GraspFileError(f"{path}: exists already; give the name of a new folder")


def as_file(path: Path, to: Format, parts: Sequence[Part]) -> bool:
    """Return True if the only part becomes a single file; else there will be a folder."""
    alone = len(parts) == 1 and not to.named_by_path
    return alone and ("/" not in parts[0].path or path.suffix.lower() == Path(parts[0].path).suffix)


@contextmanager
def written(path: Path, to: Format, parts: Sequence[Part]) -> Iterator[tuple[Path, Int[np.ndarray, " N"]]]:
    """Yield the path of the written files, which becomes `path` once the block is done, and the grasps in them.

    The grasps are rows in the order in which they are read. Nothing is left when the block fails.

    Raises:
        GraspFileError: it cannot be written.
    """
    if as_file(path, to, parts):
        with written_whole(path, GraspFileError) as partial:
            _save(partial, parts[0])
            yield partial, parts[0].rows
        return
    partial = half_written_path(path)
    ordered = sorted(parts, key=lambda part: natural(part.path))
    try:
        for part in ordered:
            (partial / part.path).parent.mkdir(parents=True, exist_ok=True)
            _save(partial / part.path, part)
        yield partial, np.concatenate([part.rows for part in ordered])
        partial.rename(path)
    except OSError as failure:
        raise GraspFileError(f"{path}: cannot be written ({failure.strerror or failure})") from failure
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _save(path: Path, part: Part) -> None:
    """Write one file."""
    if isinstance(part.content, GraspSet):
        save_npz(path, part.content.arrays())
        return
    with path.open("wb") as stream:
        kept = DUMPS.get(path.suffix.lower())
        if kept is not None:
            try:
                stream.write(kept(part.content))
            except Refused as error:
                raise GraspFileError(f"{path.name}: {error}") from None
            return
        np.save(stream, part.content if isinstance(part.content, np.ndarray) else np.array(part.content, dtype=object))
