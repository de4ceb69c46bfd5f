"""The layer as a torch function: no state between calls, any memory layout, gradients only where they are due."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import Pairs, QueryStatus, query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from refusals import refused
from shapes_for_tests import convex_body, ring_body
from twists import (
    FIELDS,
    gradient_along_twists,
    gradients,
    poses_at_gap,
    slopes_along_twists,
    weighed,
)

METHODS = {
    "distance": Distance(),
    "distance, neighbor": Distance(Neighbor()),
    "contact kinematics": ContactKinematics(),
    "contact kinematics, neighbor": ContactKinematics(Neighbor()),
}


def two_pairs() -> Pairs:
    return Pairs((convex_body(0), ring_body(1)), (convex_body(1), convex_body(2)))


def near_poses(pairs: Pairs, count: int, gap: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Poses (count, P, 4, 4) of both bodies with each pair at the gap."""
    columns = [
        poses_at_gap(Pairs(pairs.a[p : p + 1], pairs.b[p : p + 1]), count, gap, seed + p) for p in range(len(pairs))
    ]
    return tuple(torch.from_numpy(np.concatenate([column[side] for column in columns], axis=1)) for side in (0, 1))


@dataclass
class Records:
    """A method that only remembers what it was asked."""

    seen: list[tuple[WitnessScene, np.ndarray, np.ndarray, np.ndarray | None]] = field(default_factory=list)

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        self.seen.append((scene, force_a, force_b, force_n))
        zero = np.zeros((*force_a.shape[:2], 6))
        return zero, zero


# the whole chain


class ExactBalls(ContactKinematics):
    """Contact kinematics with the true curvature of balls of 3 and 2 cm."""

    def curvatures(self, scene: WitnessScene, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        eye = np.broadcast_to(np.eye(2), (*E.shape[:2], 2, 2))
        return eye / 0.03, eye / 0.02


@pytest.mark.parametrize("gap", [0.02, 1e-6, -0.004])
def test_a_nonlinear_loss_of_everything_has_the_gradient_of_finite_differences(gap: float) -> None:
    pairs = Pairs((build_body("a", [sphere(0.03, (0.01, 0.02, 0))]),), (build_body("b", [sphere(0.02)]),))
    T_a, T_b = poses_at_gap(pairs, 4, gap, seed=1)
    layer = WitnessLayer(pairs, ExactBalls())
    target = torch.tensor([0.1, -0.2, 0.05], dtype=torch.float64)

    def loss(T_a: torch.Tensor, T_b: torch.Tensor) -> torch.Tensor:
        w = layer(T_a, T_b)
        # Poses also act on the loss directly, past the layer.
        local = ((w.point_b - T_a[..., :3, 3])[..., None] * T_a[..., :3, :3]).sum(-2)
        miss = (w.point_a - target).square().sum(-1) + local.norm(dim=-1) * w.distance.sin()
        return (miss + (w.normal * T_b[..., :3, 0]).sum(-1) ** 2 + w.distance.exp() * w.normal[..., 2]).sum(1)

    def value(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        return loss(torch.from_numpy(T_a), torch.from_numpy(T_b)).numpy()

    tensors = [torch.from_numpy(T).requires_grad_() for T in (T_a, T_b)]
    loss(*tensors).sum().backward()
    found = np.concatenate([gradient_along_twists(t.grad.numpy(), t.detach().numpy()) for t in tensors])
    np.testing.assert_allclose(found, slopes_along_twists(value, T_a, T_b, 1e-5), atol=1e-6)


# no state between calls


def test_a_second_derivative_of_a_plain_distance_is_refused_by_name() -> None:
    """Torch said of poses that they are "not used in the graph"."""
    pairs = Pairs((convex_body(0),), (convex_body(1),))
    T_a, T_b = (T.requires_grad_() for T in near_poses(pairs, 2, 0.01, 30))
    layer = WitnessLayer(pairs, Distance())
    (G,) = torch.autograd.grad(layer(T_a, T_b).distance.sum(), T_a, create_graph=True)
    with refused(GraspRefineError, "first derivatives"):
        torch.autograd.grad(G.sum(), T_b)
    (alone,) = torch.autograd.grad(layer(T_a, T_b).distance.sum(), T_a)
    torch.testing.assert_close(G.detach(), alone, rtol=0, atol=0)


# gradients only where they are due


def test_poses_that_want_no_gradient_get_none() -> None:
    pairs = two_pairs()
    layer = WitnessLayer(pairs, Distance())
    T_a, T_b = near_poses(pairs, 2, 0.01, 70)
    both = gradients(layer, T_a, T_b)
    for wanting in (0, 1):
        leaves = [T.clone().requires_grad_(side == wanting) for side, T in enumerate((T_a, T_b))]
        weighed(layer(*leaves)).backward()
        assert leaves[1 - wanting].grad is None
        assert torch.equal(leaves[wanting].grad, both[wanting])
    assert not layer(T_a, T_b).point_a.requires_grad


def test_the_method_sees_only_the_pairs_and_fields_the_loss_looks_at() -> None:
    pairs = Pairs.against([convex_body(seed) for seed in range(3)], ring_body(1))
    T_a, T_b = (T.requires_grad_() for T in near_poses(pairs, 2, 0.01, 80))
    target = torch.full((2, 3, 3), torch.nan, dtype=torch.float64)
    target[:, 1] = torch.tensor([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])
    method = Records()
    layer = WitnessLayer(pairs, method)
    w = layer(T_a, T_b, target, key=5)
    (2 * w.point_b[:, 1]).sum().backward(retain_graph=True)
    w.normal[:, [0, 2]].sum().backward(retain_graph=True)
    w.distance.sum().backward(retain_graph=True)
    (0 * w.point_a).sum().backward()
    assert len(method.seen) == 2, "neither the distance nor weights of zero take the method"
    scene, force_a, force_b, force_n = method.seen[0]
    assert force_n is None and not force_a.any()
    np.testing.assert_array_equal(force_b, np.full((2, 1, 3), 2.0))
    assert scene.pairs.a == pairs.a[1:2] and scene.key == 5 and scene.target_b is None
    np.testing.assert_array_equal(scene.witness.point_a[:, 0], w.point_a.detach()[:, 1])
    np.testing.assert_array_equal(scene.target_a, target[:, 1:2].numpy())
    np.testing.assert_array_equal(scene.T_world_a, T_a.detach()[:, 1:2].numpy())
    # The winner counts from the first piece pair of the pairs that were taken.
    assert ((scene.witness.winner >= 0) & (scene.witness.winner < 10)).all()
    scene, force_a, force_b, force_n = method.seen[1]
    assert not force_a.any() and not force_b.any()
    np.testing.assert_array_equal(force_n, np.ones((2, 2, 3)))
    assert scene.pairs.a == (pairs.a[0], pairs.a[2]) and (scene.witness.winner[:, 1] >= 10).all()


@pytest.mark.parametrize("method", [*METHODS.values(), Analytical()])
def test_looking_at_one_pair_gives_the_gradient_of_that_pair_alone(method: object) -> None:
    pairs = Pairs.against([convex_body(0), ring_body(1), convex_body(1)], ring_body(1))
    T_a, T_b = near_poses(pairs, 3, 0.01, 90)
    layer = WitnessLayer(pairs, method)
    for p in range(3):
        leaves = [T.clone().requires_grad_() for T in (T_a, T_b)]
        (layer(*leaves).point_a[:, p] ** 2).sum().backward()
        alone = [T[:, p : p + 1].clone().requires_grad_() for T in (T_a, T_b)]
        (WitnessLayer(pairs.take(np.array([p])), method)(*alone).point_a ** 2).sum().backward()
        for leaf, single in zip(leaves, alone, strict=True):
            torch.testing.assert_close(leaf.grad[:, p], single.grad[:, 0], rtol=1e-9, atol=1e-12)
            others = [q for q in range(3) if q != p]
            assert not leaf.grad[:, others].any()


@pytest.mark.parametrize("name", METHODS)
def test_pairs_that_were_not_answered_get_exact_zeros(name: str) -> None:
    pairs = two_pairs()
    layer = WitnessLayer(pairs, METHODS[name])
    T_a, T_b = near_poses(pairs, 4, 0.01, 100)
    clean = gradients(layer, T_a, T_b)
    T_b[1, 0, 0, 3] += 1.0  # beyond the cutoff
    T_b[2, 1, 2, 2] = torch.nan
    cutoff = 0.5
    w = layer(T_a, T_b, cutoff=cutoff)
    assert (w.status[1, 0], w.status[2, 1]) == (QueryStatus.FAR, QueryStatus.NOT_FINITE)
    found = gradients(layer, T_a, T_b, cutoff=cutoff)
    for G, expected in zip(found, clean, strict=True):
        assert not G[1, 0].any() and not G[2, 1].any()
        same = torch.ones(4, 2, dtype=torch.bool)
        same[1, 0] = same[2, 1] = False
        torch.testing.assert_close(G[same], expected[same], rtol=1e-9, atol=1e-12)


def test_values_are_as_in_the_query() -> None:
    pairs = two_pairs()
    T_a, T_b = near_poses(pairs, 4, -0.002, 130)
    w, found = WitnessLayer(pairs, Distance())(T_a, T_b), query(pairs, T_a.numpy(), T_b.numpy())
    for name in (*FIELDS, "status", "winner", "num_queries"):
        np.testing.assert_array_equal(np.asarray(getattr(w, name)), getattr(found, name))
    detached = w.detached()
    assert isinstance(detached.point_a, np.ndarray)
    np.testing.assert_array_equal(detached.rows(np.array([2, 0])).distance, found.distance[[2, 0]])


class Wrenches(ContactKinematics):
    """Contact kinematics by its wrenches: a subclass has no backward pass in one call."""


@pytest.mark.parametrize("fields", [FIELDS, FIELDS[:1], FIELDS[1:2], FIELDS[2:3], FIELDS[3:]])
@pytest.mark.parametrize("targets", ["none", "of a", "of both"])
def test_the_backward_pass_in_one_call_is_that_of_the_wrenches(fields: tuple[str, ...], targets: str) -> None:
    """Of several pairs of bodies of several pieces, apart and in penetration, some of them not answered."""
    pairs = two_pairs()
    T_a, T_b = (
        torch.cat(sides) for sides in zip(*(near_poses(pairs, 3, gap, 5) for gap in (0.004, -0.003)), strict=True)
    )
    T_a[1, 0, 0, 3] += 0.5  # beyond the cutoff
    T_b[2, 1, 1, 1] = np.nan
    rng = np.random.default_rng(3)
    target_a, target_b = torch.from_numpy(rng.normal(scale=0.02, size=(2, *T_a.shape[:2], 3)))
    target_a[::2, 0] = torch.nan
    given = {"none": (None, None), "of a": (target_a, None), "of both": (target_a, target_b)}[targets]
    weights = {name: torch.from_numpy(rng.normal(size=(*T_a.shape[:2], 3))) for name in fields}
    found = []
    for method in (ContactKinematics(), Wrenches()):
        poses = [T.clone().requires_grad_() for T in (T_a, T_b)]
        witness = WitnessLayer(pairs, method)(*poses, *given, cutoff=0.1)
        assert {int(status) for status in witness.status.ravel()} >= {QueryStatus.FAR, QueryStatus.NOT_FINITE}
        parts = [getattr(witness, name) for name in fields]
        loss = sum(
            (part * (weights[name] if part.ndim == 3 else weights[name][..., 0])).nan_to_num().sum()
            for name, part in zip(fields, parts, strict=True)
        )
        found.append(torch.autograd.grad(loss, poses))
    for ours, theirs in zip(*found, strict=True):
        assert theirs.abs().max() > 0.1
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)
