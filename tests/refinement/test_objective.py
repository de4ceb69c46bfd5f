"""Losses with gradients through autograd: joint limits in single precision, samples, and failed queries."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from grasp_refine.collision.query import QueryStatus
from grasp_refine.core.se3 import body_gradient, exp_se3, hat, matvec
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.objective import Objective, limits_within
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from grasp_refine.scene import surroundings
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.transport import transport
from grasp_refine.witness.zeroth_order import ZerothOrder
from sliding_gripper import around_object, sliding_gripper


@given(
    st.lists(st.floats(-10, 10), min_size=1, max_size=4),
    st.lists(st.sampled_from([0.0, 1e-12, 1e-3, np.inf]), min_size=1),
)
def test_limits_in_single_precision_lie_within_the_true_ones(lows: list[float], rooms: list[float]) -> None:
    """A joint at the rounded limit of a finger was 1e-8 rad beyond the true one."""
    count = min(len(lows), len(rooms))
    lower = np.array(lows[:count])
    upper = lower + np.array(rooms[:count])
    low, high = (limit.double().numpy() for limit in limits_within(lower, upper, torch.float32, "cpu"))
    assert (low <= high).all()
    spacing, ends = np.spacing(np.abs(lower).astype(np.float32) + np.float32(1e-2)), np.isfinite(upper)
    roomy = ~ends | (upper > lower + 4 * spacing)
    assert (low >= lower)[roomy].all() and (high <= upper)[roomy].all()
    assert (np.abs(low - lower) <= spacing).all() and (high == upper)[~ends].all()
    assert (np.abs(high[ends] - upper[ends]) <= 2 * spacing[ends]).all()
    for one, other in zip(limits_within(lower, upper, torch.float64, "cpu"), (lower, upper), strict=True):
        np.testing.assert_array_equal(one.numpy(), other)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Hands about a ball, beside another one."""
    scene = around_object(sliding_gripper(tmp_path_factory.mktemp("gripper"), candidates=64), 4, 5)
    T = exp_se3(np.array([0.07, 0.0, 0.02, 0.0, 0.0, 0.0]))
    around = Environment((EnvironmentBody("ball", build_body("ball", [sphere(0.03)]), T),), np.eye(4))
    return replace(scene, task=Task(scene=around))


def objective(scene: Scene, **settings: object) -> Objective:
    config = Config(solver=Adam(), **settings)
    return Objective(scene, goal_of(scene, ContactSelection(links=("left", "right")), nearest=True), config)


def test_samples_of_a_derivative_are_drawn_anew_in_each_evaluation(scene: Scene) -> None:
    of, rows = objective(scene, derivative=ZerothOrder()), np.arange(4)
    # A centimetre from the targets, whose misses have a derivative that is sampled.
    point = Point(scene.T_world_root + 0.01 * np.eye(4, k=3), scene.q)
    first = of.evaluate(rows, point, None)
    second, again = (of.evaluate(rows, point, known) for known in (first, None))
    np.testing.assert_allclose(second.loss, first.loss, rtol=1e-9)
    np.testing.assert_allclose(again.gradient, first.gradient, rtol=1e-9)
    assert (np.abs(second.gradient - first.gradient).max(axis=1) > 1e-6).all()
    assert len({*map(int, first.number), *map(int, of.evaluate(rows, point, second).number)}) == 2


def test_transported_gradients_have_the_steps_of_the_solver(scene: Scene) -> None:
    """Those of the object act through the links, scaled by the steps of translation and rotation."""
    scene = replace(scene, object=load_object("box:0.05,0.06,0.045", candidates=64))
    solver = Descent(transport=True, step_translation=2e-3, step_rotation=5e-2)
    only = Weights(**{**dict.fromkeys(term_kinds(), 0.0), "contact": 1.0})
    goal = goal_of(scene, ContactSelection(links=("left", "right")))
    of = Objective(scene, goal, Config(solver=solver, weights=only))
    found = of.evaluate(np.arange(4), Point(scene.T_world_root, scene.q), None)
    T, q = (torch.from_numpy(part.copy()).requires_grad_() for part in (scene.T_world_root, scene.q))
    T_link = of.kinematics(T, q)
    a, b = (part.detach().clone().requires_grad_() for part in (T_link, torch.eye(4).double().expand(T_link.shape)))
    w = WitnessLayer(HandObject.of(scene).pairs, ContactKinematics())(a, b)
    G_a, G_b = torch.autograd.grad((w.distance[torch.from_numpy(goal.touching)] ** 2).sum(), (a, b))
    scale = torch.tensor([2e-3] * 3 + [5e-2] * 3, dtype=torch.float64)
    a, b = a.detach(), b.detach()
    moved = body_gradient(a, G_a) + transport(b, a, body_gradient(b, G_b) * scale) / scale
    R, G = a[..., :3, :3], torch.zeros_like(a)
    G[..., :3, :3], G[..., :3, 3] = R @ hat(moved[..., 3:]), matvec(R, moved[..., :3])
    G_T, G_q = torch.autograd.grad(T_link, (T, q), G)
    expected = torch.cat([body_gradient(T.detach(), G_T), G_q], dim=1).numpy()
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(found.gradient, expected, rtol=1e-6, atol=1e-9)


def test_a_failed_query_of_a_body_around_leaves_no_loss(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would count as no depth at all; other grasps keep their losses, and queries count in both kinds of problem."""
    goal, config = goal_of(scene, ContactSelection(links=("left",))), Config(weights=Weights(wrench=0.0))
    rows, point = np.arange(4), Point(scene.T_world_root, scene.q)
    problems = GraspProblem(scene, goal, config), Objective(scene, goal, replace(config, solver=Adam()))
    clean = [of.evaluate(rows, point, None) for of in problems]
    plain, failed = surroundings.query_items, []

    def fails(pairs: object, pair: np.ndarray, T_a: np.ndarray, *others: object, **settings: object) -> object:
        found = plain(pairs, pair, T_a, *others, **settings)
        failed.append(found.num_queries.sum())
        status = np.where(np.isclose(T_a, first, atol=1e-9).all(axis=(1, 2)), QueryStatus.FAILED, found.status)
        return replace(found, status=status.astype(np.int8))

    nearest = clean[0].nearby.near
    row = int(np.flatnonzero(nearest.column[:, 0] >= 0)[0])
    first = clean[0].T_link[row, problems[0].setup.surroundings.link[nearest.column[row, 0]]]
    monkeypatch.setattr(surroundings, "query_items", fails)
    for of, known in zip(problems, clean, strict=True):
        found = of.evaluate(rows, point, None)
        np.testing.assert_array_equal(np.isnan(found.loss), rows == row)
        others = rows != row
        np.testing.assert_allclose(found.loss[others], known.loss[others], rtol=1e-9)
        np.testing.assert_array_equal(found.num_queries, known.num_queries)
        of_links = found.witness.num_queries.sum() + found.self_witness.num_queries.sum()
        assert found.num_queries.sum() - of_links == failed[-1] > 0
