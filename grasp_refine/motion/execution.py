"""Execution of trajectories in MuJoCo: a position-controlled hand, and its arm, follow their set points over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import join
from grasp_refine.core.array_types import Float
from grasp_refine.core.cores import thread_count
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import distances, inverse, pose_from_transform, transform_from_pose
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.executions import Executions
from grasp_refine.motion.plan import LEGS, REACH, MotionPlan
from grasp_refine.motion.trajectory import Trajectory, trajectory
from grasp_refine.validation.engines.mujoco.stepping import Conditions, Rows
from grasp_refine.validation.engines.mujoco.world import SCENE, World
from grasp_refine.validation.engines.simulations import OBJECT_GEOM, OTHER_GEOM
from grasp_refine.validation.simulation import CHUNK_GRASPS, Course

CLOSE, LIFT = LEGS.index("close"), LEGS.index("lift")


def execute(
    world: World, hand: Hand, trajectories: Sequence[Trajectory | None], *, threads: int | None = None
) -> Executions:
    """Follow N trajectories in simulation, each from its start to its end; none depends on the others.

    The set points change every `Protocol.steps_per_move` steps. A hand without an arm is pulled along by its root.

    Args:
        world: Hand, object and surroundings, under a protocol that lifts.
        hand: The hand of the trajectories, on its arm or not.
        trajectories: Set points over time; None: there is no way to follow.
        threads: CPU threads; by default as many as there are. The result does not depend on it.

    Raises:
        GraspRefineError: an argument of another type, or the protocol pushes.
    """
    check_kind("world", world, World)
    check_kind("hand", hand, Hand)
    if not world.protocol.tabletop:
        raise GraspRefineError(
            f"protocol {world.protocol.name} pushes the object in empty space: trajectories need one that lifts, "
            "such as scene or tabletop"
        )
    starts = range(0, len(trajectories), CHUNK_GRASPS)
    parts = [_execute(world, hand, trajectories[start : start + CHUNK_GRASPS], threads) for start in starts]
    return join(*parts) if parts else _execute(world, hand, (), threads)


def follow(world: World, hand: Hand, plans: Sequence[MotionPlan], *, threads: int | None = None) -> Executions:
    """Follow the free trajectories of N, as `execute` does, by the speed limits of the joints."""
    timed = [trajectory(hand, plan) if plan.free else None for plan in plans]
    return execute(world, hand, timed, threads=threads)


def _execute(world: World, hand: Hand, trajectories: Sequence[Trajectory | None], threads: int | None) -> Executions:
    """Follow few trajectories, all at the same time."""
    protocol, count = world.protocol, len(trajectories)
    seconds = protocol.steps_per_move * protocol.timestep
    sampled = {row: one.sampled(seconds)[2:] for row, one in enumerate(trajectories) if one is not None}
    ends = np.array([len(sampled[row][0]) - 1 if row in sampled else 0 for row in range(count)], dtype=int)
    followed = ends > 0
    longest = max(int(ends.max(initial=0)), 1) + 1
    T, q = np.tile(np.eye(4), (count, longest, 1, 1)), np.zeros((count, longest, len(hand.joint_names)))
    for row, (path, _) in sampled.items():
        at = np.minimum(np.arange(longest), ends[row])
        T[row], q[row] = path.T_world_root[at], path.q[at]
    course = Course.of(world, T, q, followed)
    rows = Rows(world, Conditions.nominal(world, count), followed, thread_count(threads))
    start = np.tile(np.eye(4), (count, 1, 1))
    rows.place(course.root(0, 0.0), course.joints[:, 0], pose_from_transform(start))
    watch = _Contacts(world, count)
    T_palm = palm_poses(hand, T.reshape(-1, 4, 4), q.reshape(-1, q.shape[-1])).reshape(T.shape)
    tracking = np.zeros((2, count))
    ended, pushed = start.copy(), np.full((count, len(world.neighbours)), np.nan)
    for tick in range(1, longest):
        rows.drive(course.root(tick - 1, 1.0), course.set_points(tick - 1, 1.0))
        rows.step(protocol.steps_per_move)
        ran = np.flatnonzero(rows.running)
        for row in ran.tolist():
            watch.note(row, int(sampled[row][1][tick]), *rows.contacts(row))
        away = distances(T_palm[ran, tick], _palm(world, hand, rows, T[:, tick], q[:, tick])[ran])
        tracking[:, ran] = np.maximum(tracking[:, ran], away)
        over = rows.running & (ends == tick)
        ended[over], pushed[over] = rows.object_poses()[over], rows.pushed()[over]
        rows.running &= ~over
    wanted = start.copy()
    for row, (_, leg) in sampled.items():
        begin = int((leg < LIFT).sum()) - 1
        rise = (T_palm[row, ends[row], :3, 3] - T_palm[row, begin, :3, 3]) @ world.up
        wanted[row, :3, 3] += rise * world.up
    moved, turned = distances(wanted, ended)
    sound = followed & ~rows.unstable

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(sound, values, np.nan)

    return Executions(
        followed=followed,
        held=sound & (moved < protocol.farthest) & (turned < protocol.steepest),
        lifted_m=known(ended[:, :3, 3] @ world.up),
        displacement_m=known(moved),
        angle_rad=known(turned),
        tracking_m=known(tracking[0]),
        tracking_rad=known(tracking[1]),
        pushed_m=pushed,
        hits=watch.texts(),
        neighbours=world.neighbours,
    )


def _palm(
    world: World, hand: Hand, rows: Rows, T: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, "N 4 4"]:
    """Return where the palms are in simulation (N, 4, 4); `T` and `q` are their set points."""
    qpos = rows.batch.qpos
    if world.root_at is not None:
        root = transform_from_pose(qpos[:, world.root_at : world.root_at + 7])
        return palm_poses(hand, root @ inverse(world.hand.T_base_root), q)
    arm = np.flatnonzero(hand.arm_joints)
    q = q.copy()
    q[:, arm] = qpos[:, world.joints_at[[world.hand.joints.index(hand.joint_names[joint]) for joint in arm]]]
    return palm_poses(hand, T, q)


class _Contacts:
    """Contacts that should not be, of N simulations."""

    def __init__(self, world: World, count: int) -> None:
        self.world = world
        self.hits: list[dict[str, None]] = [{} for _ in range(count)]
        self._supports: list[set[str]] = [set() for _ in range(count)]

    def texts(self) -> np.ndarray:
        """Return an array (N,) of tuples of texts."""
        texts = np.empty(len(self.hits), dtype=object)
        texts[:] = [tuple(hits) for hits in self.hits]
        return texts

    def note(self, row: int, leg: int, geoms: np.ndarray, distance: np.ndarray) -> None:
        """Note the contacts of a simulation on a leg."""
        for a, b in np.unique(np.sort(geoms[distance <= 0.0], axis=1), axis=0).tolist():
            owners = {int(self.world.link_of_geom[geom]): geom for geom in (a, b)}
            link = max(owners)
            if OTHER_GEOM in owners and link >= 0:
                self._hit(row, leg, self.world.links[link], self._name(owners[OTHER_GEOM]))
            elif OBJECT_GEOM in owners and link >= 0 and leg < CLOSE:
                self._hit(row, leg, self.world.links[link], self.world.object)
            elif set(owners) == {OBJECT_GEOM, OTHER_GEOM}:
                other = self._name(owners[OTHER_GEOM])
                if leg < LIFT:
                    self._supports[row].add(other)
                elif other not in self._supports[row]:
                    self._hit(row, leg, self.world.object, other)

    def _hit(self, row: int, leg: int, first: str, second: str) -> None:
        self.hits[row][f"{(REACH, *LEGS)[leg + 1]}: {first} and {second}"] = None

    def _name(self, geom: int) -> str:
        """Return the name of the table, or of a body of the scene."""
        model = self.world.model
        body = model.body(model.geom_bodyid[geom]).name
        return body.removeprefix(SCENE) if body.startswith(SCENE) else model.geom(geom).name
