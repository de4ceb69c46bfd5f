"""Motion that closes a hand: from the pregrasp over the grasp to the squeeze."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.closing.pregrasp import open_hand
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.squeeze import squeeze
from grasp_refine.forces.squeeze_forces import SqueezeForces
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet, match_joints
from grasp_refine.hands.hand import Hand
from grasp_refine.refinement.closing import close_hands
from grasp_refine.refinement.solvers.iterate import Progress
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

STAGES = ("pregrasp", "grasp", "squeeze")
"""Names of the stages, in order."""


@dataclass(frozen=True, eq=False)
class Motion(ArrayRecord):
    """N grasps, each with its three stages, in the order of `STAGES`."""

    T_world_root: Float[np.ndarray, "N 3 4 4"]
    """Poses (N, 3, 4, 4) of the hand's base link in the object's frame, metres."""
    q: Float[np.ndarray, "N 3 n"]
    """Joint values (N, 3, n) in `Hand.joint_names` order, radians or metres; a squeeze may lie beyond the limits."""
    forces: SqueezeForces | None = None
    """Forces that the squeezes are planned for; None: they are not ours."""
    closed_m: Float[np.ndarray, " N"] | None = None
    """Distance (N,) by which open fingers were closed to the grasp, as `ClosedHands.moved_m`; None: stages as given."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.q)

    @property
    def finite(self) -> Bool[np.ndarray, " N"]:
        """True where all poses and joint values of a grasp (N,) are finite."""
        return np.isfinite(self.T_world_root).all(axis=(1, 2, 3)) & np.isfinite(self.q).all(axis=(1, 2))


def closing_motion(
    scene: Scene,
    prepared: HandObject | None = None,
    progress: Progress | None = None,
    *,
    pressure: float | None = None,
) -> Motion:
    """Return our motion to the grasps of a scene: open before, pressing after; NaN for invalid poses.

    Hands that are open (`closing.is_open`) are closed first, and begin as open as they are.

    Args:
        scene: Hand, object and grasps.
        prepared: Geometry of this hand and object; None: built here.
        progress: As for `open_hand`.
        pressure: Sum of the pressures of all contacts in newtons; None: by the task, see `squeeze`.

    Raises:
        GraspRefineError: an argument of another type.
    """
    check_kind("scene", scene, Scene)
    check_kind("prepared", prepared, HandObject | None)
    prepared = prepared or HandObject.of(scene)
    # Of grasps out of reach, only the joint values of the arm are NaN.
    posed = scene.posed | scene.out_of_reach
    T = np.where(posed[:, None, None], scene.T_world_root, np.nan)
    T_open, q_open = open_hand(scene, prepared, progress)
    closed = close_hands(scene, prepared)
    scene = replace(scene, q=closed.q)
    q = np.where(posed[:, None], scene.q, np.nan)
    pressing = squeeze(scene, prepared, total=pressure)
    q = np.stack([q_open, q, pressing.q], axis=1)
    return Motion(np.stack([T_open, T, T], axis=1), q, pressing.forces, closed.moved_m)


def motion_of(grasps: GraspSet, hand: Hand, own: Motion | None = None) -> Motion:
    """Return the motion of a grasp file, its joints matched to the hand by name.

    Args:
        grasps: The grasps.
        hand: Their hand.
        own: Motion of the same grasps with generated stages, for stages that the file lacks.

    Raises:
        GraspFileError: the file lacks a stage and there is no `own`, or its joints differ from the hand's.
    """
    missing = [name for name in OTHER_STAGES if name not in grasps.other_stages]
    if missing and own is None:
        raise GraspFileError(f"the grasps come without {' and '.join(missing)}")
    T, q = [], []
    for at, name in enumerate(STAGES):
        if name in missing and own is not None:
            T.append(own.T_world_root[:, at])
            q.append(own.q[:, at])
        else:
            stage = grasps.at(getattr(grasps, name)) if name in OTHER_STAGES else grasps
            T.append(transform_from_pose(stage.hand_pose))
            q.append(match_joints(stage, hand)[0])
    closed = own.closed_m if own is not None and "squeeze" in missing else None
    return Motion(np.stack(T, axis=1), np.stack(q, axis=1), closed_m=closed)
