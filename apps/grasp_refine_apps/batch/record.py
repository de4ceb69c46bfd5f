"""Records of shards in the results folder: result files with a stamp of their inputs, and notes of failures."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from enum import Enum
from pathlib import Path

from grasp_refine.core.atomic_files import half_written
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.json_files import save_json
from grasp_refine.core.npz_files import ZIP_ERRORS, load_npz
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.processes.task import Failed

NOTE_SUFFIX = ".failed.json"
"""Suffix of a failure note, after the name of the missing result file."""

_UNREADABLE = (*ZIP_ERRORS, GraspFileError)
"""Errors from a damaged file, or from a file that is no result."""


class State(Enum):
    """State of a shard's result file."""

    COMPLETE = "complete"
    MISSING = "missing"
    CHANGED = "changed"
    """Result of other inputs, settings or versions."""
    DAMAGED = "damaged"
    """Unreadable result file."""


def state_of(shard: Shard) -> State:
    """State of a shard's result file; every byte of it is checked."""
    if not shard.path.is_file():
        return State.MISSING
    try:
        with zipfile.ZipFile(shard.path) as archive:
            if archive.testzip() is not None:
                return State.DAMAGED
        stamp = _stamp(shard.path)
    except _UNREADABLE:
        return State.DAMAGED
    return State.COMPLETE if stamp == shard.stamp else State.CHANGED


def is_result(path: Path) -> bool:
    """Return True for a result file of a batch."""
    if path.suffix != ".npz":
        return False
    try:
        return _stamp(path) is not None
    except _UNREADABLE:
        return False


def _stamp(path: Path) -> str | None:
    """Stamp of a result file of a batch; None: it is another file."""
    provenance = json.loads(str(load_npz(path, only=("provenance",)).entries["provenance"]))
    batch = provenance.get("batch") if isinstance(provenance, dict) else None
    return batch.get("stamp") if isinstance(batch, dict) else None


def note_failure(shard: Shard, failed: Failed) -> None:
    """Write the failure of a shard beside the path of its result; an outdated result there is removed.

    Raises:
        GraspRefineError: the note cannot be written.
    """
    with suppress(OSError):
        shard.path.unlink(missing_ok=True)
    save_json(_note_path(shard), {"stamp": shard.stamp, "shard": shard.name, "number": shard.number, **asdict(failed)})


def noted_failure(shard: Shard) -> Failed | None:
    """Noted failure of a shard; None: there is none, or it is of other inputs or settings."""
    try:
        raw = json.loads(_note_path(shard).read_text(encoding="utf-8"))
        if raw["stamp"] != shard.stamp:
            return None
        return Failed(raw["reason"], raw["message"], raw["traceback"], raw["tries"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def forget_failure(shard: Shard) -> None:
    """Remove the failure note of a shard that succeeded."""
    with suppress(OSError):
        _note_path(shard).unlink(missing_ok=True)


def clean(files: Iterable[Path]) -> None:
    """Remove partial files of these files, left by killed processes of this machine."""
    names: dict[Path, set[str]] = {}
    for path in files:
        names.setdefault(path.parent, set()).add(path.name)
    for folder, here in names.items():
        with suppress(OSError):
            for entry in os.scandir(folder):
                pid, name = half_written(entry.name)
                if name in here and pid is not None and not is_alive(pid):
                    Path(entry.path).unlink(missing_ok=True)


def _note_path(shard: Shard) -> Path:
    return shard.path.with_name(shard.path.name + NOTE_SUFFIX)


def is_alive(pid: int) -> bool:
    """Return True if the process exists on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
