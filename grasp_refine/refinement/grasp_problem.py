"""Least-squares problems over root pose and joint values, one per grasp of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from grasp_refine.collision.culling import motion, nothing_near, query_near
from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.array_records import choose
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import matvec, tangents, transform_points
from grasp_refine.forces.equilibrium import Balance, Equilibrium
from grasp_refine.forces.wrench import center_of_mass
from grasp_refine.hands.chain import Frames, integrate
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.goal import Goal
from grasp_refine.refinement.losses import (
    below_plane,
    contact_direction,
    contact_direction_covectors,
    contact_gap,
    contact_targets,
    contact_targets_covectors,
    gap_covectors,
    penetration,
    plane_covectors,
    plane_depth,
    stay_near,
    stay_near_jacobian,
)
from grasp_refine.refinement.solvers.least_squares import Linear, Point
from grasp_refine.refinement.solvers.levenberg_marquardt import bounded_step
from grasp_refine.refinement.solvers.rows import NEAR_DISTANCE_M, Rows
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

ROTATION_M_PER_RAD, JOINTS_M_PER_RAD = 0.05, 0.04
"""Movement of the root in metres that counts as much as one radian of the root, and of a joint."""

MAX_STEP = (0.05, 1.0, 0.5)
"""Bounds of a step: of the root, and of prismatic joints, in metres; of the root in radians; of joints in radians."""

RESTART_NOISE = (0.01, 0.2, 0.1)
"""Standard deviations of the noise on restarts, in the same order."""

SMOOTH = 0.008
"""Radius in metres of the neighbourhoods in which surface normals determine curvature for the equilibrium."""

IK_ITERATIONS, IK_DAMPING = 8, 1e-3
"""Iterations of the position-only inverse kinematics before the first query, and their damping lambda."""


@dataclass(frozen=True, eq=False)
class Known:
    """M grasps at a point: poses of their links, witness points, contact forces."""

    loss: np.ndarray
    """Losses (M,) in m^2; NaN where a query could not be answered."""
    num_queries: np.ndarray
    """Narrow-phase queries (M,) of this evaluation."""
    T_link: np.ndarray
    """Poses of the links (M, L, 4, 4)."""
    axes: np.ndarray
    """Unit twists of root and joints (M, 6, 6 + m)."""
    witness: Witness
    """Witness points of links and object (M, L)."""
    self_witness: Witness
    """Witness points of pairs of links (M, S)."""
    forces: Balance | None
    """Optimal contact forces, where the equilibrium has a weight."""


class GraspProblem:
    """Least-squares problems of the grasps of a scene; the object rests at the world's origin."""

    def __init__(self, scene: Scene, goal: Goal, config: Config, prepared: HandObject | None = None) -> None:
        """Set up the terms of the scene, with geometry that is `prepared` or built here."""
        prepared = prepared or HandObject.of(scene)
        self.scene, self.goal, self.config = scene, goal, config
        hand, weights = scene.hand, config.weights
        self.chain, self.pairs, self.bounding_spheres, self.box = (
            prepared.chain,
            prepared.pairs,
            prepared.bounding_spheres,
            prepared.box,
        )
        self.self_collision_pairs = prepared.self_collision_pairs if weights.self_penetration > 0 else None
        self.own_first, self.own_second = (
            prepared.self_collision_links if self.self_collision_pairs is not None else np.zeros((2, 0), dtype=int)
        )
        plane = scene.table if weights.table > 0 else None
        self.table = None if plane is None else (np.asarray(plane.normal), plane.offset)
        self.aimed_columns = np.flatnonzero(goal.aimed.any(axis=0))
        self.gap_columns = np.flatnonzero((goal.touching & ~goal.aimed).any(axis=0))
        self.touching_columns = np.flatnonzero(goal.touching.any(axis=0))
        self.equilibrium = None
        if weights.wrench > 0 and not goal.aimed.any() and len(self.touching_columns):
            self.equilibrium = Equilibrium.of(hand, self.chain, center_of_mass(scene.object))
        self.aims = len(self.aimed_columns) > 0 or goal.direction is not None
        self.curvatures = prepared.curvatures if self.aims or self.equilibrium is not None else None
        prismatic = np.array([hand.joints_by_name[name].kind == "prismatic" for name in hand.joint_names], dtype=bool)
        joints = np.where(prismatic, 1.0, JOINTS_M_PER_RAD**2)
        self.scales = np.concatenate([np.ones(3), np.full(3, ROTATION_M_PER_RAD**2), joints])
        self.step, self.noise = (
            np.concatenate([np.full(3, metres), np.full(3, root), np.where(prismatic, metres, joint)])
            for metres, root, joint in (MAX_STEP, RESTART_NOISE)
        )

    # interface of `least_squares.Problem`

    def evaluate(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        """Evaluate kinematics and queries; links that should not touch are queried only where something is near."""
        frames = self.chain(point.T, point.q)
        T = frames.T_world_link
        witness = self._against_object(member, T, previous)
        loss, weights = self._loss(member, point, T, witness), self.config.weights
        # Points that will be rejected anyway need no queries of the pairs of links.
        rejected = np.zeros(len(member), dtype=bool) if previous is None else loss >= previous.loss
        forces = None
        if self.equilibrium is not None:
            forces = self.equilibrium.forces(self.goal.touching[member] & ~rejected[:, None], witness, frames)
            loss = loss + weights.wrench * np.where(rejected, 0.0, forces.value)
            rejected = rejected if previous is None else loss >= previous.loss
        own = self._against_itself(T, previous, rejected)
        if self.self_collision_pairs is not None:
            loss = loss + weights.self_penetration * (penetration(own) ** 2).sum(axis=1)
        num_queries = witness.num_queries.sum(axis=1) + own.num_queries.sum(axis=1)
        unknown = (witness.status > QueryStatus.FAR).any(axis=1) | (own.status > QueryStatus.FAR).any(axis=1)
        loss = np.where(unknown, np.nan, loss)
        return Known(loss, num_queries, T, frames.axes, witness, own, forces)

    @stage("derivative")
    def linearize(self, member: np.ndarray, point: Point, known: Known, width: np.ndarray) -> Linear:
        """Return residuals (M, m) and their derivatives; penetration has rows only where bodies are near."""
        weights = self.config.weights
        rows = Rows(len(member))
        self._add_contacts(rows, member, known, width)
        if weights.penetration > 0:
            w = known.witness
            rows.add_unilateral(np.where(w.valid, -w.distance, -np.inf), -gap_covectors(w), weights.penetration)
        if self.self_collision_pairs is not None:
            w = known.self_witness
            rows.add_unilateral(
                np.where(w.valid, -w.distance, -np.inf), -gap_covectors(w), weights.self_penetration,
                self.own_first, self.own_second,
            )  # fmt: skip
        if self.table is not None:
            normal, offset = self.table
            points = self._lowest(known.T_link)
            rows.add_unilateral(plane_depth(points, normal, offset), plane_covectors(points, normal), weights.table)
        linear = rows.joint_covectors(self.chain, Frames(known.T_link, known.axes))
        if self.equilibrium is not None:
            linear = linear.with_rows(weights.wrench, *self._balance(member, known, width))
        if weights.stay_near > 0:
            away = self._away(member, point)
            linear = linear.with_rows(weights.stay_near, away, stay_near_jacobian(away, self.config.scales))
        return linear

    def metric(self, member: np.ndarray) -> np.ndarray:
        """Return 1 for translations, `ROTATION_M_PER_RAD`^2 and `JOINTS_M_PER_RAD`^2 for rotations."""
        return np.broadcast_to(self.scales, (len(member), len(self.scales)))

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of a step: joints to their limits, nothing farther than `MAX_STEP`."""
        hand = self.scene.hand
        lower, upper = np.tile(-self.step, (len(member), 1)), np.tile(self.step, (len(member), 1))
        lower[:, 6:] = np.maximum(lower[:, 6:], hand.lower - point.q)
        upper[:, 6:] = np.minimum(upper[:, 6:], hand.upper - point.q)
        return lower, upper

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Return the grasps after steps, projected onto joint limits and movement bounds."""
        return self.project(member, Point(integrate(point.T, dx[:, :6]), point.q + dx[:, 6:]))

    def project(self, member: np.ndarray, point: Point) -> Point:
        """Return the nearest grasps within the joint limits and the movement bounds from the initial grasps."""
        scene = self.scene
        T, q = self.config.max_move.project(point.T, point.q, scene.T_world_root[member], scene.q[member])
        return Point(T, np.minimum(np.maximum(q, scene.hand.lower), scene.hand.upper))

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        """Return the best grasp or, every other time, the present one with noise, after inverse kinematics."""
        noise = self.noise * sample_noise(self.scene, member, start, self.config.seed)
        return self.solve_position_ik(member, self.integrate(member, choose(start % 2 == 1, best, now), noise))

    def solve_position_ik(self, member: np.ndarray, point: Point) -> Point:
        """Solve inverse kinematics that brings target points on links to those on the object, without any query."""
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

    def other_depth(self, known: Known) -> np.ndarray:
        """Return the largest depth (M,) in metres of links in each other or below the table."""
        depth = penetration(known.self_witness).max(axis=1, initial=0.0)
        if self.table is not None:
            depth = np.maximum(depth, below_plane(self._lowest(known.T_link), *self.table).max(axis=1))
        return depth

    # queries

    @stage("broad phase")
    def _against_object(self, member: np.ndarray, T: np.ndarray, previous: Known | None) -> Witness:
        """Return witness points of links and object; pairs that are not needed, or certainly apart, are FAR."""
        touching = self.goal.touching[member]
        center = transform_points(T, self.bounding_spheres[:, :3])
        low, high = self.box
        outside = np.maximum(np.maximum(low - center, center - high), 0.0)
        bound = np.sqrt((outside * outside).sum(axis=-1)) - self.bounding_spheres[:, 3]
        before = None
        if previous is not None:
            before = previous.witness
            bound = np.fmax(bound, before.distance - motion(self.bounding_spheres, previous.T_link, T))
        if self.config.weights.penetration == 0:
            bound = np.where(np.isfinite(bound), np.inf, bound)
        T_object = np.broadcast_to(np.eye(4), T.shape)
        return query_near(self.pairs, bound, T, T_object, np.where(touching, np.inf, NEAR_DISTANCE_M), before)

    @stage("broad phase")
    def _against_itself(self, T: np.ndarray, previous: Known | None, rejected: np.ndarray) -> Witness:
        """Return witness points of the pairs of links that are near, except for rejected grasps (M,)."""
        if self.self_collision_pairs is None:
            return nothing_near(np.zeros((len(T), 0)))
        first, second = self.own_first, self.own_second
        center = transform_points(T, self.bounding_spheres[:, :3])
        away = center[:, first] - center[:, second]
        bound = np.sqrt((away * away).sum(axis=-1)) - self.bounding_spheres[first, 3] - self.bounding_spheres[second, 3]
        before = None
        if previous is not None:
            before, moves = previous.self_witness, motion(self.bounding_spheres, previous.T_link, T)
            bound = np.fmax(bound, before.distance - moves[:, first] - moves[:, second])
        bound = np.where(rejected[:, None], np.inf, bound)
        return query_near(
            self.self_collision_pairs, bound, T[:, first], T[:, second], np.full(bound.shape, NEAR_DISTANCE_M), before
        )

    # terms

    def _loss(self, member: np.ndarray, point: Point, T: np.ndarray, witness: Witness) -> np.ndarray:
        """Return the weighted sum of squares (M,), without those of pairs of links."""
        goal, config, weights = self.goal, self.config, self.config.weights
        touching = goal.touching[member]
        total = np.zeros(len(member))
        if len(self.aimed_columns):
            columns = self.aimed_columns
            residual = contact_targets(
                witness.pairs(columns),
                T[:, columns],
                np.broadcast_to(np.eye(4), T[:, columns].shape),
                goal.target_link[member][:, columns],
                goal.target_object[member][:, columns],
                config.margin,
            )
            total += weights.contact * (residual**2).sum(axis=(1, 2))
            touching = touching & ~goal.aimed[member]
        if len(self.gap_columns):
            total += weights.contact * (contact_gap(witness, touching, config.margin) ** 2).sum(axis=1)
        if weights.penetration > 0:
            total += weights.penetration * (penetration(witness) ** 2).sum(axis=1)
        if self.table is not None:
            total += weights.table * (below_plane(self._lowest(T), *self.table) ** 2).sum(axis=1)
        if goal.direction is not None:
            total += weights.direction * (contact_direction(witness, goal.direction[member]) ** 2).sum(axis=(1, 2))
        if weights.stay_near > 0:
            total += weights.stay_near * (self._away(member, point) ** 2).sum(axis=1)
        return total

    def _lowest(self, T: np.ndarray) -> np.ndarray:
        """Return the lowest point of each link (M, L, 3) over the table, world frame."""
        assert self.scene.table is not None
        return transform_points(T, self.scene.table.lowest(self.pairs.a, T))

    def _away(self, member: np.ndarray, point: Point) -> np.ndarray:
        scene = self.scene
        return stay_near(point.T, point.q, scene.T_world_root[member], scene.q[member], self.config.scales)

    def _add_contacts(self, rows: Rows, member: np.ndarray, known: Known, width: np.ndarray) -> None:
        """Add the rows of targets, gaps and target normals."""
        goal, config, weights = self.goal, self.config, self.config.weights
        if self.aims:
            columns = self.aimed_columns
            if goal.direction is not None:
                columns = np.union1d(columns, np.flatnonzero(~np.isnan(goal.direction[..., 0]).all(axis=0)))
            w = known.witness.pairs(columns)
            T = known.T_link[:, columns]
            E = tangents(np.where(w.valid[..., None], w.normal, [0.0, 0.0, 1.0]))
            miss_link = w.point_a - transform_points(T, goal.target_link[member][:, columns])
            miss_object = w.point_b - goal.target_object[member][:, columns]
            reach = np.stack([np.linalg.norm(miss, axis=-1) for miss in (miss_link, miss_object)])
            aimed = goal.aimed[member][:, columns] & w.valid
            needed = aimed
            if goal.direction is not None:
                turned = contact_direction(w, goal.direction[member][:, columns])
                wanted = (turned != 0).any(axis=-1)
                needed = aimed | wanted
            K_link, K_object = self._curvatures(needed, columns, T, w, E, reach, width)
            aimed = aimed[..., None]
            misses = [matvec(E.mT, np.where(aimed, miss, 0.0)) for miss in (miss_link, miss_object)]
            gap = np.where(aimed, w.distance[..., None] - config.margin, 0.0)
            covector = contact_targets_covectors(w, E, K_link, K_object)
            covector = np.where(aimed[..., None], covector, 0.0)
            rows.add(np.concatenate([gap, *misses], axis=-1), covector, weights.contact, columns)
            if goal.direction is not None:
                covector = contact_direction_covectors(w, E, K_link, K_object)
                rows.add(turned, np.where(wanted[..., None, None], covector, 0.0), weights.direction, columns)
        if len(self.gap_columns):
            columns = self.gap_columns
            w = known.witness.pairs(columns)
            touching = (goal.touching & ~goal.aimed)[member][:, columns] & w.valid
            covector = np.where(touching[..., None], gap_covectors(w), 0.0)
            gap = contact_gap(w, touching, config.margin)
            rows.add(gap[..., None], covector[..., None, :], weights.contact, columns)

    def _balance(self, member: np.ndarray, known: Known, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of the equilibrium."""
        assert known.forces is not None and self.equilibrium is not None
        columns = self.touching_columns
        w = known.witness.pairs(columns)
        T = known.T_link[:, columns]
        E = tangents(np.where(w.valid[..., None], w.normal, [0.0, 0.0, 1.0]))
        reach = np.full((2, *w.distance.shape), 0.5 * SMOOTH)
        K_link, K_object = self._curvatures(known.forces.pressed[:, columns], columns, T, w, E, reach, width)
        return self.equilibrium.rows(known.forces, columns, w, Frames(known.T_link, known.axes), E, K_link, K_object)

    def _curvatures(
        self,
        needed: np.ndarray,
        columns: np.ndarray,
        T: np.ndarray,
        w: Witness,
        E: np.ndarray,
        reach: np.ndarray,
        width: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the curvatures (M, C, 2, 2) of links and object, fitted where `needed` (M, C).

        Elsewhere, and without witness points, they are those of spheres of 1 m and mean nothing. Where the `width` is
        1, neighbourhoods have twice the radius `reach` (2, M, C), of links and object.
        """
        shape = w.distance.shape
        item = np.flatnonzero((needed & w.valid).reshape(-1))
        count = len(item)
        assert self.curvatures is not None
        K = self.curvatures.fit(
            np.tile(columns, shape[0])[item],
            T.reshape(-1, 4, 4)[item],
            np.broadcast_to(np.eye(4), (count, 4, 4)),
            w.reshape(-1).rows(item),
            E.reshape(-1, 3, 2)[item],
            np.nan_to_num(reach.reshape(2, -1)[:, item]),
            np.repeat(width, shape[1])[item],
        )
        every = np.broadcast_to(np.eye(2), (2, shape[0] * shape[1], 2, 2)).copy()
        every[0, item], every[1, item] = K
        return every[0].reshape(*shape, 2, 2), every[1].reshape(*shape, 2, 2)


def sample_noise(scene: Scene, member: np.ndarray, number: np.ndarray, seed: int) -> np.ndarray:
    """Return standard normal numbers (M, 6 + n), the `number`-th (M,) sample of each grasp.

    They depend on the initial grasp, not on its place among others.
    """
    noise = np.empty((len(member), 6 + scene.q.shape[1]))
    for row, (m, k) in enumerate(zip(member.tolist(), number.tolist(), strict=True)):
        key = crc32(scene.T_world_root[m].tobytes() + scene.q[m].tobytes())
        noise[row] = np.random.default_rng((seed, key, k)).normal(size=noise.shape[1])
    return noise
