"""Unknowns of a refinement: the pose of the palm, free or by the joints of an arm, and the joint values.

A grasp is a `Point`: the pose of the base link and all joint values. A free hand has its palm as its base, which moves
by any step. On an arm the base stands exactly still, and the arm's joints move the palm: their steps count, and are
bounded, by how far they move it.
"""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import distances
from grasp_refine.hands.chain import integrate
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.scene.scene import Scene

ROTATION_M_PER_RAD, JOINTS_M_PER_RAD = 0.05, 0.04
"""Movement of the palm in metres that counts as much as one radian of the palm, and of a joint."""

MAX_STEP = (0.05, 1.0, 0.5)
"""Largest step: of the palm, and of prismatic joints, in metres; of the palm in radians; of joints in radians."""

BISECTIONS = 24
"""Number of halvings that find how far an arm may move within the bounds on the palm's movement."""


class Variables:
    """Steps, bounds and metric of a hand that moves freely."""

    def __init__(self, scene: Scene, max_move: MaxMove, freeze: tuple[str, ...] = ()) -> None:
        """Prepare the unknowns of the grasps of a scene."""
        self.scene, self.max_move = scene, max_move
        hand = scene.hand
        self.frozen = Frozen.of(hand, freeze)
        joints = np.where(hand.slides, 1.0, JOINTS_M_PER_RAD**2)
        self.scales = np.concatenate([np.ones(3), np.full(3, ROTATION_M_PER_RAD**2), joints])
        metres, _, radians = MAX_STEP
        # Bounds of each unknown would depend on the axes of the world: `integrate` shortens steps of the palm.
        self.step = np.concatenate([np.full(6, np.inf), np.where(hand.slides, metres, radians)])
        self.step[self.frozen.unknowns] = 0.0

    def palm(self, point: Point) -> Float[np.ndarray, "M 4 4"]:
        """Return the poses (M, 4, 4) of the palm."""
        return point.T

    def placed(self, point: Point, T_palm: Float[np.ndarray, "M 4 4"]) -> Point:
        """Return the grasps with their palms at other poses, or as near to them as an arm brings them."""
        return Point(T_palm, point.q)

    def metric(self, member: np.ndarray) -> Float[np.ndarray, "M k"]:
        """Return 1 for translations, `ROTATION_M_PER_RAD`^2 and `JOINTS_M_PER_RAD`^2 for rotations."""
        return np.broadcast_to(self.scales, (len(member), len(self.scales)))

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of a step: joints to their limits, and no farther than `MAX_STEP`."""
        hand = self.scene.hand
        lower, upper = np.tile(-self.step, (len(member), 1)), np.tile(self.step, (len(member), 1))
        lower[:, 6:] = np.maximum(lower[:, 6:], hand.lower - point.q)
        upper[:, 6:] = np.minimum(upper[:, 6:], hand.upper - point.q)
        return lower, upper

    def integrate(self, member: np.ndarray, point: Point, dx: Float[np.ndarray, "M k"]) -> Point:
        """Return the grasps after steps, projected onto joint limits and movement bounds.

        A step that moves the palm farther than `MAX_STEP` is shortened as a whole.
        """
        length = np.linalg.norm(self.palm_twist(member, dx).reshape(-1, 2, 3), axis=-1) / MAX_STEP[:2]
        dx = dx / np.maximum(length.max(axis=1, keepdims=True), 1.0)
        return self.project(member, self.move(point, dx))

    def displace(self, member: np.ndarray, point: Point, dx: Float[np.ndarray, "M k"]) -> Point:
        """Return the grasps after movements whose first six numbers move the palm itself, projected as by `integrate`.

        They are steps for a free hand; an arm is brought to where they take its palm.
        """
        return self.integrate(member, point, dx)

    def palm_twist(self, member: np.ndarray, dx: Float[np.ndarray, "M k"]) -> Float[np.ndarray, "M 6"]:
        """Return how steps (M, 6 + n) move the origin of the palm, and turn it, in metres and radians."""
        return dx[:, :6]

    def move(self, point: Point, dx: Float[np.ndarray, "M k"]) -> Point:
        """Return the grasps after steps, anywhere."""
        return Point(integrate(point.T, dx[:, :6]), point.q + dx[:, 6:])

    def project(self, member: np.ndarray, point: Point) -> Point:
        """Return the nearest grasps within the joint limits and the movement bounds from the initial grasps.

        Frozen parts are as in the initial grasps, joint values beyond their limits at the limit.
        """
        scene = self.scene
        first = scene.T_world_root[member], scene.q[member]
        T, q = self.max_move.project(point.T, point.q, *first, scene.hand.per_radian)
        T, q = self.frozen.restore(T, q, *first)
        return Point(T, np.minimum(np.maximum(q, scene.hand.lower), scene.hand.upper))


class ArmVariables(Variables):
    """Steps, bounds and metric of a hand on an arm, whose base stands still."""

    def __init__(self, scene: Scene, max_move: MaxMove, freeze: tuple[str, ...] = ()) -> None:
        """Prepare the unknowns; what a joint of the arm moves is taken at the initial grasps."""
        super().__init__(scene, max_move, freeze)
        hand = scene.hand
        self.step[:6] = 0.0
        self.kinematics = ArmKinematics(hand)
        # Grasps that are not known have no result, and are never asked for.
        with np.errstate(invalid="ignore"):
            self.T_palm, self.J = self.kinematics.jacobian(scene.T_world_root, np.clip(scene.q, hand.lower, hand.upper))
        moves = (self.J * self.J)[:, :3].sum(axis=1) + ROTATION_M_PER_RAD**2 * (self.J * self.J)[:, 3:].sum(axis=1)
        self.arm_scales = np.tile(self.scales, (len(scene.q), 1))
        self.arm_scales[:, 6 + self.kinematics.joints] = moves

    def palm(self, point: Point) -> Float[np.ndarray, "M 4 4"]:
        """Return the poses (M, 4, 4) of the palm."""
        return self.kinematics.palm(point.T, point.q)

    def placed(self, point: Point, T_palm: Float[np.ndarray, "M 4 4"]) -> Point:
        """Return the grasps with their palms at other poses, or as near to them as the arm brings them."""
        q, _ = self.kinematics.follow(point.T, point.q, T_palm)
        return Point(point.T, q)

    def metric(self, member: np.ndarray) -> Float[np.ndarray, "M k"]:
        """Return the metric of a free hand; a joint of the arm counts as the movement of the palm that it makes."""
        return self.arm_scales[member]

    def displace(self, member: np.ndarray, point: Point, dx: Float[np.ndarray, "M k"]) -> Point:
        """Return the grasps after movements of the palm by the arm, and of the hand's joints, projected."""
        moved = self.placed(point, integrate(self.palm(point), dx[:, :6]))
        q = moved.q + np.where(self.scene.hand.arm_joints, 0.0, dx[:, 6:])
        return self.project(member, Point(point.T, q))

    def palm_twist(self, member: np.ndarray, dx: Float[np.ndarray, "M k"]) -> Float[np.ndarray, "M 6"]:
        """Return how steps (M, 6 + n) move the origin of the palm, and turn it, to first order."""
        return (self.J[member] @ dx[:, 6 + self.kinematics.joints, None])[..., 0]

    def move(self, point: Point, dx: Float[np.ndarray, "M k"]) -> Point:
        """Return the grasps after steps of the joints; the base keeps its pose to the last bit."""
        return Point(point.T, point.q + dx[:, 6:])

    def project(self, member: np.ndarray, point: Point) -> Point:
        """Return grasps within the joint limits and the movement bounds; the palm comes back on the arm's way."""
        hand, bounds = self.scene.hand, self.max_move
        T, q_first = self.scene.T_world_root[member], self.scene.q[member]
        most = np.where(hand.arm_joints, np.inf, bounds.joints * hand.per_radian)
        q = np.clip(point.q, q_first - most, q_first + most)
        _, q = self.frozen.restore(T, q, T, q_first)
        q = np.minimum(np.maximum(q, hand.lower), hand.upper)
        if np.isinf(bounds.translation) and np.isinf(bounds.rotation):
            return Point(T, q)
        away = np.where(hand.arm_joints, q - q_first, 0.0)
        share = np.zeros((len(q), 1))
        for power in range(BISECTIONS):
            wanted = share + 0.5**power
            share = np.where((wanted <= 1.0) & self._within(member, q - (1.0 - wanted) * away)[:, None], wanted, share)
        return Point(T, q - (1.0 - share) * away)

    def _within(self, member: np.ndarray, q: Float[np.ndarray, "M n"]) -> np.ndarray:
        """Return a mask (M,) of joint values at which the palm is within the movement bounds."""
        T = self.kinematics.palm(self.scene.T_world_root[member], q)
        moved, turned = distances(self.T_palm[member], T)
        return (moved <= self.max_move.translation) & (turned <= self.max_move.rotation)


def variables(scene: Scene, max_move: MaxMove, freeze: tuple[str, ...] = ()) -> Variables:
    """Return the unknowns of the grasps of a scene; `freeze` as in `Config`."""
    return (Variables if scene.hand.arm is None else ArmVariables)(scene, max_move, freeze)
