"""The unit of length means nothing: a world that is s times as large moves as the small one does, by every method."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch

from compiled import COMPILED
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import tangents
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box, sphere
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.pair_curvature import CORNER_CURVATURE_PER_M, PairCurvatures
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.size import length_factor
from grasp_refine.witness.zeroth_order import ZerothOrder
from shapes_for_tests import BODY_PAIRS
from twists import gradient_along_twists, layer_gradient, poses_at_gap, random_cotangents

RULES = {
    "adaptive": Adaptive(),
    "adaptive, all": Adaptive(samples=None),
    "fixed": Fixed(),
    "fixed, all": Fixed(samples=None),
}
METHODS: dict[str, Derivative] = {
    **{f"contact kinematics, {name}": ContactKinematics(rule, sampled=True) for name, rule in RULES.items()},
    **{f"contact kinematics, {type(rule).__name__}": ContactKinematics(rule) for rule in (Adaptive(), Fixed())},
    **{f"distance, {name}": Distance(rule) for name, rule in RULES.items()},
    "distance, adaptive, one-sided, smoothed": Distance(coupling="one-sided", smoothed_self=True),
    **{f"direction, {name}": Direction(rule) for name, rule in RULES.items()},
    "direction, given temperature": Direction(epsilon=1e-3),
    "analytical": Analytical(),
    "analytical, one-sided": Analytical(coupling="one-sided"),
    "rigid": Rigid(),
    "finite difference": FiniteDifference(),
    "zeroth order": ZerothOrder(),
}
FIELDS = ("point_a", "point_b", "normal", "distance")

SCALES = (1e-3, 2.0**-9, 0.1, 8.0, 100.0)
"""Bodies of about 0.1 m become 0.1 mm to 10 m."""

GAPS = (0.02, 1e-4, -0.002)

BODIES = [name for name in BODY_PAIRS if name != "ring and hull"]


def scaled(body: Body, s: float) -> Body:
    return build_body(body.name, [piece.scaled(s) for piece in body.pieces])


def larger(T: np.ndarray, s: float) -> np.ndarray:
    T = T.copy()
    T[..., :3, 3] *= s
    return T


@dataclass(frozen=True, eq=False)
class World:
    """Two bodies at several poses, with targets for half of them."""

    pairs: Pairs
    T_a: np.ndarray
    T_b: np.ndarray
    targets: np.ndarray
    witness: Witness
    s: float
    """How many times as large it is as it was once."""

    @staticmethod
    def of(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, targets: np.ndarray, s: float) -> "World":
        return World(pairs, T_a, T_b, targets, query(pairs, T_a, T_b), s)

    def derivative(self, method: Derivative) -> np.ndarray:
        """Derivatives (12, batch) of fixed forms of x, s n and d in (v, w / s) of both bodies."""

        def layer(*poses: torch.Tensor) -> Witness:
            return WitnessLayer(self.pairs, method)(*poses, *torch.from_numpy(self.targets))

        cotangents = random_cotangents(self.witness, FIELDS, seed=4)
        cotangents["normal"] *= self.s
        found = layer_gradient(layer, self.T_a, self.T_b, cotangents)
        return found / np.tile([1.0, 1.0, 1.0, self.s, self.s, self.s], 2)[:, None]


@cache
def world(shapes: str, s: float = 1.0) -> World:
    if s != 1.0:
        one = world(shapes)
        pairs = Pairs(*((scaled(body, s),) for body in (*one.pairs.a, *one.pairs.b)))
        return World.of(pairs, larger(one.T_a, s), larger(one.T_b, s), s * one.targets, s)
    a, b = (scaled(body, 1.0) for body in BODY_PAIRS[shapes]())
    pairs = Pairs((a,), (b,))
    poses = (poses_at_gap(pairs, 4, gap, seed=3) for gap in GAPS)
    T_a, T_b = (np.concatenate(T) for T in zip(*poses, strict=True))
    # Not one of the candidates, which would lie on the rim of its own neighbourhood.
    targets = np.stack([0.7 * body.candidates.points[: len(T_a), None] for body in (a, b)])
    targets[:, ::2] = np.nan
    return World.of(pairs, T_a, T_b, targets, 1.0)


@cache
def expected(name: str, shapes: str) -> np.ndarray:
    return world(shapes).derivative(METHODS[name])


def difference(found: np.ndarray, name: str, shapes: str) -> np.ndarray:
    return np.abs(found - expected(name, shapes)).max(axis=0) / np.abs(expected(name, shapes)).max(axis=0)


@pytest.mark.parametrize("shapes", BODIES)
@pytest.mark.parametrize("name", METHODS)
def test_the_derivative_scales_with_the_world(name: str, shapes: str) -> None:
    w = world(shapes).witness
    for s in SCALES:
        v = world(shapes, s).witness
        # The witness points are the same first of all: a tie of two pieces may be broken otherwise.
        apart = np.abs(np.stack([v.point_a / s - w.point_a, v.point_b / s - w.point_b])).max(axis=(0, 2, 3))
        same = apart < 1e-9
        assert same.mean() > 0.9
        error = difference(world(shapes, s).derivative(METHODS[name]), name, shapes)
        assert error[same].max() < (1e-6 if COMPILED else 1e-4), s


@pytest.mark.parametrize("name", METHODS)
def test_far_from_the_origin_bodies_move_as_they_do_near_it(name: str) -> None:
    """A million metres away, where positions are rounded to 1e-10 m: coupled slips once lost their moments there."""
    w = world("sphere and box")
    near = expected_about_the_points(w, METHODS[name], np.zeros(3))
    far = expected_about_the_points(w, METHODS[name], np.array([6e5, -4.8e5, 6.4e5]))
    assert np.abs(far - near).max() < 1e-6 * np.abs(near).max()


def expected_about_the_points(w: World, method: Derivative, shift: np.ndarray) -> np.ndarray:
    """Derivatives (12, batch) of x_a + x_b in the twists of the bodies about x_b, D apart."""
    poses = []
    for T in (w.T_a, w.T_b):
        poses.append(torch.from_numpy(T + np.pad(shift[:, None], ((0, 1), (3, 0)))).requires_grad_())
    found = WitnessLayer(w.pairs, method)(*poses)
    (found.point_a.sum() + found.point_b.sum()).backward()
    pivot = found.point_b.detach().numpy()
    return np.concatenate([_about(pose, pivot) for pose in poses])


def _about(pose: torch.Tensor, pivot: np.ndarray) -> np.ndarray:
    """The gradient of poses (batch, 1, 4, 4) as derivatives (6, batch) in twists about the pivots (batch, 1, 3)."""
    T = pose.detach().numpy().copy()
    T[..., :3, 3] -= pivot
    return gradient_along_twists(pose.grad.numpy(), T)


# lengths that are given in metres


def test_lengths_in_metres_are_for_bodies_of_1_cm_to_1_m() -> None:
    sizes = [1e-6, 0.005, 0.01, 0.1, 1.0, 10.0]
    bodies = [build_body("ball", [sphere(size / np.sqrt(12.0))], candidates=8) for size in sizes]
    np.testing.assert_allclose(length_factor(bodies, bodies), [1e-4, 0.5, 1.0, 1.0, 1.0, 10.0], rtol=1e-12)
    # Exactly 1 in between, and the larger body counts.
    assert length_factor(bodies[3:4], bodies[:1]) == 1.0 == length_factor(bodies[:1], bodies[3:4])


def fits(s: float, width: float) -> np.ndarray:
    """Curvatures (2, M, 2, 2) of two boxes at scale s, times s."""
    w = boxes(s)
    E = tangents(w.witness.normal)[:, 0]
    M = len(E)
    miss = np.full((2, M), 0.01 * s)
    fitted = PairCurvatures.of(w.pairs, 1.0).fit(
        np.zeros(M, dtype=int), w.T_a[:, 0], w.T_b[:, 0], w.witness.reshape(-1), E, miss, np.full(M, width)
    )
    return s * np.stack(fitted)


@cache
def boxes(s: float) -> World:
    """Two boxes of 0.1 s m at some poses, corner against face and edge against edge."""
    extents = np.array([0.06, 0.05, 0.04])
    pairs = Pairs(*((build_body("box", [box(extents).scaled(s)], candidates=256),) for _ in range(2)))
    one = Pairs(*((build_body("box", [box(extents)], candidates=256),) for _ in range(2)))
    T_a, T_b = poses_at_gap(one, 12, 1e-3, seed=5)
    return World.of(pairs, larger(T_a, s), larger(T_b, s), np.full((2, 12, 1, 3), np.nan), s)


def test_what_stands_for_a_sharp_edge_scales_with_bodies_that_are_not_as_large_as_a_hand() -> None:
    """10 000/m was a radius as large as the body at 0.1 mm."""
    hand = PairCurvatures.of(boxes(1.0).pairs, 1.0)
    assert hand.corner == CORNER_CURVATURE_PER_M
    for s, other in ((1e-3, 5e-4), (100.0, 50.0)):
        found = fits(s, 0.0)
        np.testing.assert_allclose(found, fits(other, 0.0), rtol=1e-6, atol=1e-6)
        # As of bodies of 1 cm, or 1 m.
        limit = CORNER_CURVATURE_PER_M * (0.01 if s < 1 else 1.0) / boxes(1.0).pairs.a[0].diagonal
        np.testing.assert_allclose(found.max(), limit, rtol=1e-6)
