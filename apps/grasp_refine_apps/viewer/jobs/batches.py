"""Refinement of many grasps: batches of grasps as they stand, each with its own targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.problem.problem import Group
from grasp_refine.problem.refine import refine_group
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.pose import Pose, posed_scene
from grasp_refine_apps.viewer.model.work import Work

BATCH_SIZE = 8
"""Number of grasps that are refined together; results before a stop are kept."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Some grasps of one object, all with targets or none."""

    numbers: tuple[int, ...]
    """Numbers of the grasps."""
    group: Group
    """Their object and scale, with the grasps as they stand."""


def batches(collection: Collection, works: Mapping[int, Work], size: int = 0) -> Iterator[Batch]:
    """Yield the grasps of some works as they stand, object by object, in batches of at most `size`; 0: `BATCH_SIZE`."""
    size = size or BATCH_SIZE
    kinds: dict[tuple[int, bool], list[int]] = {}
    for number, work in sorted(works.items()):
        kinds.setdefault((int(collection.group_of[number]), bool(work.targets)), []).append(number)
    for numbers in kinds.values():
        for start in range(0, len(numbers), size):
            some = tuple(numbers[start : start + size])
            group = collection.group(some[0])
            row = collection.member[list(some)]
            scene = stacked([posed_scene(group.scene, works[n].standing, works[n].targets) for n in some])
            counted = [works[n].counted for n in some]
            none = np.full(len(scene.links), np.nan)
            scene = replace(scene, contact_gap=np.stack([none if one is None else one.gap for one in counted]))
            grasps = group.grasps.select(row)
            yield Batch(some, replace(group, scene=scene, grasps=grasps, rows=group.rows[row], index=group.index[row]))


def stacked(scenes: list[Scene]) -> Scene:
    """Return scenes of one hand and object as one, all with targets or none."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(scene, name) for scene in scenes])
        for name in ("T_world_root", "q", "target_link", "target_object")
        if getattr(scenes[0], name) is not None
    }
    return replace(scenes[0], **arrays)


def refine_batch(batch: Batch, config: Config, prepared: HandObject, control: Control) -> Outcome:
    """Refine a batch.

    Raises:
        GraspRefineError: a link that should touch does not exist.
        Stopped: the job was stopped.
    """

    def on_iteration(state: IterationState) -> None:
        control.check()

    return refine_group(
        batch.group, config, prepared=prepared, on_iteration=on_iteration, on_opening=lambda *done: control.check()
    )


def pose_of(outcome: Outcome, i: int) -> Pose:
    """Return the refined pose of the hand in grasp `i` of an outcome."""
    return Pose(transform_from_pose(outcome.hand_pose[i : i + 1])[0], outcome.q[i])
