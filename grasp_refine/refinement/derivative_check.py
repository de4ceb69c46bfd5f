"""Comparison of the derivatives of a loss with central differences, for terms of ours and of users."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import matvec
from grasp_refine.hands.chain import integrate
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import Point

STEP = 1e-6
"""Step of finite differences, in m and rad."""


def finite_differences(problem: object, point: Point) -> Float[np.ndarray, "M k"]:
    """Return the gradients (M, 6 + n) of the losses of M grasps by central differences.

    Unknowns are the translation of the root and its rotation about its own origin, both along world axes, then the
    joint values.

    Args:
        problem: `GraspProblem` or `Objective` of the M grasps.
        point: The grasps.
    """
    count, n = point.q.shape

    def loss(dx: np.ndarray) -> np.ndarray:
        moved = Point(integrate(point.T, np.tile(dx[:6], (count, 1))), point.q + dx[6:])
        found: np.ndarray = problem.evaluate(np.arange(count), moved, None).loss  # type: ignore[attr-defined]
        return found

    ahead_and_behind = [loss(STEP * e) - loss(-STEP * e) for e in np.eye(6 + n)]
    return np.stack(ahead_and_behind, axis=1) / (2.0 * STEP)


def gradients(problem: object, point: Point) -> Float[np.ndarray, "M k"]:
    """Return the gradients that the problem itself gives its solver, in the unknowns of `finite_differences`."""
    member = np.arange(len(point.q))
    if isinstance(problem, GraspProblem):
        known = problem.evaluate(member, point, None)
        linear = problem.linearize(member, point, known, np.zeros(len(member)))
        counts = np.ones(linear.residual.shape, dtype=bool)
        if linear.unilateral is not None:
            counts = ~linear.unilateral | (linear.residual > 0)
        return 2.0 * np.einsum("brk,br->bk", linear.jacobian, np.where(counts, linear.residual, 0.0))
    slope = problem.evaluate(member, point, None).gradient  # type: ignore[attr-defined]
    v, w = (matvec(point.T[:, :3, :3], slope[:, part]) for part in (slice(0, 3), slice(3, 6)))
    # The body twist of a gradient has half of its derivative along a rotation.
    return np.concatenate([v, 2.0 * w, slope[:, 6:]], axis=1)


def relative_errors(
    found: Float[np.ndarray, "M k"], expected: Float[np.ndarray, "M k"], smallest: float
) -> Float[np.ndarray, " M"]:
    """Return the errors (M,) of gradients (M, k) as parts of the expected ones, or of `smallest`, if that is larger."""
    scale = np.linalg.norm(expected, axis=1)
    return np.linalg.norm(found - expected, axis=1) / np.maximum(scale, smallest)
