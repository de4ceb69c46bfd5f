"""Derivatives of the witness layer against finite differences and closed forms."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_se3, inverse, matvec, transform_points
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.distance import Distance, scores_of, smooth, temperature
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from shapes_for_tests import BODY_PAIRS, convex_body
from twists import (
    layer_gradient,
    poses_at_gap,
    slopes_along_twists,
)

# (a) distance smoothing against its own smoothed point


@pytest.mark.parametrize("gap", [0.004, -0.004])
@pytest.mark.parametrize(
    "rule", [Adaptive(), Adaptive(samples=None), Fixed(0.2), Neighbor()], ids=["16", "all", "fixed", "neighbor"]
)
def test_distance_smoothing_differentiates_its_own_smoothed_point(
    rule: Adaptive | Fixed | Neighbor, gap: float
) -> None:
    pairs = Pairs((convex_body(0, 300),), (convex_body(1, 300),))
    T_a, T_b = poses_at_gap(pairs, 4, gap, seed=9)
    w = query(pairs, T_a, T_b)
    layer = WitnessLayer(pairs, Distance(rule, smoothed_self=True))
    scene = WitnessScene(*layer.columns(np.array([0])), T_a, T_b, w, None, None, 0)
    sides, near = scene.neighbors(rule, 0)
    tau = temperature(near, scores_of(near, sides.other))

    # The slip matrix: the smoothed point of the body at rest, as the other point moves.
    _, slip = smooth(near, sides.other, tau)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        slope = (smooth(near, sides.other + h, tau)[0] - smooth(near, sides.other - h, tau)[0]) / 2e-6
        np.testing.assert_allclose(slip[..., k], slope, atol=1e-6)

    # The self term: body a moves, the other witness y stays. dx* = V(x*) - A V(y).
    def smoothed_world(T: np.ndarray) -> np.ndarray:
        y = transform_points(inverse(T), w.point_b).swapaxes(0, 1)
        y = np.concatenate([y, sides.other[1:]])
        return transform_points(T, smooth(near, y, tau)[0][:1].swapaxes(0, 1))

    A = sides.rotation[:1] @ slip[:1] @ sides.rotation[:1].mT
    x_star = smoothed_world(T_a)
    for k in range(6):
        twist = np.eye(6)[k]
        slope = (smoothed_world(exp_se3(1e-6 * twist) @ T_a) - smoothed_world(exp_se3(-1e-6 * twist) @ T_a)) / 2e-6
        v, u = (twist[:3] + np.cross(twist[3:], p) for p in (x_star, w.point_b))
        np.testing.assert_allclose(v - matvec(A.swapaxes(0, 1), u), slope, atol=1e-6)


# (b) the exact signed-distance gradient


@pytest.mark.parametrize("gap", [0.01, 1e-4, -0.003])
@pytest.mark.parametrize("bodies", BODY_PAIRS)
def test_signed_distance_gradient_is_exact(bodies: str, gap: float) -> None:
    a, b = BODY_PAIRS[bodies]()
    pairs = Pairs((a,), (b,))
    T_a, T_b = poses_at_gap(pairs, 24, gap, seed=11)
    step = 1e-6

    def distance(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        return query(pairs, T_a, T_b).distance[:, 0]

    expected = slopes_along_twists(distance, T_a, T_b, step)
    found = layer_gradient(WitnessLayer(pairs, Distance()), T_a, T_b, {"distance": np.ones((24, 1))})
    # The witness pair is unique where both one-sided differences are the same.
    bend = np.zeros(24)
    for twist in np.concatenate([np.eye(6), -np.eye(6)]):
        M = exp_se3(step * twist)
        for ends in ((M @ T_a, T_b, inverse(M) @ T_a, T_b), (T_a, M @ T_b, T_a, inverse(M) @ T_b)):
            both = distance(*ends[:2]) + distance(*ends[2:]) - 2.0 * distance(T_a, T_b)
            bend = np.maximum(bend, np.abs(both) / step)
    unique = bend < 1e-3
    assert unique.sum() >= 12
    np.testing.assert_allclose(found[:, unique], expected[:, unique], atol=1e-6)


# the layer as a torch function
