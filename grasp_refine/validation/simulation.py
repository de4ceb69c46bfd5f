"""Simulation of grasps: the hand closes once, and from that state the object is pushed in each direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from grasp_refine.closing.motion import STAGES, Motion
from grasp_refine.core import profiling
from grasp_refine.core.arguments import check_kind, check_shape
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.cores import thread_count
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import distances, exp_so3, log_so3, pose_from_transform, transform
from grasp_refine.core.short_repr import brief
from grasp_refine.scene.protocols.protocol import AXES, Protocol
from grasp_refine.scene.scene import is_out_of_reach
from grasp_refine.validation.engines.mujoco.stepping import Conditions, Rows, StepCallback
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.simulations import Engine, Simulations
from grasp_refine.validation.trials import Reason, Trials

CHUNK_GRASPS = 32
"""Number of grasps that are simulated at once, which bounds the memory and allows progress reports."""

LIFT = ("lift",)
"""Directions of protocols that lift the object off a table."""


@dataclass(frozen=True, eq=False)
class Closed:
    """N grasps after the hand closed, before the object is pushed."""

    conditions: Conditions
    """Conditions under which the hand closed."""
    state: Float[np.ndarray, "N s"]
    """State of the engine (N, s), warm starts included."""
    reason: Int[np.ndarray, " N"]
    """A `Reason` (N,) of trials that have failed already; HELD elsewhere."""
    contacts_grasp: Bool[np.ndarray, "N L"]
    """True (N, L) where a link touched the object at the grasp."""
    contacts_squeeze: Bool[np.ndarray, "N L"]
    """True (N, L) where a link touched the object after the squeeze."""
    closing_m: Float[np.ndarray, " N"]
    """Displacement of the object (N,), metres."""
    closing_rad: Float[np.ndarray, " N"]
    """Rotation of the object (N,), radians."""
    penetration_m: Float[np.ndarray, " N"]
    """Penetration of hand and object at the pregrasp (N,), metres."""
    runaway: np.ndarray
    """Name (N,) of the hand's joint that made the simulation diverge; empty where none did."""

    __repr__ = brief


@profiling.stage("simulating")
def simulate(
    world: World,
    motion: Motion,
    conditions: Conditions | None = None,
    *,
    threads: int | None = None,
    first_failure: bool = False,
    progress: Callable[[float], None] | None = None,
    engine: Engine = Rows,
) -> Trials:
    """Simulate N grasps; a bad one fails with a reason and does not affect the others.

    Args:
        world: Hand, object and protocol.
        motion: Motion that closes the hand.
        conditions: What differs between the grasps; by default that of grasps and protocol.
        threads: CPU threads; by default as many as there are. The result does not depend on it.
        first_failure: A grasp that failed in so many directions that it does not hold is not simulated further in
            the others, for which the worst reason is then given.
        progress: Called with the number of finished grasps, in fractions.
        engine: Simulations of the world; by default MuJoCo's.

    Raises:
        GraspRefineError: an argument of another type, a motion of other shapes than the hand's, or no grasp at all.
    """
    check_kind("world", world, World)
    check_kind("motion", motion, Motion)
    check_kind("conditions", conditions, Conditions | None)
    check_kind("threads", threads, int | None)
    check_shape("motion.q", motion.q, "N", len(STAGES), world.hand.matrix.shape[1], why="stages and joints of the hand")
    check_shape("motion.T_world_root", motion.T_world_root, len(motion), len(STAGES), 4, 4)
    if not len(motion):
        raise GraspRefineError("there is no grasp to simulate: the motion has 0 grasps")
    if conditions is not None and conditions.wrench is not None and world.protocol.tabletop:
        raise GraspRefineError(f"protocol {world.protocol.name} lifts the object: conditions cannot push it")
    conditions = Conditions.nominal(world, len(motion)) if conditions is None else conditions
    parts = []
    for start in range(0, len(motion), CHUNK_GRASPS):
        rows = np.arange(start, min(start + CHUNK_GRASPS, len(motion)))

        def report(share: float, start: int = start, count: int = len(rows)) -> None:
            if progress is not None:
                progress(start + share * count)

        closed = close(
            world, motion.select(rows), conditions.select(rows), threads=threads, progress=report, engine=engine
        )
        parts.append(push(world, closed, threads=threads, progress=report, first_failure=first_failure, engine=engine))
    return Trials.join(parts)


def close(
    world: World,
    motion: Motion,
    conditions: Conditions,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
    on_step: StepCallback | None = None,
    engine: Engine = Rows,
) -> Closed:
    """Close the hands of N grasps, from the pregrasp over the grasp to the squeeze.

    Args:
        world: Hand, object and protocol.
        motion: Motion that closes the hand.
        conditions: What differs between the grasps.
        threads: CPU threads; by default as many as there are.
        progress: Called with the finished share of the whole trial.
        on_step: Called at the start, if any grasp can start, and after every simulation step of MuJoCo.
        engine: As for `simulate`.
    """
    protocol = world.protocol
    finite = motion.finite & conditions.finite
    grasp, arm = STAGES.index("grasp"), world.hand.on_arm
    beyond = np.zeros(len(motion), dtype=bool)
    if arm is not None:
        beyond = is_out_of_reach(arm, motion.T_world_root[:, grasp], motion.q[:, grasp])
    start = np.where(finite[:, None, None], conditions.T_world_object, np.eye(4))
    course = Course.of(world, motion.T_world_root, motion.q, finite)
    rows = engine(world, conditions, finite, thread_count(threads), on_step)
    rows.place(course.root(0, 0.0), course.joints[:, 0], pose_from_transform(start))
    start_touch = rows.touching(np.flatnonzero(finite))
    deep = finite & (start_touch.depth > protocol.deepest)
    in_table = finite & (start_touch.depth_table > protocol.deepest)
    rows.running &= ~(deep | in_table)
    rows.begin()
    contacts, steps = [], 0
    for stage in (0, 1):
        for move in range(1, protocol.moves + 1):
            share = move / protocol.moves
            rows.drive(course.root(stage, share), course.set_points(stage, share))
            rows.step(protocol.steps_per_move)
            steps += protocol.steps_per_move
            progress(steps / _steps(protocol))
        contacts.append(rows.touching(np.flatnonzero(rows.running)).links)
    moved, turned = distances(start, rows.object_poses())
    ran = finite & ~deep & ~in_table
    ejected = (moved >= protocol.farthest) | (turned >= protocol.steepest)
    return Closed(
        conditions=conditions,
        state=rows.state(),
        reason=np.select(
            [beyond, ~finite, deep, in_table, rows.runaway != "", rows.unstable, ejected],
            [
                Reason.OUT_OF_REACH,
                Reason.NOT_FINITE,
                Reason.PENETRATES,
                Reason.IN_TABLE,
                Reason.HAND_UNSTABLE,
                Reason.UNSTABLE,
                Reason.EJECTED_WHILE_CLOSING,
            ],
            Reason.HELD,
        ),
        contacts_grasp=contacts[0],
        contacts_squeeze=contacts[1],
        closing_m=np.where(ran, moved, np.nan),
        closing_rad=np.where(ran, turned, np.nan),
        penetration_m=np.where(finite, start_touch.depth, np.nan),
        runaway=rows.runaway,
    )


def push(
    world: World,
    closed: Closed,
    *,
    directions: tuple[str, ...] | None = None,
    threads: int | None = None,
    first_failure: bool = False,
    to_the_end: bool = False,
    progress: Callable[[float], None] = lambda share: None,
    on_step: StepCallback | None = None,
    engine: Engine = Rows,
) -> Trials:
    """Push the object of closed grasps in each direction, or lift it.

    Args:
        world: Hand, object and protocol.
        closed: The grasps.
        directions: Directions of the pushes; by default all of the protocol.
        threads: CPU threads; by default as many as there are.
        first_failure: As for `simulate`.
        to_the_end: Failed trials continue, to be watched; their results are the same as if they did not.
        progress: Called with the finished share of the whole trial.
        on_step: Called after every simulation step of MuJoCo.
        engine: That of the closed grasps.
    """
    protocol, count = world.protocol, len(closed.reason)
    names = directions or _directions(world, closed.conditions)
    shape = (count, len(names))
    grasp = np.repeat(np.arange(count), len(names))
    start = closed.conditions.T_world_object[grasp]
    reason = closed.reason[grasp]
    undecided = reason == Reason.HELD
    rows = engine(world, closed.conditions.select(grasp), undecided, thread_count(threads), on_step)
    rows.resume(closed.state[grasp])
    if closed.conditions.wrench is not None:
        rows.push(closed.conditions.wrench.reshape(-1, 6))
    elif not protocol.tabletop:
        forces = world.mass * protocol.acceleration * np.array([AXES[name] for name in names])
        rows.push(np.pad(np.tile(forces, (count, 1)), ((0, 0), (0, 3))))
    required = protocol.required(len(names))
    time, displacement, angle, peak, steepest = (np.full(len(grasp), np.nan) for _ in range(5))
    contacts = np.zeros((len(grasp), len(world.links)), dtype=bool)
    pushed = np.full((len(grasp), len(world.neighbours)), np.nan)
    for check in range(1, protocol.checks + 1):
        wanted = start.copy()
        if protocol.tabletop:
            wanted[:, :3, 3] += _lift(rows, protocol, check) * world.up
        else:
            rows.step(protocol.steps_per_check)
        moved, turned, found = judge_pushed(rows, wanted, protocol)
        failed = undecided & (found != Reason.HELD)
        decided = undecided if check == protocol.checks else failed
        reason[failed] = found[failed]
        time[failed] = check * protocol.steps_per_check * protocol.timestep
        displacement[decided], angle[decided] = moved[decided], turned[decided]
        peak[undecided] = np.fmax(peak, moved)[undecided]
        steepest[undecided] = np.fmax(steepest, turned)[undecided]
        pushed[decided] = rows.pushed()[decided]
        contacts[decided] = rows.touching(np.flatnonzero(decided & ~rows.unstable)).links[decided]
        undecided = undecided & ~decided
        if first_failure:
            by_grasp = reason.reshape(shape)
            worst, failures = by_grasp.max(axis=1)[grasp], (by_grasp != Reason.HELD).sum(axis=1)[grasp]
            lost = undecided & (len(names) - failures < required)
            reason[lost], undecided = worst[lost], undecided & ~lost
        if not to_the_end:
            rows.running &= undecided
        progress(1.0 - (protocol.checks - check) * protocol.steps_per_check / _steps(protocol))
    return Trials(
        directions=names,
        links=world.links,
        reason=reason.reshape(shape),
        time_s=time.reshape(shape),
        displacement_m=displacement.reshape(shape),
        angle_rad=angle.reshape(shape),
        peak_m=peak.reshape(shape),
        peak_rad=steepest.reshape(shape),
        contacts=contacts.reshape(*shape, -1),
        contacts_grasp=closed.contacts_grasp,
        contacts_squeeze=closed.contacts_squeeze,
        closing_m=closed.closing_m,
        closing_rad=closed.closing_rad,
        penetration_m=closed.penetration_m,
        success=(reason.reshape(shape) == Reason.HELD).sum(axis=1) >= required,
        limits=(protocol.farthest, protocol.steepest),
        neighbours=world.neighbours,
        runaway=_first_name(closed.runaway, rows.runaway.reshape(shape)),
        pushed_m=pushed.reshape(*shape, -1).max(axis=1) if world.neighbours else None,
    )


def judge_pushed(
    rows: Simulations, wanted: Float[np.ndarray, "R 4 4"], protocol: Protocol
) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"], Int[np.ndarray, " R"]]:
    """Return how far objects moved (R,), metres, and turned (R,), radians, and a `Reason` (R,): HELD or why not.

    Args:
        rows: Simulations.
        wanted: Poses (R, 4, 4) at which the objects should be.
        protocol: Limits of movement.
    """
    moved, turned = distances(wanted, rows.object_poses())
    found = np.select(
        [rows.runaway != "", rows.unstable, moved >= protocol.farthest, turned >= protocol.steepest],
        [Reason.HAND_UNSTABLE, Reason.UNSTABLE, Reason.MOVED, Reason.ROTATED],
        Reason.HELD,
    )
    return moved, turned, found


def _first_name(closing: np.ndarray, pushes: np.ndarray) -> np.ndarray:
    """Return the first nonempty name (N,) of closing (N,) and pushes (N, D)."""
    rows = np.concatenate([closing[:, None], pushes], axis=1)
    return rows[np.arange(len(rows)), (rows != "").argmax(axis=1)]


def _directions(world: World, conditions: Conditions) -> tuple[str, ...]:
    """Return the names of the pushes, or of the lift."""
    if conditions.wrench is None:
        return world.protocol.directions or LIFT
    return tuple(f"wrench {number + 1}" for number in range(conditions.wrench.shape[1]))


def _lift(rows: Simulations, protocol: Protocol, check: int) -> float:
    """Raise the hands to their height at a check; return that height in metres."""
    # In steps as small as while the hand closes.
    parts = max(protocol.steps_per_check // protocol.steps_per_move, 1)
    for part in range(1, parts + 1):
        height = protocol.lift * (check - 1 + part / parts) / protocol.checks
        rows.raise_to(height)
        rows.step(protocol.steps_per_check // parts)
    return height


def _steps(protocol: Protocol) -> int:
    """Return the number of simulation steps of a whole trial."""
    return 2 * protocol.moves * protocol.steps_per_move + protocol.checks * protocol.steps_per_check


@dataclass(frozen=True, eq=False)
class Course:
    """Course of the hands between S stages."""

    world: World
    T_world_body: Float[np.ndarray, "N S 4 4"]
    """Poses of the hand's root body at the stages."""
    joints: Float[np.ndarray, "N S m"]
    """Values of the hand's joints at the stages."""

    @classmethod
    def of(
        cls,
        world: World,
        T_world_root: Float[np.ndarray, "N S 4 4"],
        q: Float[np.ndarray, "N S n"],
        finite: Bool[np.ndarray, " N"],
    ) -> Course:
        """Return the course through poses of the base link and joint values; arbitrary where they are not finite."""
        hand = world.hand
        T = np.where(finite[:, None, None, None], T_world_root, np.eye(4)) @ hand.T_base_root
        q = np.where(finite[:, None, None], q, 0.0)
        joints = _each(hand.matrix, q) + hand.offset
        return cls(world, T, joints if hand.curves is None else joints + hand.curves(q))

    def root(self, stage: int, share: float) -> Float[np.ndarray, "N 7"]:
        """Return poses (N, 7) of the root body between `stage` and the next one: linear motion at an even turn."""
        before, after = self.T_world_body[:, stage], self.T_world_body[:, stage + 1]
        turn = log_so3(before[:, :3, :3].mT @ after[:, :3, :3])
        position = before[:, :3, 3] + share * (after[:, :3, 3] - before[:, :3, 3])
        return pose_from_transform(transform(before[:, :3, :3] @ exp_so3(share * turn), position))

    def set_points(self, stage: int, share: float) -> Float[np.ndarray, "N u"]:
        """Return set points (N, u) of the actuators between `stage` and the next one."""
        values = self.joints[:, stage] + share * (self.joints[:, stage + 1] - self.joints[:, stage])
        return _each(self.world.control, values)


def _each(matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return products (..., m) of one matrix (m, n) with vectors (..., n), rounded independently of the batch."""
    flat = vectors.reshape(-1, vectors.shape[-1])
    return np.stack([matrix @ vector for vector in flat]).reshape(*vectors.shape[:-1], len(matrix))
