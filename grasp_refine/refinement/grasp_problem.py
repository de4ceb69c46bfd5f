"""Least-squares problems over root pose and joint values, one per grasp of a scene."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import partial
from zlib import crc32

import numpy as np

from grasp_refine.collision.culling import motion, nothing_near, query_near
from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.array_records import choose
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import inverse, matvec, transform_points
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.rows import NEAR_DISTANCE_M, Linear, stack
from grasp_refine.refinement.terms.environment import Clearance
from grasp_refine.refinement.terms.self_penetration import SelfPenetration
from grasp_refine.refinement.terms.table import Table
from grasp_refine.refinement.terms.term import Setup, State, checked_rows
from grasp_refine.refinement.variables import variables
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

RESTART_NOISE = (0.01, 0.2, 0.1)
"""Standard deviations of the noise on restarts: palm and prismatic joints in metres; the palm in radians; joints in
radians."""

NOISE_CELL_M = 1e-6
"""Distance between hands, seen from the object, that get different noise although their joint values are the same."""

IK_ITERATIONS, IK_DAMPING = 8, 1e-3
"""Iterations of the position-only inverse kinematics before the first query, and their damping lambda."""


class GraspProblem:
    """Least-squares problems of the grasps of a scene; the object rests at the world's origin."""

    def __init__(self, scene: Scene, goal: Goal, config: Config, prepared: HandObject | None = None) -> None:
        """Set up the terms of the scene, with geometry that is `prepared` or built here."""
        prepared = prepared or HandObject.of(scene)
        self.scene, self.goal, self.config, self.prepared = scene, goal, config, prepared
        self.chain = prepared.chain
        self.axes = scene.T_world_root[:, :3, :3]
        self.boxes = prepared.boxes(scene.number, self.axes)
        clearance, around = clearances(config, prepared.hand, prepared.chain), prepared.surroundings(scene)
        setup = Setup(scene, goal, prepared, config.margin, config.scales, clearance, around)
        self.terms = config.terms_of(setup)
        self.setup, self.patched = setup, setup.flat
        self.aimed_columns = np.flatnonzero(goal.aimed.any(axis=0))
        self.width, self.restarts = config.width, len(self.aimed_columns) > 0
        self.variables = variables(scene, config.max_move, config.freeze)
        metres, turn, joint = RESTART_NOISE
        joints = np.where(scene.hand.slides, metres, joint)
        self.noise = np.concatenate([np.full(3, metres), np.full(3, turn), joints])

    def in_points(self) -> GraspProblem:
        """Return the problem without gaps at the corners where flat faces meet."""
        points = copy(self)
        points.patched = np.zeros_like(self.patched)
        return points

    def with_goal(self, goal: Goal) -> GraspProblem:
        """Return the problem with other links that should touch."""
        other = GraspProblem(self.scene, goal, self.config, self.prepared)
        other.restarts = self.restarts
        return other

    # interface of `levenberg_marquardt.LeastSquares`

    def evaluate(self, member: np.ndarray, point: Point, previous: State | None) -> State:
        """Evaluate kinematics and queries; links that should not touch are queried only where something is near."""
        frames = self.chain(point.T, point.q)
        T, count = frames.T_world_link, len(member)
        witness = self._against_object(member, T, previous)
        none, loss, rejected = np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count, dtype=bool)
        no_pairs = nothing_near(np.zeros((count, 0)))
        forces, nearby = (None, None) if previous is None else (previous.forces, previous.nearby)
        patches = self.setup.patches(member, T, witness) if self.patched.any() else None
        state = State(
            loss, none, member, point.T, point.q, T, frames.axes, witness, no_pairs, forces, patches, nearby=nearby
        )
        # Points that will be rejected anyway need neither forces nor queries of the pairs of links.
        for weight, term in sorted(self.terms, key=lambda weighted: weighted[1].cost):
            state = term.complete(state, rejected, partial(self._against_itself, T, previous))
            loss = loss + weight * np.where(rejected, 0.0, term.loss(state))
            rejected = rejected if previous is None else loss >= previous.loss
        pairs = witness, state.self_witness
        unknown = np.logical_or(*((found.status > QueryStatus.FAR).any(axis=1) for found in pairs))
        num_queries = sum(found.num_queries.sum(axis=1) for found in pairs)
        if state.nearby is not None:
            unknown, num_queries = unknown | state.nearby.failed, num_queries + state.nearby.num_queries
        return replace(state, loss=np.where(unknown, np.nan, loss), num_queries=num_queries)

    @stage("derivative")
    def linearize(self, member: np.ndarray, point: Point, known: State, width: np.ndarray) -> Linear:
        """Return residuals (M, m) and their derivatives; penetration has rows only where bodies are near."""
        rows = ((weight, part) for weight, term in self.terms for part in checked_rows(term, known, width))
        return stack(rows, len(member), self.chain, known.frames)

    def metric(self, member: np.ndarray) -> np.ndarray:
        """Return the squared movements in metres that count as much as a unit of each unknown, see `Variables`."""
        return self.variables.metric(member)

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of a step: joints to their limits, and no farther than `MAX_STEP`."""
        return self.variables.step_bounds(member, point)

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Return the grasps after steps, shortened to `MAX_STEP`, within joint limits and movement bounds."""
        return self.variables.integrate(member, point, dx)

    def project(self, member: np.ndarray, point: Point) -> Point:
        """Return the nearest grasps within the joint limits and the movement bounds from the initial grasps."""
        return self.variables.project(member, point)

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        """Return the best grasp or, every other time, the present one with noise, after inverse kinematics."""
        noise = self.noise * self.sample_noise(member, start)
        chosen = choose(start % 2 == 1, best, now)
        return self.solve_position_ik(member, self.variables.displace(member, chosen, noise))

    def sample_noise(self, member: np.ndarray, number: np.ndarray) -> np.ndarray:
        """Return standard normal numbers (M, 6 + n), the `number`-th (M,) sample of each grasp, palms first."""
        T_palm = self.variables.palm(Point(self.scene.T_world_root[member], self.scene.q[member]))
        return sample_noise(self.scene, T_palm, member, number, self.config.seed)

    def solve_position_ik(self, member: np.ndarray, point: Point) -> Point:
        """Solve inverse kinematics that brings target points on links to the object's, without any query."""
        if not (len(self.aimed_columns) and len(member)):
            return point
        columns = self.aimed_columns
        aimed = self.goal.aimed[member][:, columns]
        on_link = np.nan_to_num(self.goal.target_link[member][:, columns])
        on_object = np.nan_to_num(self.goal.target_object[member][:, columns])
        damping = np.full(len(member), IK_DAMPING)
        link = np.repeat(columns, 3)
        for _ in range(IK_ITERATIONS):
            frames = self.chain(point.T, point.q)
            p = transform_points(frames.T_world_link[:, columns], on_link)
            residual = np.where(aimed[..., None], p - on_object, 0.0).reshape(len(member), -1)
            forces = np.broadcast_to(np.eye(3), (*p.shape, 3))
            covector = np.concatenate([forces, np.cross(p[..., None, :], forces)], axis=-1)
            covector = np.where(aimed[..., None, None], covector, 0.0).reshape(len(member), -1, 6)
            lower, upper = self.step_bounds(member, point)
            J = self.chain.to_joint_space(frames, covector, link)
            dx, _ = bounded_step(J, residual, damping, self.metric(member), lower, upper)
            point = self.integrate(member, point, dx)
        return point

    def other_depth(self, state: State) -> np.ndarray:
        """Return the largest depth (M,) in metres of links in each other, below the table or in a body around."""
        terms = [term for _, term in self.terms if isinstance(term, SelfPenetration | Table | Clearance)]
        depth = [residual for term in terms for residual in term.residuals(state)]
        return np.concatenate([np.zeros((len(state.member), 1)), *depth], axis=1).max(axis=1)

    # queries

    @stage("broad phase")
    def _against_object(self, member: np.ndarray, T: np.ndarray, previous: State | None) -> Witness:
        """Return witness points of links and object; pairs that are not needed, or certainly apart, are FAR."""
        touching, spheres = self.goal.touching[member], self.prepared.bounding_spheres
        center = transform_points(T, spheres[:, :3])
        # Boxes along the axes of the initial grasps, so that the same links count as near in any frame.
        center, (low, high) = center @ self.axes[member], (side[member, None] for side in self.boxes)
        outside = np.maximum(np.maximum(low - center, center - high), 0.0)
        bound = np.sqrt((outside * outside).sum(axis=-1)) - spheres[:, 3]
        before = None
        if previous is not None:
            before = previous.witness
            bound = np.fmax(bound, before.distance - motion(spheres, previous.T_link, T))
        if self.config.weights.penetration == 0 and not self.config.terms and self.scene.regions is None:
            bound = np.where(np.isfinite(bound), np.inf, bound)
        T_object = np.broadcast_to(np.eye(4), T.shape)
        cutoff = np.where(touching, np.inf, NEAR_DISTANCE_M)
        if self.scene.regions is not None:
            # Links keep farther from where they should not touch than out of the object.
            bound, cutoff = bound - self.setup.reach, cutoff + self.setup.reach
        pair = self.prepared.pair(self.scene.number[member])
        return query_near(self.prepared.pairs, pair, bound, T, T_object, cutoff, before)

    @stage("broad phase")
    def _against_itself(self, T: np.ndarray, previous: State | None, rejected: np.ndarray) -> Witness:
        """Return witness points of the pairs of links that are near, except for rejected grasps (M,)."""
        pairs, spheres = self.prepared.self_collision_pairs, self.prepared.bounding_spheres
        assert pairs is not None  # a term has asked for them
        first, second = self.prepared.self_collision_links
        center = transform_points(T, spheres[:, :3])
        away = center[:, first] - center[:, second]
        bound = np.sqrt((away * away).sum(axis=-1)) - spheres[first, 3] - spheres[second, 3]
        before = None
        if previous is not None:
            before, moves = previous.self_witness, motion(spheres, previous.T_link, T)
            bound = np.fmax(bound, before.distance - moves[:, first] - moves[:, second])
        bound = np.where(rejected[:, None], np.inf, bound)
        pair, cutoff = np.broadcast_to(np.arange(len(pairs)), bound.shape), np.full(bound.shape, NEAR_DISTANCE_M)
        return query_near(pairs, pair, bound, T[:, first], T[:, second], cutoff, before)


def sample_noise(scene: Scene, T: np.ndarray, member: np.ndarray, number: np.ndarray, seed: int) -> np.ndarray:
    """Return standard normal numbers (M, 6 + n), the `number`-th (M,) sample of each grasp.

    They depend on the initial grasp, whose palm is at T (M, 4, 4), not on its place among others, and rotate with the
    scene.
    """
    noise = np.empty((len(member), 6 + scene.q.shape[1]))
    cell = np.round(transform_points(inverse(T), scene.centers(member)) / NOISE_CELL_M).astype(np.int64)
    for row, (m, k) in enumerate(zip(member.tolist(), number.tolist(), strict=True)):
        key = crc32(cell[row].tobytes() + scene.q[m].tobytes())
        noise[row] = np.random.default_rng((seed, key, k)).normal(size=noise.shape[1])
    for part in (slice(3), slice(3, 6)):
        noise[:, part] = matvec(T[:, :3, :3], noise[:, part])
    return noise
