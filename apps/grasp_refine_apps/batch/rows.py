"""Rows of the index: one for each grasp, from its result file alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from grasp_refine.core.names import is_valid
from grasp_refine.core.npz_files import NpzFile, load_npz
from grasp_refine.results.verdict import should_hold
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.batch.shard import Shard

Kind = Literal["text", "whole", "number", "flag"]
"""Kind of a column. Text is an array of strings in which "" is null; all others are float64 with NaN as null."""

COLUMNS: Mapping[str, Kind] = {
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
    "starts": "whole",
    "iterations": "whole",
    "queries": "whole",
    "quality_before": "number",
    "quality_after": "number",
    "good_before": "flag",
    "good_after": "flag",
    "wrench_residual_before": "number",
    "wrench_residual_after": "number",
    "contact_error_before_m": "number",
    "contact_error_after_m": "number",
    "penetration_before_m": "number",
    "penetration_after_m": "number",
    "self_penetration_before_m": "number",
    "self_penetration_after_m": "number",
    "loss_m2": "number",
    "moved_palm_m": "number",
    "moved_palm_rad": "number",
    "moved_joints_rad": "number",
    "limits_violated": "whole",
    "held_before": "flag",
    "held_after": "flag",
    "reason_after": "text",
    "cpu_s": "number",
    "wall_s": "number",
}
"""Name -> kind of all columns, in order; those that differ between two runs of the same command come last.

`file` is relative to the folder of the results, and `row_in_file` the row in it; `row` is the row in the grasp file
`source`. `good` is true if a grasp should hold by its quality, `held` if it did in simulation. Lengths are in
metres, angles in radians, times in seconds.
"""

ENTRIES = {
    "starts": "starts",
    "iterations": "iterations",
    "loss_m2": "loss",
    **{f"{name}_{when}": f"{name}_{when}" for name in ("quality", "wrench_residual") for when in ("before", "after")},
    **{
        f"{name}_{when}_m": f"{name}_{when}"
        for name in ("contact_error", "penetration", "self_penetration")
        for when in ("before", "after")
    },
}
"""Column -> array of numbers that every result file has."""
OPTIONAL = {
    "queries": "queries",
    "moved_palm_m": "moved_palm_m",
    "moved_palm_rad": "moved_palm_rad",
    "moved_joints_rad": "moved_joints_rad",
    "limits_violated": "limits_violated",
    "held_before": "simulation_before",
    "held_after": "simulation_after",
    "cpu_s": "cpu_s",
    "wall_s": "wall_s",
}
"""Column -> array of numbers that only some result files have."""
TEXTS = ("hand", "object", "status", "provenance")
NEEDED = (*TEXTS, "scale", *ENTRIES.values())
"""Arrays that every result file must have."""
DAMAGED = "provenance is damaged; delete the file, and run the batch again"
"""Message for a provenance that no batch can have written."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one result file."""

    columns: Mapping[str, np.ndarray]
    """Arrays (N,) of all `COLUMNS`."""
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
        "scale": _numbers(file, "scale", n),
        "source": each(str(source.get("path") or source.get("sampled") or ""), str),
        "row": each([np.nan if row is None else row for row in place]),
        "status": status,
        **{column: _numbers(file, key, n) for column, key in ENTRIES.items()},
        **{
            column: _numbers(file, key, n) if key in file.entries else np.full(n, np.nan)
            for column, key in OPTIONAL.items()
        },
    }
    for when in ("before", "after"):
        columns[f"good_{when}"] = should_hold(columns[f"quality_{when}"]).astype(float)
    reason = file.text("simulation_reason_after") if "simulation_reason_after" in file.entries else np.array("")
    reason = file.per_row("simulation_reason_after", reason, n)
    columns["reason_after"] = np.where(reason == Reason.HELD.label, "", reason)
    return Rows({name: columns[name] for name in COLUMNS}, tuple(map(str, look)), str(batch.get("stamp")))


def _numbers(file: NpzFile, key: str, n: int) -> np.ndarray:
    """Read an array of a result file as float64 (n,)."""
    value = file.entries[key]
    value = value.astype(float) if value.dtype.kind == "b" else file.numbers(key, allowed="nan")
    return file.per_row(key, value, n)


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
