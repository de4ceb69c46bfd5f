"""Plans of grasps: approach, pregrasp, grasp, squeeze and lift, free of collision or with their obstacle.

The palm comes straight to the pregrasp, from the first free one of several directions; the
fingers close to the grasp and press; the palm goes straight up with the object.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from math import inf

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.arguments import check_fields, check_kind
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import tangents
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.inverse_kinematics import SAME_RAD, ArmKinematics
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.paths import HandPath, straight
from grasp_refine.motion.sweep import TOUCHING_M, Obstruction, Sweep
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

LEGS = ("approach", "close", "squeeze", "lift")
"""Names of the legs of a trajectory: to the pregrasp, to the grasp, to the squeeze, and up."""

REACH = "reach"
"""Name of the leg before `LEGS`, from a start configuration of the arm, where one is given."""

WAYPOINTS = ("approach", "pregrasp", "grasp", "squeeze", "lift")
"""Names of the waypoints: the start of the first leg, and the ends of all."""

CLOSING_DEPTH_M = 1e-3
"""Depth in metres by which links may be deeper in the object while the hand closes than at the grasp."""

TILT_RAD = 0.6
"""Angle in radians by which approaches are tilted where the palm's own direction is not free."""

OPENING_WIDER = 2.0
"""Share of the opening from the grasp to the pregrasp, by which fingers in the way of the approach open wider."""

UP = (0.0, 0.0, 1.0)
"""Direction of the lift in the object's frame, where neither a scene nor a table defines up."""


class PlanStatus(IntEnum):
    """Result of planning the motion of a grasp."""

    FREE = 0
    BLOCKED = 1
    OUT_OF_REACH = 2
    NO_GRASP = 3

    @property
    def label(self) -> str:
        """Name in tables and files."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class TrajectoryOptions:
    """Lengths of a trajectory."""

    approach: float = 0.1
    """Length in metres of the straight approach of the palm to the pregrasp."""
    lift: float = 0.1
    """Height in metres by which the palm lifts the object."""
    start: tuple[float, ...] | None = None
    """Values in rad or m of the joints of the arm, from where it moves to the approach on a straight line in joint
    space; None: the trajectory begins with the approach."""

    def __post_init__(self) -> None:
        """Refuse lengths that are not at least 0, and starts that are no joint values.

        Raises:
            GraspRefineError: names the length, or the start.
        """
        check_fields(self)
        if self.start is not None and not np.isfinite(self.start).all():
            raise GraspRefineError(f"start must be joint values in rad or m, all finite, got {self.start}")
        for name in ("approach", "lift"):
            if not 0.0 <= getattr(self, name) < inf:
                raise GraspRefineError(f"{name} must be at least 0 m and finite, got {getattr(self, name):g}")


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """Motion plan of one grasp."""

    status: PlanStatus
    """Result of planning."""
    why: str
    """Obstacle in the way, or leg out of reach, in words; empty where the trajectory is free."""
    legs: tuple[HandPath, ...]
    """Paths of `LEGS`, as set points, up to the first that is not free; none where there is no grasp."""
    direction: tuple[float, float, float] | None = None
    """Unit vector from the pregrasp to the start of the approach, in the object's frame."""
    obstruction: Obstruction | None = None
    """Obstacle that the last leg runs into; None: there is none."""
    other_arm: bool = False
    """Whether the arm reaches the poses of the palm in another configuration than the grasp's, which
    is not free; the fingers are the same."""
    reach: HandPath | None = None
    """Straight joint motion of the arm from `TrajectoryOptions.start` to the start of the approach, before the legs, of
    which there are none where it runs into something; None: no start is given, or the legs are not free."""

    __repr__ = brief

    @property
    def free(self) -> bool:
        """Whether the trajectory is free."""
        return self.status == PlanStatus.FREE


def plan_motions(
    scene: Scene, motion: Motion, options: TrajectoryOptions | None = None, prepared: HandObject | None = None
) -> tuple[MotionPlan, ...]:
    """Return the motion plan of each grasp of a scene.

    Args:
        scene: Hand, object, surroundings and grasps.
        motion: Pregrasps, grasps and squeezes of the same grasps.
        options: Lengths; the defaults when None.
        prepared: Geometry of this hand and object; None: built here.

    Raises:
        GraspRefineError: an argument of another type, motions of other grasps, or a start that is none of the arm.
    """
    check_kind("scene", scene, Scene)
    check_kind("motion", motion, Motion)
    check_kind("options", options, TrajectoryOptions | None)
    if len(motion) != len(scene.q):
        raise GraspRefineError(f"the motion has {len(motion)} grasps, the scene {len(scene.q)}")
    _check_start(scene.hand, (options or TrajectoryOptions()).start)
    prepared = prepared or HandObject.of(scene)
    planner = _Planner(scene, prepared, options or TrajectoryOptions())
    beyond = MotionPlan(PlanStatus.OUT_OF_REACH, "the grasp is out of reach of the arm", ())
    none = MotionPlan(PlanStatus.NO_GRASP, "there is no grasp", ())
    known = scene.posed & motion.finite
    return tuple(
        planner.free_plan(motion.T_world_root[row], motion.q[row]) if known[row] else beyond if out_of_reach else none
        for row, out_of_reach in enumerate(scene.out_of_reach)
    )


def closing_paths(hand: Hand, T: Float[np.ndarray, "3 4 4"], q: Float[np.ndarray, "3 n"]) -> tuple[HandPath, HandPath]:
    """Return the paths through the three stages of a grasp: to the grasp, and to the squeeze.

    Set points of the squeeze stay within the limits of joints that turn; sliding jaws press beyond theirs.

    Args:
        hand: The hand.
        T: Poses (3, 4, 4) of its base link at the stages.
        q: Its joint values (3, n) likewise.
    """
    pressing = np.where(hand.slides, q[2], np.clip(q[2], hand.lower, hand.upper))
    return HandPath(T[:2], q[:2]), HandPath(T[1:], np.stack([q[1], pressing]))


def up_of(scene: Scene) -> Float[np.ndarray, " 3"]:
    """Return the unit vector (3,) of the lift, object frame."""
    if scene.environment is not None:
        return scene.environment.up
    return np.asarray(UP if scene.table is None else scene.table.normal)


def _check_start(hand: Hand, start: tuple[float, ...] | None) -> None:
    """Refuse a start that is no configuration of the arm.

    Raises:
        GraspRefineError: names the error, and the joints.
    """
    if start is None:
        return
    arm = np.flatnonzero(hand.arm_joints)
    names = [hand.joint_names[joint] for joint in arm]
    if len(start) != len(arm):
        joints = f"its joints are {', '.join(names)}" if names else "it is on no arm"
        raise GraspRefineError(f"start has {len(start)} joint values, the arm of {hand.name} {len(arm)}: {joints}")
    for name, value, joint in zip(names, start, arm.tolist(), strict=True):
        if not hand.lower[joint] <= value <= hand.upper[joint]:
            raise GraspRefineError(
                f"start: {name} = {value:g} is outside its limits, {hand.lower[joint]:g} to {hand.upper[joint]:g}"
            )


class _Planner:
    """Plans of the grasps of one scene."""

    def __init__(self, scene: Scene, prepared: HandObject, options: TrajectoryOptions) -> None:
        self.scene, self.prepared, self.options = scene, prepared, options
        self.sweep = Sweep(scene, prepared)
        self.tips = [scene.links.index(contact.link) for contact in scene.hand.contacts]

    def free_plan(self, T: Float[np.ndarray, "3 4 4"], q: Float[np.ndarray, "3 n"]) -> MotionPlan:
        """Return the plan through the three stages of a grasp, with the first free configuration of its arm.

        That of the grasp comes first; its trajectory is returned where none is.
        """
        own = self._from_start(self.plan(T, q))
        if own.free or self.scene.hand.arm is None:
            return own
        others = (self._from_start(self.plan(T, values)) for values in self._other_configurations(T, q))
        free = next((plan for plan in others if plan.free), None)
        return own if free is None else replace(free, other_arm=True)

    def _from_start(self, plan: MotionPlan) -> MotionPlan:
        """Return a plan with its motion from the start, or blocked by its obstacle."""
        start, arm = self.options.start, self.scene.hand.arm_joints
        if start is None or not plan.free:
            return plan
        first = plan.legs[0]
        q = np.tile(first.q[0], (2, 1))
        q[0, arm] = start
        path = HandPath(first.T_world_root[[0, 0]], q)
        met = self.sweep.obstruction(path)
        if met is None:
            return replace(plan, reach=path)
        why = f"{REACH}: {met}"
        return MotionPlan(PlanStatus.BLOCKED, why, (), plan.direction, met, plan.other_arm, path)

    def _other_configurations(
        self, T: Float[np.ndarray, "3 4 4"], q: Float[np.ndarray, "3 n"]
    ) -> Iterator[Float[np.ndarray, "3 n"]]:
        """Yield joint values of the three stages with the same poses of the palm, in which the hand can close."""
        kinematics, arm = ArmKinematics(self.scene.hand), self.scene.hand.arm_joints
        T_palm = kinematics.palm(T, q)
        solutions = kinematics.solve(T[1:2], q[1:2, ~arm], T_palm[1:2])
        for values in solutions.q[0, solutions.free[0]]:
            stages = np.where(arm, values, q)
            stages, reached = kinematics.follow(T, stages, T_palm)
            stages = kinematics.polished(T, stages, T_palm)
            own = (np.abs(stages - q) < SAME_RAD * self.scene.hand.per_radian).all()
            if own or not reached.all():
                continue
            close = HandPath(T[:2], stages[:2])
            if self.sweep.obstruction(close, allowed=self.sweep.depth_in_object(close) + CLOSING_DEPTH_M) is None:
                yield stages

    def plan(self, T: Float[np.ndarray, "3 4 4"], q: Float[np.ndarray, "3 n"]) -> MotionPlan:
        """Return the plan through the three stages of a grasp."""
        hand = self.scene.hand
        close, squeeze = closing_paths(hand, T, q)
        allowed = self.sweep.depth_in_object(close) + CLOSING_DEPTH_M
        approach = self._approach(T[0], q[0], q[0] - q[1])
        if not approach.free:
            return approach
        legs, direction = list(approach.legs), approach.direction
        met = self.sweep.obstruction(close, allowed=allowed)
        legs += [close]
        if met is not None:
            return MotionPlan(PlanStatus.BLOCKED, f"{LEGS[1]}: {met}", tuple(legs), direction, met)
        legs += [squeeze]
        # Fingers are where the grasp has them, however far their set points are.
        held, reached = straight(hand, T[1], q[1], self.options.lift * up_of(self.scene))
        legs += [HandPath(held.T_world_root, np.where(hand.arm_joints, held.q, squeeze.q[1]))]
        if not reached:
            first, last = palm_poses(hand, held.T_world_root[[0, -1]], held.q[[0, -1]])[:, :3, 3]
            why = f"{LEGS[3]}: the arm lifts it by {(last - first) @ up_of(self.scene):.2f} m only"
            return MotionPlan(PlanStatus.OUT_OF_REACH, why, tuple(legs), direction)
        met = self.sweep.obstruction(held, allowed=None, carries=True)
        if met is not None:
            return MotionPlan(PlanStatus.BLOCKED, f"{LEGS[3]}: {met}", tuple(legs), direction, met)
        return MotionPlan(PlanStatus.FREE, "", tuple(legs), direction)

    def _approach(
        self, T: Float[np.ndarray, "4 4"], q: Float[np.ndarray, " n"], opening: Float[np.ndarray, " n"]
    ) -> MotionPlan:
        """Return the plan as far as the pregrasp: the first free one, or else the first of all.

        Where fingers as at the pregrasp are in the way, they come open wider, by `OPENING_WIDER` of their `opening`
        (n,) from the grasp to the pregrasp, and close to the pregrasp in place.
        """
        hand = self.scene.hand
        first: MotionPlan | None = None
        open_wide = np.clip(q + np.where(hand.arm_joints, 0.0, OPENING_WIDER * opening), hand.lower, hand.upper)
        for fingers in (q, open_wide):
            for direction in self._directions(T, q):
                path, reached = straight(hand, T, fingers, self.options.approach * direction)
                path, toward = path.reversed(), tuple(direction.tolist())
                if fingers is not q:
                    path = HandPath(np.concatenate([path.T_world_root, T[None]]), np.concatenate([path.q, q[None]]))
                met = self.sweep.obstruction(path, allowed=TOUCHING_M)
                if met is None and reached:
                    return MotionPlan(PlanStatus.FREE, "", (path,), toward)
                if first is None and met is not None:
                    first = MotionPlan(PlanStatus.BLOCKED, f"{LEGS[0]}: {met}", (path,), toward, met)
                elif first is None:
                    why = f"{LEGS[0]}: the arm does not reach all of it"
                    first = MotionPlan(PlanStatus.OUT_OF_REACH, why, (path,), toward)
        assert first is not None
        return first

    def _directions(self, T: Float[np.ndarray, "4 4"], q: Float[np.ndarray, " n"]) -> Iterator[np.ndarray]:
        """Yield unit vectors along which the palm may retreat: its own direction, up, between, and tilted ones."""
        hand = self.scene.hand
        palm = palm_poses(hand, T[None], q[None])[0]
        links = self.prepared.chain(T[None], q[None]).T_world_link[0]
        tips = links[self.tips, :3, 3].mean(axis=0) if self.tips else links[:, :3, 3].mean(axis=0)
        own, up = palm[:3, 3] - tips, up_of(self.scene)
        length = float(np.linalg.norm(own))
        own = up if length < 1e-6 else own / length
        yield own
        if own @ up > -0.9:
            yield (own + up) / np.linalg.norm(own + up)
        yield up
        # In the frame of the palm, so that they move with it.
        R = palm[:3, :3]
        for side in (R @ tangents(R.T @ own)).T:
            for sign in (1.0, -1.0):
                yield np.cos(TILT_RAD) * own + sign * np.sin(TILT_RAD) * side
