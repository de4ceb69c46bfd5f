"""Values that result files have of each grasp: measures, whether it held in simulation, and words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from grasp_refine.core.array_types import Float, Shaped
from grasp_refine.core.npz_files import NpzFile, load_npz
from grasp_refine.measures.measures import RECORDED, SIDES
from grasp_refine.validation.engine_table import ENGINES


def held_entry(engine: str, side: str) -> str:
    """Return the entry of verdicts in an engine: 1 held, 0 lost, NaN not simulated."""
    return f"held_{engine}_{side}"


def reason_entry(engine: str, side: str) -> str:
    """Return the entry of the reasons of verdicts in an engine; empty: not simulated."""
    return f"reason_{engine}_{side}"


HELD = {f"held_{side}": f"simulation_{side}" for side in SIDES} | {
    held_entry(name, side): held_entry(name, side) for name in ENGINES for side in SIDES
}
"""Name of a verdict, of the engine that decides and of each -> its entry in the files of simulated grasps."""


TEXTS = ("status", "change", "fidelity")
"""Entries of texts on the refinement of each grasp."""


def number_entries() -> dict[str, str]:
    """Return name of a number -> its entry in result files, which may lack it."""
    return {entry: entry for measure in RECORDED for entry in measure.entries.values()} | HELD


def result_values(files: Sequence[Path]) -> dict[str, Shaped[np.ndarray, " N"]]:
    """Return the numbers and `TEXTS` of the grasps of all files, in their order, SI units.

    Names of numbers are as in `number_entries`, of values after refinement without that side: "quality",
    "penetration_m", "held", but "quality_before". Where a file lacks one it is NaN, or an empty text; grasp files
    without results have none.

    Args:
        files: Grasp files of our format.

    Raises:
        GraspFileError: one is damaged.
    """
    entries, found = number_entries(), {}
    loaded = [load_npz(path, only=("hand_pose", *entries.values(), *TEXTS)) for path in files]
    for name, entry in entries.items():
        if any(entry in file.entries for file in loaded):
            parts = [numbers_of(file, entry, len(file.entries["hand_pose"])) for file in loaded]
            found[name.replace("_after", "")] = np.concatenate(parts)
    for name in TEXTS:
        if any(name in file.entries for file in loaded):
            found[name] = np.concatenate([texts_of(file, name, len(file.entries["hand_pose"])) for file in loaded])
    return found


def texts_of(file: NpzFile, entry: str, count: int) -> Shaped[np.ndarray, " count"]:
    """Return a text of each of the `count` grasps of a result file; empty where it has no such entry.

    Raises:
        GraspFileError: it is damaged.
    """
    return file.per_row(entry, file.text(entry) if entry in file.entries else np.array(""), count)


def numbers_of(file: NpzFile, entry: str, count: int) -> Float[np.ndarray, " count"]:
    """Return an entry of a result file of `count` grasps; verdicts are 0 or 1, missing values NaN.

    Raises:
        GraspFileError: it is damaged.
    """
    if entry not in file.entries:
        return np.full(count, np.nan)
    value = file.entries[entry]
    value = value.astype(float) if value.dtype.kind == "b" else file.numbers(entry, allowed="nan")
    return file.per_row(entry, value, count)
