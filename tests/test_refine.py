"""The loop: it converges, ends with a status, and no grasp depends on another."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from grasp_refine.assets import resource_dir
from grasp_refine.collision.query import QueryStatus, Witness, query
from grasp_refine.config import Config
from grasp_refine.grasps import load_grasps
from grasp_refine.hand import load_hand
from grasp_refine.kinematics import Kinematics
from grasp_refine.objective import Objective
from grasp_refine.objects import load_object
from grasp_refine.refine import Refinement, refine
from grasp_refine.scene import Scene
from grasp_refine.se3 import exp_se3, transform_from_pose, transform_points
from grasp_refine.solvers.descent import Descent
from grasp_refine.solvers.status import Status
from grasp_refine.validation.geometry import measure, movement
from grasp_refine.witness import autograd
from grasp_refine.witness.distance import Distance

SHORT = Config(solver=Descent(iterations=60))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The four example grasps of the embedded hand on the embedded box, one of the fastest objects."""
    grasps = load_grasps(resource_dir("robots") / "allegro/example_rounded_box.npz")
    return Scene(
        load_hand("allegro", candidates=256),
        load_object("rounded_box", candidates=256),
        transform_from_pose(grasps.hand_pose),
        grasps.q,
    )


def rows(scene: Scene, index: list[int]) -> Scene:
    return replace(scene, T_world_root=scene.T_world_root[index], q=scene.q[index])


@pytest.mark.parametrize("derivative", [Config().derivative, Distance()], ids=["contact-kinematics", "distance"])
def test_contact_error_and_penetration_fall(scene: Scene, derivative: object) -> None:
    result = refine(scene, Config(solver=Descent(iterations=300), derivative=derivative))
    errors, depths = [], []
    for T, q in ((scene.T_world_root, scene.q), (result.T_world_root, result.q)):
        found = measure(scene.hand, scene.object, scene.links, T, q, result.target_link, result.target_object)
        errors.append(np.nanmax(found.contact_error, axis=1))
        depths.append(found.penetration)
    assert np.median(errors[0]) > 5e-3
    # Distance smoothing is biased close to contact and in penetration; it gets nearer, and not much more.
    assert np.median(errors[1]) < (1e-3 if derivative == Config().derivative else np.median(errors[0]))
    assert np.median(depths[1]) < np.median(depths[0])
    assert (result.loss[:, 1] < result.loss[:, 0]).all()
    assert (result.q >= scene.hand.lower).all() and (result.q <= scene.hand.upper).all()


def test_the_result_does_not_depend_on_the_batch(scene: Scene) -> None:
    together = refine(scene, SHORT)
    for i in (0, 3):
        alone = refine(rows(scene, [i]), SHORT)
        np.testing.assert_allclose(alone.T_world_root[0], together.T_world_root[i], atol=1e-9)
        np.testing.assert_allclose(alone.q[0], together.q[i], atol=1e-9)
        assert alone.status[0] == together.status[i]


def test_one_bad_member_spoils_only_itself(scene: Scene) -> None:
    clean = refine(scene, SHORT)
    T, q = scene.T_world_root.copy(), scene.q.copy()
    T[1, 0, 3] = np.nan
    q[2, 4] = np.inf
    found = refine(replace(scene, T_world_root=T, q=q), SHORT)
    assert found.status[1] == found.status[2] == Status.NOT_FINITE
    for i in (0, 3):
        np.testing.assert_allclose(found.T_world_root[i], clean.T_world_root[i], atol=1e-9)
        assert found.status[i] == clean.status[i]


def test_a_grasp_far_away_has_no_target(scene: Scene) -> None:
    T = scene.T_world_root[:2].copy()
    T[0, 0, 3] += 1.0
    found = refine(replace(scene, T_world_root=T, q=scene.q[:2]), SHORT)
    assert found.status[0] == Status.NO_TARGET and "--targets" in Status.NO_TARGET.advice
    np.testing.assert_array_equal(found.T_world_root[0], T[0])
    assert found.status[1] != Status.NO_TARGET


def test_same_seed_same_result(scene: Scene) -> None:
    one, two = refine(rows(scene, [0, 1]), SHORT), refine(rows(scene, [0, 1]), SHORT)
    np.testing.assert_array_equal(one.T_world_root, two.T_world_root)
    np.testing.assert_array_equal(one.q, two.q)


def test_converged_grasps_leave(scene: Scene) -> None:
    finished: list[int] = []
    result = refine(scene, Config(tolerance=2e-5), lambda done, *_: finished.append(done))
    assert (result.status == Status.CONVERGED).all()
    assert finished[-1] == 4 and len(finished) == result.iterations.max() > result.iterations.min()
    assert (result.loss[:, 1] < 2e-5).all()


def test_given_targets_are_used(scene: Scene) -> None:
    links = len(scene.links)
    target_link, target_object = np.full((2, 4, links, 3), np.nan)
    target_link[:, 0], target_object[:, 0] = [0.0, 0.0, 0.012], [0.0, 0.0, 0.045]
    found = refine(replace(scene, target_link=target_link, target_object=target_object), SHORT)
    np.testing.assert_array_equal(found.target_link, target_link)
    assert (found.loss[:, 1] < found.loss[:, 0]).all()


@pytest.mark.parametrize("transport", [False, True])
def test_single_precision_and_transport_run(scene: Scene, transport: bool) -> None:
    result = refine(scene, Config(solver=Descent(iterations=60, transport=transport), dtype="float32"))
    assert (result.loss[:, 1] < 0.5 * result.loss[:, 0]).all()
    R = result.T_world_root[:, :3, :3]
    np.testing.assert_allclose(R @ R.mT, np.broadcast_to(np.eye(3), R.shape), atol=1e-5)


def test_steps_have_their_length_and_joints_stay_within_limits() -> None:
    solver = Descent(momentum=0.0)
    T, q = torch.eye(4).double().expand(2, 4, 4), torch.tensor([[0.99, 0.0], [1.5, 0.0]]).double()
    gradient = torch.cat([torch.randn(2, 6), torch.tensor([[-1.0, 0.0], [-1.0, 0.0]])], dim=1).double()
    stage = torch.tensor([0, 1])
    lower, upper = -torch.ones(2).double(), torch.ones(2).double()
    moved, joints, _ = solver.step(T, q, gradient, torch.zeros_like(gradient), stage, lower, upper)
    distance = moved[:, :3, 3].norm(dim=1)
    torch.testing.assert_close(distance, torch.tensor([1e-3, 1e-4]).double(), rtol=1e-4, atol=0)
    assert joints[0, 0] == 1.0  # stopped at the limit
    assert joints[1, 0] == 1.5  # began beyond it: not pushed farther, pulled in by its loss term
    still, same, _ = solver.step(T, q, 0 * gradient, 0 * gradient, stage, lower, upper)
    torch.testing.assert_close(still, T)
    torch.testing.assert_close(same, q)


def test_measures_in_closed_form(scene: Scene) -> None:
    ball = load_object("sphere:0.05", candidates=256)
    hand = scene.hand
    T = np.tile(np.eye(4), (1, 1, 1))
    q = hand.rest[None]
    none = np.full((1, len(scene.links), 3), np.nan)
    # The object far below the hand: each distance is that of the link's nearest point to the ball.
    T[0, 2, 3] = 1.0
    found = measure(hand, ball, scene.links, T, q, none, none)
    assert (found.distance > 0.7).all() and found.penetration[0] == 0.0
    assert np.isnan(found.contact_error).all() and found.limits_violated[0] == 0
    T[0, 2, 3] = 0.0
    deep = measure(hand, ball, scene.links, T, q + 10, none, none)
    assert deep.penetration[0] > 0.0 and deep.limits_violated[0] == len(hand.joint_names)
    turned = T @ exp_se3(np.array([0, 0, 0, 0, 0, 0.3]))
    turned[0, :3, 3] += [0.03, 0.04, 0.0]
    moved = movement(T, q, turned, q - 0.2)
    assert moved.palm_m[0] == pytest.approx(0.05) and moved.palm_rad[0] == pytest.approx(0.3)
    assert moved.joints_rad[0] == pytest.approx(0.2)


# on a ball, which no piece of a polytope spoils


@pytest.fixture(scope="module")
def on_ball() -> Scene:
    """Six hands about a ball of 7 cm, between 2 and 5 cm from where they should be; the last three penetrate more."""
    hand, rng = load_hand("allegro", candidates=256), np.random.default_rng(0)
    q = np.clip(hand.rest + 0.1 * rng.normal(size=(6, len(hand.rest))), hand.lower, hand.upper)
    tips = [contact.link for contact in hand.contacts]
    T = Kinematics(hand, tips)(torch.eye(4).double().expand(6, 4, 4), torch.from_numpy(q)).numpy()
    root = np.tile(np.eye(4), (6, 1, 1))
    root[:, :3, 3] = 0.004 * rng.normal(size=(6, 3)) - T[:, :, :3, 3].mean(axis=1)
    return Scene(hand, load_object("sphere:0.035", candidates=256), root, q)


BALL = Config(solver=Descent(iterations=250), reach=0.06, tolerance=1e-5)


@pytest.fixture(scope="module")
def grasped(on_ball: Scene) -> Refinement:
    return refine(on_ball, BALL)


def automatic(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The targets that a refinement would choose."""
    return Objective(scene, BALL).targets()[:2]


def loss_at(scene: Scene, T: np.ndarray, q: np.ndarray, targets: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The loss by fresh queries."""
    objective = Objective(scene, BALL)
    arguments = [torch.from_numpy(np.ascontiguousarray(x)) for x in (T, q, *targets)]
    return objective.evaluate(*arguments, 0, None)[0].numpy()


def test_the_loss_is_the_sum_of_its_terms(on_ball: Scene) -> None:
    """Contact for links with a target, depth for all others, joints beyond their limits; nothing twice."""
    scene, T, q = on_ball, on_ball.T_world_root.copy(), on_ball.q.copy()
    T[3:, :3, 3] += [0.0, 0.0, 0.05]
    q[5, 2] = scene.hand.upper[2] + 0.1
    auto = automatic(scene)
    for target in auto:
        target[:, 1:] = np.nan
    found = measure(scene.hand, scene.object, scene.links, T, q, *auto)
    assert (found.distance[:, 1:] < -1e-3).sum() > 5 and (found.distance[:, 0] < 0).any()
    frames = Kinematics(scene.hand, scene.links[:1])(torch.from_numpy(T), torch.from_numpy(q)).numpy()
    miss = [
        found.witness.point_a[:, 0] - transform_points(frames[:, 0], auto[0][:, 0]),
        found.witness.point_b[:, 0] - auto[1][:, 0],
    ]
    expected = found.distance[:, 0] ** 2 + sum((m**2).sum(axis=1) for m in miss)
    expected += 10.0 * (np.minimum(found.distance[:, 1:], 0.0) ** 2).sum(axis=1)
    expected[5] += 0.01 * 0.1**2
    np.testing.assert_allclose(loss_at(scene, T, q, auto), expected, rtol=1e-6)


def test_all_links_come_to_the_ball_and_none_into_it(on_ball: Scene, grasped: Refinement) -> None:
    before, after = (
        measure(on_ball.hand, on_ball.object, on_ball.links, T, q, grasped.target_link, grasped.target_object)
        for T, q in ((on_ball.T_world_root, on_ball.q), (grasped.T_world_root, grasped.q))
    )
    assert np.nanmax(before.contact_error, axis=1).min() > 0.02 and before.penetration.max() > 0.01
    assert np.nanmax(after.contact_error, axis=1).max() < 4e-3 and after.penetration.max() < 1e-3
    assert not after.limits_violated.any()


def test_the_best_iterate_is_returned_with_its_true_loss(on_ball: Scene, grasped: Refinement) -> None:
    targets = grasped.target_link, grasped.target_object
    np.testing.assert_allclose(
        loss_at(on_ball, on_ball.T_world_root, on_ball.q, targets), grasped.loss[:, 0], rtol=1e-6
    )
    np.testing.assert_allclose(
        loss_at(on_ball, grasped.T_world_root, grasped.q, targets), grasped.loss[:, 1], rtol=1e-4
    )
    assert (grasped.loss[:, 1] < grasped.loss[:, 0]).all()
    # More iterations never give less.
    shorter = refine(on_ball, replace(BALL, solver=Descent(iterations=20, shares=(), factors=())))
    longer = refine(on_ball, replace(BALL, solver=Descent(iterations=60, shares=(), factors=())))
    assert (longer.loss[:, 1] <= shorter.loss[:, 1]).all()
    assert shorter.loss.shape == (6, 2) and (shorter.iterations == 20).all()


def test_grasps_that_leave_do_not_disturb_those_that_stay(on_ball: Scene, grasped: Refinement) -> None:
    ended = grasped.iterations
    assert len(np.unique(ended)) > 1 and (grasped.status == Status.CONVERGED).any(), "they end at different times"
    for index in ([5, 2], [0], [3, 4, 1]):
        found = refine(rows(on_ball, index), BALL)
        np.testing.assert_allclose(found.T_world_root, grasped.T_world_root[index], atol=1e-9)
        np.testing.assert_allclose(found.q, grasped.q[index], atol=1e-9)
        np.testing.assert_array_equal(found.status, grasped.status[index])
        np.testing.assert_array_equal(found.iterations, ended[index])
        np.testing.assert_array_equal(found.queries, grasped.queries[index])


def test_costs_are_shared_out(grasped: Refinement) -> None:
    assert (grasped.queries > grasped.iterations).all() and (grasped.wall_s > 0).all()
    order = grasped.iterations.argsort()
    assert (np.diff(grasped.wall_s[order]) >= -1e-12).all(), "who stays longer pays more"


def test_grasps_that_begin_beyond_their_limits_end_within_them(on_ball: Scene) -> None:
    q = on_ball.q[:2].copy()
    q[0, 1], q[1, 5] = on_ball.hand.upper[1] + 0.2, on_ball.hand.lower[5] - 0.2
    found = refine(replace(on_ball, T_world_root=on_ball.T_world_root[:2], q=q), BALL)
    assert (found.q >= on_ball.hand.lower).all() and (found.q <= on_ball.hand.upper).all()
    assert (found.loss[:, 1] < found.loss[:, 0]).all()


def test_a_failed_query_ends_a_grasp_with_the_best_it_had(
    on_ball: Scene, grasped: Refinement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pair that was not answered counts nothing in the loss; the grasp once ended as converged, at a loss of 0."""
    calls = []

    def fails_once(*arguments: object, **keywords: object) -> Witness:
        found = query(*arguments, **keywords)
        calls.append(len(found.distance))
        if len(calls) == 10:
            status, distance = found.status.copy(), found.distance.copy()
            status[0, :4], distance[0, :4] = QueryStatus.FAILED, np.nan
            points = [np.where(status[..., None] > QueryStatus.FAR, 0.0, p) for p in (found.point_a, found.point_b)]
            found = replace(found, point_a=points[0], point_b=points[1], distance=distance, status=status)
        return found

    monkeypatch.setattr(autograd, "query", fails_once)
    short = replace(BALL, solver=Descent(iterations=40))
    found = refine(on_ball, short)
    assert calls[9] == 6 and calls[10] == 5
    assert found.status[0] == Status.NOT_FINITE and found.iterations[0] == 10
    assert 0.0 < found.loss[0, 1] < found.loss[0, 0]
    monkeypatch.undo()
    clean = refine(on_ball, short)
    np.testing.assert_allclose(found.q[1:], clean.q[1:], atol=1e-9)
    np.testing.assert_array_equal(found.status[1:], clean.status[1:])


def test_when_no_query_is_answered_the_loop_ends(on_ball: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object, **keywords: object) -> Witness:
        found = query(*arguments, **keywords)
        return replace(found, status=np.full_like(found.status, QueryStatus.FAILED))

    monkeypatch.setattr(autograd, "query", fails)
    said = []
    found = refine(on_ball, BALL, lambda *progress: said.append(progress))
    assert (found.status == Status.NOT_FINITE).all() and said == [(6, 1, 0.0)]
    np.testing.assert_array_equal(found.T_world_root, on_ball.T_world_root)


@pytest.mark.parametrize("side", [0, 1])
def test_targets_on_one_side_only_are_no_targets(on_ball: Scene, grasped: Refinement, side: int) -> None:
    """The grasp once ended as converged before it began."""
    targets = [grasped.target_link.copy(), grasped.target_object.copy()]
    targets[side][:3] = np.nan
    found = refine(replace(on_ball, target_link=targets[0], target_object=targets[1]), SHORT)
    assert (found.status[:3] == Status.NO_TARGET).all() and (found.status[3:] != Status.NO_TARGET).all()
    assert np.isnan(found.target_link[:3]).all() and np.isnan(found.target_object[:3]).all()
    np.testing.assert_array_equal(found.q[:3], on_ball.q[:3])


def test_no_grasps_at_all_are_refined_at_once(on_ball: Scene) -> None:
    found = refine(rows(on_ball, []), BALL)
    assert found.T_world_root.shape == (0, 4, 4) and found.loss.shape == (0, 2)


def test_transport_makes_it_no_derivative_but_a_descent(on_ball: Scene) -> None:
    found = refine(on_ball, replace(BALL, solver=Descent(iterations=80, transport=True)))
    assert (found.loss[:, 1] < 0.2 * found.loss[:, 0]).all()
