"""Pose of a hand, and targets of its links on the object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.grasps.grasp_set import Targets
from grasp_refine.problem.problem import aim
from grasp_refine.scene.scene import Scene, is_posed


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a hand in the object's frame."""

    T_object_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the base link, metres."""
    q: Float[np.ndarray, " n"]
    """Joint values (n,) in `Hand.joint_names` order; radians, metres for prismatic joints."""

    def same(self, other: Pose) -> bool:
        """Return whether both poses are equal; unknown values, such as of an arm that is out of reach, are equal."""
        pairs = ((self.T_object_root, other.T_object_root), (self.q, other.q))
        return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)

    @cached_property
    def posed(self) -> bool:
        """Whether it can be drawn: a rigid motion, and finite values within bounds."""
        return bool(is_posed(self.T_object_root[None], self.q[None])[0])


@dataclass(frozen=True, eq=False)
class Target:
    """Target point of a link on the object."""

    link: str
    """Name of the link."""
    point_link: Float[np.ndarray, " 3"]
    """The point on it (3,), link frame, metres."""
    point_object: Float[np.ndarray, " 3"]
    """The point on the object (3,), its frame, metres."""

    @property
    def values(self) -> tuple[str, list[float], list[float]]:
        """Values that can be compared."""
        return self.link, self.point_link.tolist(), self.point_object.tolist()


def posed_scene(scene: Scene, pose: Pose, targets: Sequence[Target] = ()) -> Scene:
    """Return a scene with the hand at one pose, with these targets only, and without recorded contact links.

    Raises:
        GraspFileError: a link of a target cannot touch anything.
    """
    link, obj = aim(scene.hand, file_targets(targets))
    T, q = pose.T_object_root[None], pose.q[None]
    return replace(scene, T_world_root=T, q=q, target_link=link, target_object=obj, direction=None, contact_gap=None)


def file_targets(targets: Sequence[Target]) -> Targets | None:
    """Return the targets of one grasp as grasp files have them; None without targets."""
    return file_targets_of([targets])


def file_targets_of(grasps: Sequence[Sequence[Target]]) -> Targets | None:
    """Return the targets of N grasps as grasp files have them, NaN where a grasp has none for a link."""
    # A link may have several targets: its k-th one is a column of its own.
    columns: dict[tuple[str, int], int] = {}
    places = []
    for row, targets in enumerate(grasps):
        count: Counter[str] = Counter()
        for target in targets:
            key = target.link, count[target.link]
            count[target.link] += 1
            places.append((row, columns.setdefault(key, len(columns)), target))
    if not places:
        return None
    points = np.full((2, len(grasps), len(columns), 3), np.nan)
    for row, column, target in places:
        points[:, row, column] = target.point_link, target.point_object
    return Targets(tuple(link for link, _ in columns), points[0], points[1])


def targets_of(scene: Scene) -> tuple[Target, ...]:
    """Return the targets of the one grasp of a scene."""
    if scene.target_link is None or scene.target_object is None:
        return ()
    columns = zip(scene.links, scene.target_link[0], scene.target_object[0], strict=True)
    return tuple(Target(*target) for target in columns if np.isfinite(target[1:]).all())
