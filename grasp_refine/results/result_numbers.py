"""Numbers that result files have of each grasp: measures, and whether it held in simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from grasp_refine.core.npz_files import NpzFile, load_npz
from grasp_refine.measures.measures import RECORDED, SIDES

HELD = {f"held_{side}": f"simulation_{side}" for side in SIDES}
"""Name of a verdict -> its entry in the files of simulated grasps."""


def number_entries() -> dict[str, str]:
    """Return name of a number -> its entry in result files, which may lack it."""
    return {entry: entry for measure in RECORDED for entry in measure.entries.values()} | HELD


def result_numbers(files: Sequence[Path]) -> dict[str, Float[np.ndarray, " N"]]:
    """Return the numbers of the grasps of all files, in their order, SI units; NaN where a file lacks one.

    Names are as in `number_entries`, of values after refinement without that side: "quality",
    "penetration_m", "held", but "quality_before". Grasp files without results have none.

    Args:
        files: Grasp files of our format.

    Raises:
        GraspFileError: one is damaged.
    """
    entries, found = number_entries(), {}
    loaded = [load_npz(path, only=("hand_pose", *entries.values())) for path in files]
    for name, entry in entries.items():
        if any(entry in file.entries for file in loaded):
            parts = [numbers_of(file, entry, len(file.entries["hand_pose"])) for file in loaded]
            found[name.replace("_after", "")] = np.concatenate(parts)
    return found


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
