"""Lift of a held object by an arm: set points of its joints that raise the palm straight up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import inverse
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.validation.engines.mujoco.world import HAND, World


@dataclass(frozen=True, eq=False)
class ArmLift:
    """Set points of an arm in a world, by inverse kinematics from its current ones."""

    kinematics: ArmKinematics
    """Kinematics of the palm."""
    actuators: Int[np.ndarray, " a"]
    """Indices (a,) of the actuators of the arm's joints."""
    T_base_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the root body in the frame of the arm's base link."""

    @classmethod
    def of(cls, world: World) -> ArmLift:
        """Return the lift in a world whose hand is on an arm."""
        hand = world.hand.on_arm
        assert hand is not None
        kinematics = ArmKinematics(hand)
        names = [hand.joint_names[joint] for joint in kinematics.joints]
        actuators = np.array([world.model.actuator(f"{HAND}/{name}").id for name in names])
        return cls(kinematics, actuators, world.hand.T_base_root)

    def set_points(
        self, T_world_root: Float[np.ndarray, "N 4 4"], ctrl: Float[np.ndarray, "N u"], rise: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "N u"]:
        """Return set points (N, u) at which the palm is by `rise` (3,), metres, from where `ctrl` (N, u) has it.

        Beyond its reach the arm goes as near as it comes; the fingers keep theirs.
        """
        hand, joints, at = self.kinematics.hand, self.kinematics.joints, self.actuators
        q = np.tile(hand.rest, (len(ctrl), 1))
        q[:, joints] = ctrl[:, at]
        T_base = T_world_root @ inverse(self.T_base_root)
        wanted = self.kinematics.palm(T_base, q)
        wanted[:, :3, 3] += rise
        q, _ = self.kinematics.follow(T_base, q, wanted)
        raised = ctrl.copy()
        raised[:, at] = q[:, joints]
        return raised
