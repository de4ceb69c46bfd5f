"""Rows of the index: one for each grasp, from its result file alone."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from grasp_refine.core.names import is_valid
from grasp_refine.core.npz_files import NpzFile, load_npz
from grasp_refine.measures.measures import COUNT, QUALITY, RECORDED, SECOND, SIDES, Measure
from grasp_refine.results.result_numbers import HELD, number_entries, numbers_of, texts_of
from grasp_refine.results.verdict import should_hold
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.batch.shard import Shard

Kind = Literal["text", "whole", "number", "flag"]
"""Kind of a column. Text is an array of strings in which "" is null; all others are float64 with NaN as null."""


def _kinds(measures: Iterable[Measure]) -> dict[str, Kind]:
    """Return name -> kind of the columns of measures; verdicts by quality follow its columns."""
    found: dict[str, Kind] = {}
    for measure in measures:
        found |= dict.fromkeys(measure.entries.values(), "whole" if measure.unit == COUNT else "number")
        if measure is QUALITY:
            found |= dict.fromkeys((f"good_{side}" for side in SIDES), "flag")
    return found


def column_kinds() -> dict[str, Kind]:
    """Return name -> kind of all columns, in order; columns that differ between runs of the same command come last.

    `file` is relative to the folder of the results, and `row_in_file` the row in it; `row` is the row in the grasp file
    `source`. `good` is true if a grasp should hold by its quality, `held` if it did in simulation. Lengths are in
    metres, angles in radians, times in seconds.
    """
    return {
        "job": "text",
        "shard": "whole",
        "file": "text",
        "row_in_file": "whole",
        "hand": "text",
        "object": "text",
        "scale": "number",
        "source": "text",
        "row": "whole",
        "status": "text",
        "change": "text",
        "fidelity": "text",
        **_kinds(measure for measure in RECORDED if measure.unit != SECOND),
        **dict.fromkeys(HELD, "flag"),
        "reason_after": "text",
        **_kinds(measure for measure in RECORDED if measure.unit == SECOND),
    }


TEXTS = ("hand", "object", "status", "provenance")
NEEDED = (*TEXTS, "scale", *QUALITY.entries.values())
"""Arrays that every result file must have."""
DAMAGED = "provenance is damaged; delete the file, and run the batch again"
"""Message for a provenance that no batch can have written."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one result file."""

    columns: Mapping[str, np.ndarray]
    """Arrays (N,) of all `column_kinds`."""
    look: tuple[str, ...] = ()
    """Options of `refine-grasp view`, beside the file and --index, to show a grasp of it."""
    stamp: str = ""
    """Stamp of the shard that the file was made for."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.columns["status"])

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a column."""
        return self.columns[name]


def read_rows(shard: Shard, out: Path) -> Rows:
    """Read the rows of a shard's result file.

    Args:
        shard: A complete shard.
        out: Folder of the results.

    Raises:
        GraspFileError: the file is missing, damaged, or holds no results.
    """
    file = load_npz(shard.path)
    missing = [name for name in NEEDED if name not in file.entries]
    if missing:
        raise file.error(f"is no file of refined grasps, it has no {missing[0]}; delete it, and run the batch again")
    status = np.array(file.names("status"), dtype=str)
    n = len(status)
    provenance, batch = _provenance(file)
    inside = shard.path.is_relative_to(out)

    def each(value: Any, kind: type = float) -> np.ndarray:
        try:
            return file.per_row("provenance", np.atleast_1d(np.asarray(value, dtype=kind)), n)
        except (TypeError, ValueError, OverflowError):
            raise file.error(DAMAGED) from None

    source, place = provenance.get("source") or {}, provenance.get("row") or [None]
    look = batch.get("look") or []
    if not (isinstance(source, dict) and isinstance(place, list) and isinstance(look, list)):
        raise file.error(DAMAGED)
    texts = (batch.get("job"), source.get("path"), source.get("sampled"), *look)
    if not all(text is None or (isinstance(text, str) and is_valid(text)) for text in texts):
        raise file.error(DAMAGED)
    columns = {
        "job": each(str(batch.get("job") or ""), str),
        "shard": each(shard.number),
        "file": each((shard.path.relative_to(out) if inside else shard.path).as_posix(), str),
        "row_in_file": np.arange(n, dtype=float),
        "hand": file.per_row("hand", file.text("hand"), n),
        "object": file.per_row("object", file.text("object"), n),
        "scale": numbers_of(file, "scale", n),
        "source": each(str(source.get("path") or source.get("sampled") or ""), str),
        "row": each([np.nan if row is None else row for row in place]),
        "status": status,
        "change": texts_of(file, "change", n),
        "fidelity": texts_of(file, "fidelity", n),
        **{column: numbers_of(file, entry, n) for column, entry in number_entries().items()},
    }
    for side in SIDES:
        columns[f"good_{side}"] = should_hold(columns[f"quality_{side}"]).astype(float)
    reason = texts_of(file, "simulation_reason_after", n)
    columns["reason_after"] = np.where(reason == Reason.HELD.label, "", reason)
    return Rows({name: columns[name] for name in column_kinds()}, tuple(map(str, look)), str(batch.get("stamp")))


def _provenance(file: NpzFile) -> tuple[dict[str, Any], dict[str, Any]]:
    """Provenance of a result file, and its entry about the batch that made it."""
    try:
        found = json.loads(file.name("provenance"))
    except (ValueError, RecursionError) as error:
        raise file.error(f"provenance is no JSON ({error})") from None
    if not isinstance(found, dict):
        raise file.error("provenance must be a JSON object")
    batch = found.get("batch") or {}
    return found, batch if isinstance(batch, dict) else {}
