"""Alignment tasks as least-squares problems over the pose of body b, for Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, Witness, query_items
from grasp_refine.se3 import cross, exp_so3, matvec, tangents, transform, transform_points
from grasp_refine.solvers.batch import choose
from grasp_refine.solvers.least_squares import Point
from grasp_refine.witness.contact_kinematics import slide
from grasp_refine.witness.pair_curvature import PairCurvatures

from .bodies import BodyPair
from .tasks import Tasks


NEAR, FAR = (0.01, 1.0), (0.3, 2.0)
"""Angles of new starts in radians: from the best pose (evenly in the logarithm), and from the present one."""

TURN = 2.0
"""Most radians of a step."""


@dataclass(frozen=True, eq=False)
class Known:
    """Tasks at a pose; M rows."""

    residual: np.ndarray
    """[d - beta, E^T (x_a - t_a), E^T (x_b - t_b)] (M, 5): the misses across the normal have no derivative."""
    loss: np.ndarray
    """(d - beta)^2 + |x_a - t_a|^2 + |x_b - t_b|^2 (M,) in square metres."""
    asked: np.ndarray
    witness: Witness
    E: np.ndarray
    """Tangents (M, 3, 2)."""
    pivot: np.ndarray
    """Target of body b (M, 3), world frame: steps turn about it."""
    miss: np.ndarray
    """|x_a - t_a| and |x_b - t_b| (M, 2) in metres."""


class AlignProblem:
    """The tasks of P pairs of bodies; bodies a rest."""

    def __init__(self, bodies: Sequence[BodyPair], tasks: Sequence[Tasks], margin: float, seed: int) -> None:
        """Members are the tasks of the first pair, then those of the second, and so on."""
        self.pairs = Pairs(tuple(pair.a for pair in bodies), tuple(pair.b for pair in bodies))
        self.pair = np.repeat(np.arange(len(bodies)), [len(t) for t in tasks])
        self.tasks, self.margin, self.seed = Tasks.join(tasks), margin, seed
        self.curvatures = PairCurvatures.of(self.pairs, smallest=1.0)
        self.length = np.array([0.25 * (pair.a.diagonal + pair.b.diagonal) for pair in bodies])
        self.several = any(len(body.pieces) > 1 for body in (*self.pairs.a, *self.pairs.b))

    def evaluate(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        """One query of each task."""
        T_a = self.tasks.T_world_a[member]
        before = previous.witness if previous is not None and self.several else None
        w = query_items(self.pairs, self.pair[member], T_a, point.T, previous=before)
        pivot = transform_points(point.T, self.tasks.target_b[member])
        miss_a = w.point_a - transform_points(T_a, self.tasks.target_a[member])
        miss_b = w.point_b - pivot
        E = tangents(w.normal)
        gap = w.distance - self.margin
        residual = np.concatenate([gap[:, None], matvec(E.mT, miss_a), matvec(E.mT, miss_b)], axis=1)
        a, b = (miss_a**2).sum(axis=1), (miss_b**2).sum(axis=1)
        loss = np.where(w.valid, gap**2 + a + b, np.nan)
        return Known(residual, loss, w.asked, w, E, pivot, np.sqrt(np.stack([a, b], axis=1)))

    def linearize(self, member: np.ndarray, point: Point, known: Known, width: np.ndarray) -> np.ndarray:
        """Jacobians (M, 5, 6) in the twist of body b about its target."""
        w = known.witness
        T_a = self.tasks.T_world_a[member]
        K_a, K_b = self.curvatures.fit(self.pair[member], T_a, point.T, w, known.E, known.miss.T, width)
        arm = w.point_b - known.pivot
        U_a, U_b = slide(arm, w.normal, w.distance, known.E, K_a, K_b)
        gap = np.concatenate([w.normal, cross(arm, w.normal)], axis=1)[:, None]
        return np.concatenate([gap, U_a, U_b], axis=1)

    def metric(self, member: np.ndarray) -> np.ndarray:
        """A quarter of both diagonals, l: W = diag(1, 1, 1, l^2, l^2, l^2)."""
        length = self.length[self.pair[member], None]
        return np.concatenate([np.ones((len(member), 3)), np.repeat(length**2, 3, axis=1)], axis=1)

    def room(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """No bounds."""
        free = np.full((len(member), 6), np.inf)
        return -free, free

    def moved(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Body b turned about its target."""
        pivot = transform_points(point.T, self.tasks.target_b[member])
        turn = np.sqrt((dx[:, 3:] ** 2).sum(axis=1, keepdims=True))
        dx = dx * (TURN / np.maximum(turn, TURN))
        return Point(_turned(point.T, pivot, dx[:, 3:], pivot + dx[:, :3]), point.q)

    def restarted(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        """Body b turned at random about its target, which is put onto that of body a.

        Every third time by any small angle from the best pose, else far from the present one.
        """
        w = np.empty((len(member), 3))
        near = start % 3 == 0
        for row, (m, k, close) in enumerate(zip(member.tolist(), start.tolist(), near.tolist(), strict=True)):
            rng = np.random.default_rng((self.seed, m, k))
            axis = rng.normal(size=3)
            angle = np.exp(rng.uniform(*np.log(NEAR))) if close else rng.uniform(*FAR)
            w[row] = axis / np.linalg.norm(axis) * angle
        T = choose(near, best.T, now.T)
        pivot = transform_points(T, self.tasks.target_b[member])
        goal = transform_points(self.tasks.T_world_a[member], self.tasks.target_a[member])
        return Point(_turned(T, pivot, w, goal), now.q)


def _turned(T: np.ndarray, pivot: np.ndarray, w: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Poses turned by rotation vectors w (M, 3), so that the points `pivot` (M, 3) of the bodies come to `to`."""
    R = exp_so3(w)
    moved = R @ T[:, :3, :3]
    moved = moved @ (1.5 * np.eye(3) - 0.5 * moved.mT @ moved)
    return transform(moved, to + matvec(R, T[:, :3, 3] - pivot))
