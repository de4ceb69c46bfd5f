"""Groups of grasps that are refined together: of one hand, on several objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.array_records import index_distinct, join
from grasp_refine.problem.problem import Group
from grasp_refine.refinement.config import Config
from grasp_refine.scene.scene import GRASP_FIELDS, Scene


def sets_of(groups: Sequence[Group], config: Config) -> list[list[Group]]:
    """Return groups in sets that are refined together, in their order: of up to `Config.width` grasps, or one group.

    Many grasps at once cost less for each; the result of each is the same.
    """
    sets: list[list[Group]] = []
    alone = config.solver.needs_autograd or bool(config.terms)
    for group in groups:
        last = sets[-1] if sets else []
        many = sum(len(each.rows) for each in (*last, group)) > config.width
        scanned = any(each.scene.object.hypotheses for each in (*last, group))
        if not last or alone or many or scanned or not _fits(last[0].scene, group.scene):
            sets.append([group])
        else:
            last.append(group)
    return sets


def _fits(first: Scene, scene: Scene) -> bool:
    """Return whether the grasps of a scene can be refined with the grasps of the first one of a set."""
    alike = all(
        (getattr(scene, name) is None) == (getattr(first, name) is None) for name in (*GRASP_FIELDS, "original")
    )
    return alike and scene.hand is first.hand and scene.task == first.task and first.fits(scene.object)


def together(scenes: Sequence[Scene]) -> Scene:
    """Return one scene with the grasps of several, one after the other."""
    first, counts = scenes[0], [len(scene.q) for scene in scenes]
    arrays: dict[str, Any] = {
        name: None if getattr(first, name) is None else np.concatenate([getattr(scene, name) for scene in scenes])
        for name in GRASP_FIELDS
    }
    objects, number = index_distinct([scene.object for scene in scenes])
    arrays["original"] = join(*(scene.original for scene in scenes))
    return replace(first, **arrays, object=objects[0], others=objects[1:], of_object=np.repeat(number, counts))
