"""Faults known from the code of arXiv 2511.06267: poses that are not finite, memory layouts, graphs, and noise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import Pairs, QueryStatus, query
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.zeroth_order import ZerothOrder
from shapes_for_tests import convex_body
from twists import FIELDS, gradients, poses_at_gap, random_cotangents, weighed


@cache
def hulls() -> Pairs:
    return Pairs((convex_body(0),), (convex_body(1),))


# poses that are not finite


@pytest.fixture(scope="module")
def poses() -> tuple[np.ndarray, np.ndarray]:
    """Poses (8, 1, 4, 4) of two hulls, a millimetre apart or deep."""
    apart, deep = poses_at_gap(hulls(), 4, 1e-3, seed=0), poses_at_gap(hulls(), 4, -1e-3, seed=1)
    return tuple(np.concatenate(side) for side in zip(apart, deep, strict=True))


METHODS = {"contact kinematics": ContactKinematics(), "distance": Distance(), "zeroth order": ZerothOrder()}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e12])
def test_a_pose_that_is_not_finite_costs_only_itself(
    poses: tuple[np.ndarray, np.ndarray], value: float, name: str
) -> None:
    T_a, T_b = (T.copy() for T in poses)
    T_a[2, 0, 1, 3], T_b[5, 0, 0, 0] = value, value if not np.isfinite(value) else np.nan
    clean, found = query(hulls(), *poses), query(hulls(), T_a, T_b)
    good = np.array([0, 1, 3, 4, 6, 7])
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(found, field)[good], getattr(clean, field)[good])
    if not np.isfinite(value):
        assert (found.status[[2, 5]] == QueryStatus.NOT_FINITE).all() and np.isnan(found.distance[[2, 5]]).all()
    cotangents = random_cotangents(clean, FIELDS, seed=5)
    for field, unknown in (("distance", np.isnan(found.distance)),):
        cotangents[field][unknown] = 0.0
    layer = WitnessLayer(hulls(), METHODS[name])
    one, other = (gradients(layer, *T, cotangents).numpy() for T in (poses, (T_a, T_b)))
    np.testing.assert_allclose(other[:, good], one[:, good], rtol=1e-12, atol=1e-12)
    if not np.isfinite(value):
        assert (other[:, [2, 5]] == 0.0).all()


# memory layouts


def layouts(T: np.ndarray) -> dict[str, np.ndarray]:
    """The same numbers, otherwise in memory."""
    wide = np.zeros((2 * len(T), 1, 4, 6))
    wide[::2, :, :, :4] = T
    locked = T.copy()
    locked.setflags(write=False)
    return {
        "Fortran": np.asfortranarray(T),
        "every second row of a wider one": wide[::2, :, :, :4],
        "backwards": T[::-1].copy()[::-1],
        "transposed": np.ascontiguousarray(T.mT).mT,
        "locked": locked,
    }


def test_arrays_may_lie_in_memory_as_they_like(poses: tuple[np.ndarray, np.ndarray]) -> None:
    clean = query(hulls(), *poses)
    assert not layouts(poses[0])["transposed"].flags.c_contiguous
    for name, T_a in layouts(poses[0]).items():
        before = T_a.copy()
        for T_b in layouts(poses[1]).values():
            found = query(hulls(), T_a, T_b)
            for field in (*FIELDS, "status"):
                np.testing.assert_array_equal(getattr(found, field), getattr(clean, field), err_msg=name)
        np.testing.assert_array_equal(T_a, before)


def test_tensors_may_lie_in_memory_as_they_like(poses: tuple[np.ndarray, np.ndarray]) -> None:
    layer, cotangents = WitnessLayer(hulls(), ContactKinematics()), random_cotangents(query(hulls(), *poses), FIELDS, 6)
    expected = gradients(layer, *poses, cotangents).numpy()
    straight = [torch.from_numpy(T) for T in poses]
    for view in (
        lambda T: T.mT.contiguous().mT,
        lambda T: T.repeat_interleave(2, dim=0)[::2],
        lambda T: torch.nn.functional.pad(T, (1, 1, 1, 1))[..., 1:5, 1:5],
    ):
        leaves = [view(T).detach().requires_grad_() for T in straight]
        assert not leaves[0].is_contiguous()
        weighed(layer(*leaves), cotangents).backward()
        np.testing.assert_array_equal(np.stack([leaf.grad.numpy() for leaf in leaves]), expected)


# batches of other sizes, graphs at the same time


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_graphs_that_are_made_together_keep_apart(
    poses: tuple[np.ndarray, np.ndarray], order: tuple[int, ...], name: str
) -> None:
    """Three forward passes of one layer, of other sizes, poses and keys, then their backward passes in any order."""
    layer = WitnessLayer(hulls(), METHODS[name])
    parts = [tuple(T[rows] for T in poses) for rows in ([0, 1, 2], [5, 6], [3])]
    cotangents = [random_cotangents(query(hulls(), *part), FIELDS, seed) for seed, part in enumerate(parts)]
    expected = [gradients(layer, *part, cotangents[k], key=k).numpy() for k, part in enumerate(parts)]
    leaves = [[torch.from_numpy(T.copy()).requires_grad_() for T in part] for part in parts]
    losses = [weighed(layer(*pair, key=k), cotangents[k]) for k, pair in enumerate(leaves)]
    for k in order:
        losses[k].backward()
    for k, pair_of_leaves in enumerate(leaves):
        found = np.stack([leaf.grad.numpy() for leaf in pair_of_leaves])
        np.testing.assert_array_equal(found, expected[k])


# noise


@pytest.mark.parametrize("method", [ZerothOrder(), ContactKinematics(), Distance()], ids=lambda m: type(m).__name__)
def test_what_is_drawn_depends_on_seed_and_key_only(poses: tuple[np.ndarray, np.ndarray], method: object) -> None:
    cotangents = random_cotangents(query(hulls(), *poses), FIELDS, seed=8)
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    first = gradients(WitnessLayer(hulls(), method), *poses, cotangents, key=3).numpy()
    state = torch.get_rng_state()
    torch.manual_seed(2)
    np.random.seed(2)  # noqa: NPY002
    drawn = torch.rand(1).item()
    again = gradients(WitnessLayer(hulls(), method), *poses, cotangents, key=3).numpy()
    np.testing.assert_array_equal(again, first)
    # The caller's generators are left alone.
    torch.manual_seed(1)
    assert torch.equal(torch.get_rng_state(), state)
    torch.manual_seed(2)
    assert torch.rand(1).item() == drawn
