"""Stages of grasps as rows of pose and joint values, which DexGraspBench, BODex and Dexonomy share.

A row is x y z (metres), qw qx qy qz of the hand's root in the world, then the joint values in the order of a `Layout`;
the world is where the object has a pose of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.layout import Layout, layout_of
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet, Stage
from grasp_refine.grasps.rebase import rebased
from grasp_refine.hands.hand import Hand

GRASP = "grasp"
STAGES = ("pregrasp", GRASP, "squeeze")
"""Names of the stages, in the order in which the hand closes."""
ORIGIN_POSE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Pose of an object whose frame is the world's."""


def grasps_of_stages(
    source: Source,
    layouts: Sequence[Layout],
    hand: Hand | None,
    rows: Mapping[str, np.ndarray],
    *,
    object_pose: Any,
    object_name: str,
    scale: float,
    hand_name: str = "",
) -> GraspSet:
    """The grasps with some rows as stages; the grasp itself must be among them.

    Args:
        source: The file, which may have `joint_names`.
        layouts: Orders and frames of the numbers that its format knows.
        hand: The hand that the user gave.
        rows: Name in the file -> rows (N, 7 + n); the name begins with that of the stage.
        object_pose: Pose (7,) of the object in the world.
        object_name: Its name.
        scale: Factor that takes its mesh to metres.
        hand_name: Name of the hand that the file gives.

    Raises:
        GraspFileError: numbers of another shape, no unit quaternions, or joints of no layout.
    """
    (what,) = [name for name in rows if name.startswith(GRASP)]
    columns = rows[what].shape[-1]
    if columns < 8:
        raise source.error(f"{what} must have 7 numbers of a pose and the joint values; it has {columns}")
    names = source.joint_names(source.content)
    layout = layout_of(source, layouts, columns - 7, hand, names=names, hand_name=hand_name)
    T_object_world = inverse(transform_from_pose(source.poses([object_pose], "obj_pose", 1)))
    stages: dict[str, Any] = {}
    count = None
    for what, value in rows.items():
        numbers = source.numbers(value, what, (count, 7 + len(layout.joints)))
        count = len(numbers)
        T_world_root = transform_from_pose(source.poses(numbers[:, :7], what))
        pose = pose_from_transform(T_object_world @ T_world_root @ layout.T_root_base)
        (name,) = [name for name in STAGES if what.startswith(name)]
        stages[name] = Stage(pose, numbers[:, 7:])
    grasp = stages.pop(GRASP)
    return replace(layout.grasps(hand, grasp.pose, grasp.q, object=object_name, scale=scale), **stages)


def rows_of_stage(grasps: GraspSet, name: str, layout: Layout) -> Float[np.ndarray, "N columns"]:
    """Rows (N, 7 + n) of one stage of grasps that `fit_layout` returned, the object at the origin.

    The grasp itself is used for a stage that they lack.
    """
    stage = grasps.at(grasps.other_stages[name]) if name in grasps.other_stages else grasps
    return np.concatenate([root_poses(stage, layout), stage.q], axis=1)


def root_poses(grasps: GraspSet, layout: Layout) -> Float[np.ndarray, "N 7"]:
    """Poses (N, 7) of the frame of a layout whose base link has the poses of the grasps."""
    return pose_from_transform(transform_from_pose(grasps.hand_pose) @ inverse(layout.T_root_base))


def missing_stage_notes(grasps: GraspSet) -> list[str]:
    """Notes on stages that the grasps lack and rows of stages need."""
    lacking = [name for name in OTHER_STAGES if name not in grasps.other_stages]
    return [f"there is no {name}: the grasp itself is written in its place" for name in lacking]


def fit_layout(
    grasps: GraspSet, layouts: Sequence[Layout], load: Callable[[str], Hand], format_name: str
) -> tuple[GraspSet, Layout]:
    """Return the grasps from the base link of the layout that has their joints, in its order, and that layout.

    The pose then includes joints before that link, such as a wrist.

    Raises:
        GraspFileError: no layout has these joints; shows both lists.
    """
    for layout in layouts:
        if set(layout.joints) <= set(grasps.joint_names):
            moved = rebased(grasps, layout.base_link, load)
            if set(layout.joints) == set(moved.joint_names):
                return moved.in_order(layout.joints), layout
    known = "; ".join(map(str, layouts))
    raise GraspFileError(
        f"format {format_name} cannot hold grasps of hand '{grasps.hand}' with the joints "
        f"{', '.join(grasps.joint_names)}; it is known here for {known}"
    )
