"""Export of the grasps of a problem to other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from grasp_refine.core.array_records import join
from grasp_refine.core.array_types import Shaped
from grasp_refine.core.npz_files import load_npz
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.forces.squeeze_forces import ContactForces
from grasp_refine.problem.problem import Problem, StageSource
from grasp_refine.results.result_numbers import result_values


def exported_grasps(
    problem: Problem,
    *,
    closing: StageSource = "auto",
    forces: ContactForces | None = None,
    values: Mapping[str, Shaped[np.ndarray, " N"]] | None = None,
) -> list[ExportedGrasps]:
    """Return the grasps of a problem on each of its objects, with pregrasps, squeezes and planned forces.

    Args:
        problem: Hand, objects and N grasps.
        closing: Source of pregrasps and squeezes.
        forces: Forces that the squeezes of the grasps are planned for, where these are not made here.
        values: Measures and words of the grasps, by name.
    """
    parts = []
    for group in problem.groups:
        motion = group.motion(closing)
        planned = None if motion.forces is None else motion.forces.flat()
        if planned is None and forces is not None:
            planned = forces.select(group.place)
        known = {} if values is None else {name: column[group.place] for name, column in values.items()}
        parts.append(ExportedGrasps(group.object, group.scale, group.scene, motion, group.index, planned, known))
    return parts


def of_file(problem: Problem, closing: StageSource = "auto") -> list[ExportedGrasps]:
    """Return the grasps of a problem likewise, with the forces and measures that their result file has."""
    paths = problem.files if len(problem.files) == 1 else problem.files[1:]
    if problem.sampled or not all(path.is_file() and path.suffix.lower() == ".npz" for path in paths):
        return exported_grasps(problem, closing=closing)
    rows = np.concatenate([group.rows for group in problem.groups])[problem.order]
    values = {name: column[rows] for name, column in result_values(paths).items()}
    loaded = [load_npz(path).entries for path in paths]
    forces = [ContactForces.of_entries(entries) for entries in loaded]
    known = [one for one in forces if one is not None]
    if len(known) < len(forces):
        return exported_grasps(problem, closing=closing, values=values)
    begin = np.cumsum([0, *(len(entries["hand_pose"]) for entries in loaded[:-1])])
    every = join(*(replace(one, grasp=one.grasp + first) for one, first in zip(known, begin, strict=True)))
    return exported_grasps(problem, closing=closing, forces=every.select(rows), values=values)
