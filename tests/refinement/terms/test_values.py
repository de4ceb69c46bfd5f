"""Values of the terms of the loss: closed forms in NumPy and torch, and the way in which contacts move."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from ellipsoids import Contact, at_gap, contact
from grasp_refine.collision.query import Pairs, QueryStatus, Witness
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, exp_so3, tangents, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import hull, sphere
from grasp_refine.refinement.terms.contact import contact_gap, contact_targets, contact_targets_covectors
from grasp_refine.refinement.terms.direction import normal_covectors, normal_difference
from grasp_refine.refinement.terms.penetration import depths
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.stay_near import movement, movement_jacobian
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from refusals import refused
from twists import poses_at_gap

H = 1e-5
"""Step of finite differences."""


def layer() -> WitnessLayer:
    body = build_body("a", [hull(np.random.default_rng(0).normal(size=(50, 3)) * 0.02)], candidates=128)
    return WitnessLayer(Pairs((body,), (build_body("b", [sphere(0.03)], candidates=128),)), ContactKinematics())


def witness_of(points_a: object, points_b: object, normal: object, distance: object, status: object) -> Witness:
    """Witness points (batch, pair) of nothing in particular."""
    zero = np.zeros(np.shape(distance), dtype=np.int64)
    return Witness(*map(np.asarray, (points_a, points_b, normal, distance, status)), zero, zero)


def random_witness(seed: int, shape: tuple[int, ...] = (4, 3)) -> Witness:
    """Some apart, some penetrating, some without an answer, which have no points; consistent otherwise."""
    rng = np.random.default_rng(seed)
    status = rng.integers(0, 5, shape)
    status.reshape(-1)[:5] = np.arange(5)
    valid = status <= QueryStatus.PENETRATING
    d = np.where(status == QueryStatus.PENETRATING, -1.0, 1.0) * rng.uniform(0.001, 0.01, shape)
    a, n = rng.normal(size=(2, *shape, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    a, n = (np.where(valid[..., None], x, 0.0) for x in (a, n))
    d = np.where(valid, d, np.where(status == QueryStatus.FAR, 0.01, np.nan))
    return witness_of(a, a + np.where(valid, d, 0.0)[..., None] * n, n, d, status)


def as_tensors(witness: Witness) -> Witness:
    fields = (witness.point_a, witness.point_b, witness.normal, witness.distance)
    return Witness(
        *map(torch.from_numpy, fields), torch.from_numpy(witness.status), witness.winner, witness.num_queries
    )


def in_both(function: Callable, *arguments: object) -> np.ndarray:
    """What a function gives on arrays, after torch tensors gave the same."""
    found = function(*arguments)
    tensors = [
        as_tensors(a) if isinstance(a, Witness) else torch.from_numpy(a) if isinstance(a, np.ndarray) else a
        for a in arguments
    ]
    other = function(*tensors)
    assert isinstance(found, np.ndarray) and isinstance(other, torch.Tensor)
    np.testing.assert_allclose(other.numpy(), found, rtol=1e-13, atol=1e-15)
    return found


# values


@pytest.mark.parametrize("margin", [0.0, 0.002])
def test_terms_of_contacts_in_closed_form_on_arrays_and_tensors(margin: float) -> None:
    w, rng = random_witness(0), np.random.default_rng(1)
    T_a, T_b = exp_se3(rng.normal(size=(2, 4, 3, 6)))
    t_a, t_b, wanted = rng.normal(size=(3, 4, 3, 3))
    t_a[1, 0, 2], t_b[2, 1], wanted[3, 2, 0] = np.nan, np.nan, np.nan
    valid = (w.status <= QueryStatus.PENETRATING)[..., None]
    aimed = ~np.isnan(t_a + t_b).any(axis=-1, keepdims=True)

    found = in_both(contact_targets, w, T_a, T_b, t_a, t_b, margin)
    miss_a = w.point_a - np.einsum("bpij,bpj->bpi", T_a[..., :3, :3], t_a) - T_a[..., :3, 3]
    miss_b = w.point_b - np.einsum("bpij,bpj->bpi", T_b[..., :3, :3], t_b) - T_b[..., :3, 3]
    expected = np.concatenate([w.distance[..., None] - margin, miss_a, miss_b], axis=-1)
    np.testing.assert_allclose(found, np.where(valid & aimed, expected, 0.0), atol=1e-14)

    touching = rng.random((4, 3)) < 0.7
    found = in_both(contact_gap, w, touching, margin)
    np.testing.assert_allclose(found, np.where(valid[..., 0] & touching, w.distance - margin, 0.0), atol=1e-15)
    depth = in_both(depths, w)
    np.testing.assert_array_equal(depth, np.where(w.status == QueryStatus.PENETRATING, -w.distance, 0.0))
    # FAR pairs carry a bound as their distance, which is no gap and no depth.
    assert (w.status == QueryStatus.FAR).any() and np.isfinite(found).all() and (depth >= 0).all()

    found = in_both(normal_difference, w, wanted)
    some = valid & ~np.isnan(wanted).any(axis=-1, keepdims=True)
    np.testing.assert_allclose(found, np.where(some, w.normal - wanted, 0.0), atol=1e-15)


def test_staying_near_counts_scales_of_movement() -> None:
    rng, scales = np.random.default_rng(3), Scales(0.02, 0.3, 0.5)
    T_first, q_first = exp_se3(rng.normal(size=(3, 6))), rng.normal(size=(3, 4))
    T = T_first.copy()
    w = np.array([[0.0, 0.0, 0.6], [0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]])
    T[:, :3, :3] = exp_so3(w) @ T[:, :3, :3]
    T[:, :3, 3] += [0.02, -0.04, 0.0]
    found = in_both(
        lambda T, q, T_first, q_first, per_radian: movement(T, q, T_first, q_first, scales, per_radian),
        *(T, q_first + 0.25, T_first, q_first, np.array([1.0, 1.0, 1.0, 0.1])),
    )
    expected = np.concatenate([np.tile([1.0, -2.0, 0.0], (3, 1)), w / 0.3, np.full((3, 4), 0.5)], axis=1)
    expected[:, -1] *= 10.0  # a slide
    np.testing.assert_allclose(found, expected, atol=1e-12)
    # One scale of anything counts 1.
    np.testing.assert_allclose((found[0, 0], found[0, 5], found[0, 6]), (1.0, 2.0, 0.5), atol=1e-12)


def test_pairs_without_target_or_witness_count_nothing() -> None:
    witness_layer = layer()
    T_a, T_b = (torch.from_numpy(T) for T in poses_at_gap(witness_layer.pairs, 3, 0.004, seed=2))
    T_b[2] = float("nan")
    T_a.requires_grad_()
    targets = torch.zeros(2, 3, 1, 3, dtype=torch.float64)
    targets[0, 1] = float("nan")
    residual = contact_targets(witness_layer(T_a, T_b), T_a, T_b, *targets, margin=1e-3)
    assert residual[0].any() and not residual[1:].any()
    residual.square().sum().backward()
    assert torch.isfinite(T_a.grad).all() and not T_a.grad[1:].any()


@pytest.mark.parametrize("name", ["translation", "rotation", "joints"])
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan])
def test_scales_of_nothing_are_refused(name: str, value: float) -> None:
    with refused(GraspRefineError, name, f"{value:g}"):
        Scales(**{name: value})


@pytest.mark.parametrize("gap", [0.01, 1e-9, 0.0, -1e-3, -0.005])
def test_covectors_of_ellipsoids_whose_curvatures_differ_all_round(gap: float) -> None:
    for seed in range(4):
        a, b, c = at_gap(seed, gap)
        E = tangents(c.n)
        w = witness_of(c.x_a, c.x_b, c.n, c.d, 0)
        K_a, K_b = a.curvature(c.n, E), b.curvature(-c.n, E)
        rows = []
        for k in range(6):
            ends = []
            for sign in (1.0, -1.0):
                M = exp_se3(sign * H * np.eye(6)[k])
                moved: Contact = contact(a.moved(sign * H * np.eye(6)[k]), b, c.n)
                back = M[:3, :3].T @ (moved.x_a - M[:3, 3])
                ends.append(np.concatenate([[moved.d], E.T @ back, E.T @ moved.x_b, moved.n]))
            rows.append((ends[0] - ends[1]) / (2 * H))
        expected = np.array(rows).T
        np.testing.assert_allclose(contact_targets_covectors(w, E, K_a, K_b), expected[:5], atol=1e-6)
        np.testing.assert_allclose(normal_covectors(w, E, K_a, K_b), expected[5:], rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("angle", "error"), [(0.0, 1e-9), (1e-5, 1e-9), (0.1, 3e-7), (0.3, 2e-5), (1.0, 2e-3), (2.0, 4e-2), (3.0, 0.3)]
)
def test_the_derivative_of_staying_near_is_a_series_in_the_angle(angle: float, error: float) -> None:
    """J_l^-1 = I - [w] / 2 + [w]^2 / 12 + O(angle^4 / 720): 0.2 % at one radian, the right way at three."""
    rng, scales, unit = np.random.default_rng(11), Scales(0.01, 1.0, 0.15), np.array([1.0, 0.1, 1.0])
    T_first, q_first = exp_se3(rng.normal(size=(5, 6))), rng.normal(size=(5, 3))
    axis = rng.normal(size=(5, 3))
    w = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    T = T_first.copy()
    T[:, :3, :3] = exp_so3(w) @ T[:, :3, :3]
    T[:, :3, 3] += rng.normal(size=(5, 3)) * 0.05
    q = q_first + rng.normal(size=(5, 3))
    found = movement_jacobian(movement(T, q, T_first, q_first, scales, unit), scales, unit)
    expected = np.zeros((5, 9, 9))
    for k in range(9):
        ends = []
        for sign in (1.0, -1.0):
            dx = sign * 1e-6 * np.eye(9)[k]
            moved = T.copy()
            moved[:, :3, :3] = exp_so3(dx[3:6]) @ T[:, :3, :3]
            moved[:, :3, 3] += dx[:3]
            ends.append(movement(moved, q + dx[6:], T_first, q_first, scales, unit))
        expected[:, :, k] = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-7)
    np.testing.assert_allclose(found[:, 6:], expected[:, 6:], atol=1e-7)
    np.testing.assert_allclose(found[:, 3:6], expected[:, 3:6], atol=error + 1e-8)
    # The series keeps the eigenvector along the axis, and never turns a step round.
    assert (np.linalg.eigvalsh(found + found.mT) > 0).all()


# the paper's motivating case: a ball in a socket


def ball_in_socket(center: np.ndarray, r: float, R: float) -> Witness:
    """Witness points of a ball of radius r at `center` in a spherical socket of radius R about the origin."""
    n = center / np.linalg.norm(center)
    distance = R - r - np.linalg.norm(center)
    return witness_of(center + r * n, R * n, n, distance, 0 if distance > 0 else 1)


@pytest.mark.parametrize("gap", [0.004, 0.0005, -0.0005])
def test_the_contact_of_a_ball_in_a_socket_goes_where_the_ball_goes(gap: float) -> None:
    """Points that stay on their bodies claim the opposite."""
    r, R = 0.02, 0.03
    n = np.array([0.6, 0.0, 0.8])
    center = (R - r - gap) * n
    w = ball_in_socket(center, r, R)
    E = tangents(n)
    covectors = normal_covectors(w, E, np.eye(2) / r, -np.eye(2) / R)
    expected = np.zeros((3, 6))
    for k in range(6):
        ends = [
            ball_in_socket(transform_points(exp_se3(s * H * np.eye(6)[k]), center[None])[0], r, R).normal
            for s in (1, -1)
        ]
        expected[:, k] = (ends[0] - ends[1]) / (2 * H)
    np.testing.assert_allclose(covectors, expected, rtol=1e-5, atol=1e-2)
    along = tangents(n)[:, 0]
    assert along @ covectors[:, :3] @ along > 0.0
