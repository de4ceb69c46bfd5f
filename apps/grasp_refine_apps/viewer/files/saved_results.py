"""Entries of a result file of `refine-grasp run` for grasps that were refined or measured here, beside the grasps."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.json_files import dumps
from grasp_refine.core.machine import machine
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.core.versions import versions
from grasp_refine.grasps.formats.listing import OURS
from grasp_refine.problem.recorded_objects import object_entries
from grasp_refine.results.document import settings
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.result_files import result_entries
from grasp_refine.scene.task_file import TASK, task_entry
from grasp_refine_apps.viewer.files.saving import Saved
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import OF_REFINEMENT, numeric_columns
from grasp_refine_apps.viewer.model.work import Work


def with_results(saved: Saved, format_name: str, collection: Collection, works: Mapping[int, Work]) -> Saved:
    """Return a saved file with the measures of its grasps, if its format is ours: others have no place for them.

    Args:
        saved: File of the grasps of `works`, in this order.
        format_name: Name of its format.
        collection: The grasps with their measures as they are now (`present`).
        works: What was made of the grasps, by number.
    """
    entries = entries_of(collection, works)
    if format_name != OURS.name or not entries:
        return saved
    with np.load(io.BytesIO(saved.content), allow_pickle=False) as file:
        arrays = {**file, **entries}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return replace(saved, content=stream.getvalue())


def entries_of(collection: Collection, works: Mapping[int, Work]) -> dict[str, np.ndarray]:
    """Return the entries of some grasps as result files have them, NaN or empty where unknown; {}: none is known."""
    numbers = np.array(list(works))
    refined = {row: work.outcome for row, work in enumerate(works.values()) if work.outcome is not None}
    rows = np.array(list(refined), dtype=int)
    found: dict[str, np.ndarray] = {}
    if refined:
        links = collection.group(int(numbers[rows[0]])).scene.links
        for key, values in result_entries(links, Outcome.join(list(refined.values()))).items():
            if key == "forces_grasp":
                found[key] = rows[values]
            elif key == "contact_link" or key.startswith("forces_"):
                found[key] = values
            else:
                found[key] = _spread(values, rows, len(numbers))
        others = np.setdiff1d(np.arange(len(numbers)), rows)
        found["hand_pose_before"][others] = pose_from_transform(collection.T_initial[numbers[others]])
        found["q_before"][others] = collection.q_initial[numbers[others]]
    for column in (*numeric_columns(), *OF_REFINEMENT):
        known = collection.columns.get(column.key)
        if known is not None and known.known[numbers].any():
            found[column.key] = known.values[numbers]
    if not found:
        return {}
    configs = {repr(work.config): work.config for work in works.values() if work.config is not None}
    groups = {int(at): collection.problem.groups[at] for at in collection.group_of[numbers]}
    provenance: dict[str, Any] = {
        "versions": versions(),
        "machine": machine(),
        "config": {"refine": settings(next(iter(configs.values())))} if len(configs) == 1 else {},
        "objects": object_entries(groups.values()),
        "index": [int(collection.group(n).index[collection.member[n]]) for n in numbers.tolist()],
        "row": collection.row[numbers],
    }
    used = [work.refined_for for work in works.values() if work.outcome is not None]
    if used and used[0] is not None and all(task is used[0] for task in used):
        provenance[TASK] = task_entry(used[0])
    return {**found, "provenance": np.array(dumps(provenance))}


def _spread(values: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Values of some rows among `count`, NaN or empty in the others."""
    texts = values.dtype.kind == "U"
    found = np.full((count, *values.shape[1:]), "" if texts else np.nan, dtype=values.dtype if texts else float)
    found[rows] = values
    return found
