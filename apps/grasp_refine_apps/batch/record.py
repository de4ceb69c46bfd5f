"""What a batch leaves of its shards: result files that say what they were made of, and notes of what failed."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from enum import Enum
from pathlib import Path

from grasp_refine.core.atomic_files import half_written
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.json_files import save_json
from grasp_refine.core.npz_files import DAMAGED, load_npz
from grasp_refine_apps.batch.shard import Failed, Shard

NOTE = ".failed.json"
"""What is added to the name of a result file that did not come out."""

_UNREADABLE = (*DAMAGED, zipfile.BadZipFile, zlib.error, ValueError, KeyError, GraspFileError)
"""How a damaged file, or one of something else, shows."""


class State(Enum):
    """What there is of a shard."""

    COMPLETE = "complete"
    MISSING = "missing"
    CHANGED = "changed"
    """The result is of other inputs, settings or versions."""
    DAMAGED = "damaged"
    """The result file cannot be read."""


def state_of(shard: Shard) -> State:
    """What there is of a shard; every byte of the file is checked."""
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
    """Whether a file is a result of a batch."""
    if path.suffix != ".npz":
        return False
    try:
        return _stamp(path) is not None
    except _UNREADABLE:
        return False


def _stamp(path: Path) -> str | None:
    """What a result file of a batch is stamped with; None: it is another file."""
    provenance = json.loads(str(load_npz(path, only=("provenance",)).entries["provenance"]))
    batch = provenance.get("batch") if isinstance(provenance, dict) else None
    return batch.get("stamp") if isinstance(batch, dict) else None


def note_failure(shard: Shard, failed: Failed) -> None:
    """Write down that a shard failed, beside where its result would be; a result of something else goes.

    Raises:
        GraspRefineError: the note cannot be written.
    """
    with suppress(OSError):
        shard.path.unlink(missing_ok=True)
    save_json(_note(shard), {"stamp": shard.stamp, "shard": shard.name, **asdict(failed)})


def noted_failure(shard: Shard) -> Failed | None:
    """What was noted of a shard that failed; None: nothing, or of other inputs or settings."""
    try:
        raw = json.loads(_note(shard).read_text(encoding="utf-8"))
        if raw["stamp"] != shard.stamp:
            return None
        return Failed(shard.number, raw["reason"], raw["message"], raw["traceback"], raw["tries"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def forget_failure(shard: Shard) -> None:
    """Take the note away, once the shard came out."""
    with suppress(OSError):
        _note(shard).unlink(missing_ok=True)


def clean(shards: Iterable[Shard]) -> None:
    """Take away what processes of this machine that were killed have left of result files."""
    names: dict[Path, set[str]] = {}
    for shard in shards:
        names.setdefault(shard.path.parent, set()).add(shard.path.name)
    for folder, here in names.items():
        with suppress(OSError):
            for entry in os.scandir(folder):
                pid, name = half_written(entry.name)
                if name in here and pid is not None and not _alive(pid):
                    Path(entry.path).unlink(missing_ok=True)


def _note(shard: Shard) -> Path:
    return shard.path.with_name(shard.path.name + NOTE)


def _alive(pid: int) -> bool:
    """Whether there is such a process on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
