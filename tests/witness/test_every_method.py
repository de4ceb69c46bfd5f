"""One checker that every derivative method passes through: what holds whatever is approximated, and how."""

from functools import cache

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import cross, inverse, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench
from grasp_refine.witness.zeroth_order import ZerothOrder
from shapes_for_tests import BODY_PAIRS
from twists import FIELDS, gradients, layer_gradient, poses_at_gap, random_cotangents, random_poses

RADII = {"adaptive": Adaptive(), "fixed": Fixed()}
NEIGHBORHOODS = {**RADII, "neighbor": Neighbor()}
METHODS: dict[str, Derivative] = {
    **{f"distance, {name}": Distance(rule) for name, rule in NEIGHBORHOODS.items()},
    **{f"distance, {name}, one-sided": Distance(rule, "one-sided") for name, rule in NEIGHBORHOODS.items()},
    "distance, adaptive, one-sided, smoothed": Distance(coupling="one-sided", smoothed_self=True),
    **{f"direction, {name}": Direction(rule) for name, rule in NEIGHBORHOODS.items()},
    "direction, neighbor, one-sided": Direction(Neighbor(), "one-sided"),
    **{f"contact kinematics, {name}": ContactKinematics(rule) for name, rule in NEIGHBORHOODS.items()},
    **{f"contact kinematics, {name}, sampled": ContactKinematics(rule, sampled=True) for name, rule in RADII.items()},
    "analytical": Analytical(),
    "analytical, one-sided": Analytical(coupling="one-sided"),
    "rigid": Rigid(),
    "finite difference": FiniteDifference(),
    "zeroth order": ZerothOrder(),
}
INVARIANT = [name for name in METHODS if "one-sided" not in name]
SIDES_ALIKE = [name for name in METHODS if name not in ("finite difference", "zeroth order")]

GAPS = (0.02, 1e-3, 1e-6, 1e-9, 0.0, -1e-9, -1e-4, -4e-3)

BODIES = [name for name in BODY_PAIRS if name != "hulls"]


settled = cache(poses_at_gap)
"""Poses of both bodies at a gap, the same for all methods."""


@cache
def pair(name: str) -> Pairs:
    a, b = BODY_PAIRS[name]()
    return Pairs((a,), (b,))


# (a) finite wherever the bodies are


@cache
def poses_at_all_gaps(name: str, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random poses (count, 1, 4, 4) of both bodies moved along their normal until the gap is one of `GAPS`, and it.

    Concave bodies do not all come to rest there; those stay in the batch wherever they are.
    """
    T_a, T_b = random_poses(count, seed=1), random_poses(count, seed=2)
    gap = np.resize(GAPS, (count, 1))
    found = None
    for _ in range(6):
        found = query(pair(name), T_a, T_b, previous=found)
        T_b[..., :3, 3] += (gap - found.distance)[..., None] * found.normal
    return T_a, T_b, gap


@pytest.mark.parametrize("shapes", BODIES)
@pytest.mark.parametrize("name", METHODS)
def test_gradients_are_finite_at_every_gap(name: str, shapes: str) -> None:
    T_a, T_b, gap = poses_at_all_gaps(shapes, 160)
    w = query(pair(shapes), T_a, T_b)
    assert w.valid.all() and (np.abs(w.distance - gap) < 1e-9).mean() > 0.7
    # Anywhere near the bodies, on the witness point itself, or nowhere.
    targets = 0.02 * np.random.default_rng(0).normal(size=(2, *w.point_a.shape))
    targets[0, ::5] = transform_points(inverse(T_a[::5]), w.point_a[::5])
    targets[:, ::7] = np.nan
    layer, aims = WitnessLayer(pair(shapes), METHODS[name]), torch.from_numpy(targets)
    cotangents = random_cotangents(w, FIELDS, seed=0)
    assert torch.isfinite(gradients(layer, T_a, T_b, cotangents, target_a=aims[0], target_b=aims[1])).all()


@pytest.mark.parametrize("name", METHODS)
def test_parallel_faces_leave_the_sliding_open_but_stop_nobody(name: str) -> None:
    """I - A B is singular there: coupled analytical slips ended in an error."""
    for gap in (1e-3, 0.0, -1e-3):
        cubes = (build_body(str(side), [box([side] * 3)]) for side in (0.04, 0.03))
        pairs = Pairs(*((cube,) for cube in cubes))
        T_a, T_b = np.tile(np.eye(4), (2, 1, 1, 1, 1))
        T_b[..., 2, 3] = 0.035 + gap
        cotangents = random_cotangents(query(pairs, T_a, T_b), FIELDS, seed=12)
        found = layer_gradient(WitnessLayer(pairs, METHODS[name]), T_a, T_b, cotangents)
        assert np.isfinite(found).all()
        if name == "analytical":
            assert np.abs(found).max() < 10.0


# (b) both bodies moved together


@pytest.mark.parametrize("shapes", BODIES)
@pytest.mark.parametrize("name", INVARIANT)
def test_a_common_motion_moves_points_and_normal_with_it(name: str, shapes: str) -> None:
    for gap in (0.01, 1e-9, -0.003):
        pairs = pair(shapes)
        T_a, T_b = settled(pairs, 6, gap, seed=11)
        w = query(pairs, T_a, T_b)
        c = random_cotangents(w, FIELDS, seed=12)
        found = layer_gradient(WitnessLayer(pairs, METHODS[name]), T_a, T_b, c)
        expected = wrench(w.point_a, c["point_a"]) + wrench(w.point_b, c["point_b"])
        expected[..., 3:] += cross(w.normal, c["normal"])
        np.testing.assert_allclose(found[:6] + found[6:], expected[:, 0].T, atol=1e-9 * max(1.0, np.abs(found).max()))


# (c) the bodies exchanged


def exchanged(pairs: Pairs, w: Witness) -> tuple[Pairs, Witness]:
    """The same pair of bodies, and the same witness points, in the other order."""
    count_a, count_b = len(pairs.a[0].pieces), len(pairs.b[0].pieces)
    winner = w.winner % count_b * count_a + w.winner // count_b
    return Pairs(pairs.b, pairs.a), Witness(
        w.point_b, w.point_a, -w.normal, w.distance, w.status, winner, w.num_queries
    )


def wrenches(
    pairs: Pairs, method: Derivative, T_a: np.ndarray, T_b: np.ndarray, w: Witness, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    scene = WitnessScene(*WitnessLayer(pairs, method).columns(np.array([0])), T_a, T_b, w, None, None, 3)
    return method.pull_back(scene, *forces)


def both_orders(pairs: Pairs, method: Derivative, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (body, batch, pair, 6) as asked, and with the bodies exchanged (but in the same order)."""
    T_a, T_b = settled(pairs, 6, gap, seed=21)
    w = query(pairs, T_a, T_b)
    f_a, f_b, f_n = random_cotangents(w, FIELDS[:3], seed=22).values()
    swapped, reverse = exchanged(pairs, w)
    one = wrenches(pairs, method, T_a, T_b, w, (f_a, f_b, f_n))
    two = wrenches(swapped, method, T_b, T_a, reverse, (f_b, f_a, -f_n))
    return np.stack(one), np.stack(two[::-1])


@pytest.mark.parametrize("shapes", BODIES)
@pytest.mark.parametrize("name", SIDES_ALIKE)
def test_exchanging_the_bodies_exchanges_the_wrenches(name: str, shapes: str) -> None:
    for gap in (0.01, -0.003):
        one, two = both_orders(pair(shapes), METHODS[name], gap)
        np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-8 * np.abs(one).max())


# (d) single precision


@pytest.mark.parametrize("name", METHODS)
def test_single_precision_poses_give_nearly_the_same_gradients(name: str) -> None:
    for gap in (0.01, -0.003):
        pairs = pair("concave")
        double = [torch.from_numpy(T) for T in settled(pairs, 40, gap, seed=31)]
        single = [T.float() for T in double]
        c = random_cotangents(query(pairs, *(T.numpy() for T in double)), FIELDS, seed=32)
        found = gradients(WitnessLayer(pairs, METHODS[name]), *single, c)
        assert found.dtype == torch.float32
        # Rounded poses in double precision: the very same but for the rounding of cotangents and results.
        rounded = gradients(WitnessLayer(pairs, METHODS[name]), *(T.double() for T in single), c)
        scale = rounded.abs().amax(dim=(0, 2, 3, 4))
        assert ((found - rounded).abs().amax(dim=(0, 2, 3, 4)) < 1e-5 * scale).all()
        # Poses that were never rounded: other samples in a few rows, hardly a difference in the rest.
        exact = gradients(WitnessLayer(pairs, METHODS[name]), *double, c)
        close = (found - exact).abs().amax(dim=(0, 2, 3, 4)) < 1e-2 * scale
        assert close.double().mean() > 0.9


# (e) what else is in the batch


@pytest.mark.parametrize("name", METHODS)
def test_a_row_does_not_depend_on_its_batch(name: str) -> None:
    for gap in (0.01, 1e-9, -0.003):
        pairs = pair("concave")
        T_a, T_b = (torch.from_numpy(T) for T in settled(pairs, 12, gap, seed=41))
        c = random_cotangents(query(pairs, T_a.numpy(), T_b.numpy()), FIELDS, seed=42)
        whole = gradients(WitnessLayer(pairs, METHODS[name]), T_a, T_b, c)
        for rows in ([3], [11, 0, 7, 5], [4, 4, 4, 4, 4, 9]):
            part = gradients(
                WitnessLayer(pairs, METHODS[name]), T_a[rows], T_b[rows], {key: value[rows] for key, value in c.items()}
            )
            torch.testing.assert_close(part, whole[:, rows], rtol=1e-9, atol=1e-9 * float(whole.abs().max()))
