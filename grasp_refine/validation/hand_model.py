"""A hand as MuJoCo takes it, wherever it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Actuator

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, eq=False)
class HandModel:
    """One tree of bodies with actuated joints; its values follow from those of a `Hand` by name, not by order.

    The root has no joint yet, and contact parameters are whatever the file says: the world that the hand is put
    into decides on both.
    """

    spec: mujoco.MjSpec
    """The hand alone, below the world body of this specification: bodies, joints, position actuators, couplings."""
    root: str
    """Name of the body that everything hangs from."""
    T_base_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of that body in the frame of the hand's base link."""
    joints: tuple[str, ...]
    """Names of the m joints in MuJoCo."""
    matrix: Float[np.ndarray, "m n"]
    """Joint values in MuJoCo are `matrix` (m, n) times q (n,), in the order of `Hand.joint_names`, plus `offset`."""
    offset: Float[np.ndarray, " m"]
    """What is added (m,), in rad or m."""
    links: Mapping[str, str]
    """Name of each body -> what it is called in results: the link of the hand that it stands for, or its own name."""
    notes: tuple[str, ...]
    """What a user should know about how the model was made."""
    actuator: Actuator
    """How the n independent joints are driven as it is simulated, in their units and order.

    Of a coupled group it is the stiffness and the limit of the tendon, as in `Hand.actuator`, whose place this takes
    where set points are planned.
    """

    __repr__ = brief
