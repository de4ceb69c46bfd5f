"""Model of a hand for MuJoCo, made from a URDF or an MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.files.mimics import Curves
from grasp_refine.hands.hand import Actuator, Hand

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, eq=False)
class HandModel:
    """One tree of bodies with actuated joints, whose values follow from a `Hand`'s by name, not by order.

    The root has no joint yet, and contact parameters come from the file: the world that the hand is added to sets
    both.
    """

    spec: mujoco.MjSpec
    """Specification with the hand alone below its world body: bodies, joints, position actuators, couplings."""
    root: str
    """Name of the root body."""
    T_base_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of that body in the frame of the hand's base link."""
    joints: tuple[str, ...]
    """Names of the m joints in MuJoCo."""
    matrix: Float[np.ndarray, "m n"]
    """Joint values in MuJoCo are `matrix` (m, n) times q (n,), in the order of `Hand.joint_names`, plus `offset`, plus
    `curves`(q) where there are some."""
    offset: Float[np.ndarray, " m"]
    """Offset (m,) of joint values in MuJoCo, in rad or m."""
    links: Mapping[str, str]
    """Name of each body -> its name in results: the link of the hand that it represents, or its own name."""
    notes: tuple[str, ...]
    """Notes for the user on the model."""
    actuator: Actuator
    """Actuators of the n independent joints in the simulation, in their units and order.

    Values of a coupled group are the stiffness and the limit of the tendon, as in `Hand.actuator`, which this replaces
    where set points are planned.
    """
    curves: Curves | None = None
    """Parts of the joint values that are not linear; None: none is."""
    patches: bool = False
    """Whether flat faces of the hand touch in patches, as `Hand.patches`."""
    on_arm: Hand | None = None
    """The hand, where its root is the base of an arm, which stands still; None: the root moves freely."""

    __repr__ = brief
