"""The loop: it converges, ends with a status, and no grasp depends on another, whatever the solver."""

import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from boxed_example import boxed_example
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.measures.geometry import measure
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.clearance import OTHER_MODEL_CLEARANCE_M, clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.witness import autograd
from refusals import refused

SOLVERS = {
    "levenberg-marquardt": LevenbergMarquardt(iterations=60, restarts=1),
    "descent": Descent(iterations=6),
    "adam": Adam(iterations=6),
}
NEAREST = Config(nearest=True)
GEOMETRY = Config(weights=Weights(wrench=0.0))
"""Contacts close, whether their forces balance or not."""
SHORT = Config(solver=Descent(iterations=8), nearest=True)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The four example grasps of the embedded hand on the embedded box, one of the fastest objects."""
    return boxed_example()


@pytest.fixture(scope="module")
def touched(scene: Scene) -> Refinement:
    """The example grasps with their contacts closed."""
    return refine(scene, GEOMETRY)


@pytest.fixture(scope="module")
def aimed(scene: Scene, touched: Refinement) -> Scene:
    """Hands that once touched, integrate away by 1 cm, 9 degrees and 0.1 rad, that should touch there again."""
    return disturbed(scene, touched, 4, 0)


def disturbed(scene: Scene, touched: Refinement, count: int, seed: int) -> Scene:
    """The same of `count` hands, the examples over and over."""
    again = np.arange(count) % 4
    there = replace(scene, T_world_root=touched.T_world_root[again], q=touched.q[again])
    goal, rng = goal_of(there, ContactSelection(), nearest=True), np.random.default_rng(seed)
    dx = rng.normal(size=(count, 6)) * [0.006, 0.006, 0.006, 0.1, 0.1, 0.1]
    q = np.clip(there.q + 0.1 * rng.normal(size=there.q.shape), scene.hand.lower, scene.hand.upper)
    return Scene(scene.hand, scene.object, integrate(there.T_world_root, dx), q, goal.target_link, goal.target_object)


def true_loss(scene: Scene, T: np.ndarray, q: np.ndarray, found: Refinement, config: Config) -> np.ndarray:
    """The loss by plain queries and another kinematics, term by term."""
    measured = measure(HandObject.of(scene), T, q, found.target_link, found.target_object)
    w, d = measured.witness, measured.distance
    poses = Kinematics(scene.hand, scene.links)(torch.from_numpy(T), torch.from_numpy(q)).numpy()
    miss_link = w.point_a - transform_points(poses, found.target_link)
    miss_object = w.point_b - found.target_object
    loss = config.weights.contact * (found.touching * (d - config.margin) ** 2).sum(axis=1)
    loss += config.weights.contact * (np.nansum(miss_link**2, axis=(1, 2)) + np.nansum(miss_object**2, axis=(1, 2)))
    loss += config.weights.penetration * (np.minimum(d, 0.0) ** 2).sum(axis=1)
    own = touching_pairs(scene.hand)
    first, second = ([scene.links.index(pair[side]) for pair in own] for side in (0, 1))
    bodies = [scene.hand.links_by_name[name].body for name in scene.links]
    pairs = Pairs(tuple(bodies[i] for i in first), tuple(bodies[i] for i in second))
    deep = np.minimum(query(pairs, poses[:, first], poses[:, second]).distance, 0.0)
    return loss + config.weights.self_penetration * (deep**2).sum(axis=1)


def within_limits(scene: Scene, q: np.ndarray) -> bool:
    return bool((q >= scene.hand.lower).all() and (q <= scene.hand.upper).all())


# geometry alone


def test_links_that_are_near_come_to_touch_and_nothing_penetrates(scene: Scene, touched: Refinement) -> None:
    assert (touched.status == Status.CONVERGED).all() and (touched.loss[:, 1] < 1e-10).all()
    assert (touched.iterations < 20).all()
    none = np.full((4, len(scene.links), 3), np.nan)
    before, after = (
        measure(HandObject.of(scene), T, q, none, none)
        for T, q in ((scene.T_world_root, scene.q), (touched.T_world_root, touched.q))
    )
    gaps = np.where(touched.touching, np.abs(after.distance), 0.0).max(axis=1)
    assert (gaps < 1e-5).all() and (after.penetration < 1e-5).all() and not after.limits_violated.any()
    assert np.where(touched.touching, np.abs(before.distance), 0.0).max() > 5e-3
    assert np.isnan(touched.target_link).all() and within_limits(scene, touched.q)


def test_given_targets_are_reached_again(aimed: Scene) -> None:
    with Stopwatch() as whole:
        found = refine(aimed, GEOMETRY)
    with Stopwatch() as selection:
        goal_of(aimed, ContactSelection())
    assert found.queries.sum() == whole.queries - selection.queries
    np.testing.assert_array_equal(found.target_link, aimed.target_link)
    np.testing.assert_array_equal(found.touching, np.isfinite(aimed.target_link[..., 0]))
    assert (found.status == Status.CONVERGED).sum() >= 3
    after = measure(HandObject.of(aimed), found.T_world_root, found.q, found.target_link, found.target_object)
    error = np.nanmax(after.contact_error, axis=1)
    assert (error[found.status == Status.CONVERGED] < 1e-5).all()


def test_a_margin_is_kept(scene: Scene) -> None:
    found = refine(scene, replace(GEOMETRY, margin=2e-3))
    assert (found.status == Status.CONVERGED).all()
    none = np.full((4, len(scene.links), 3), np.nan)
    after = measure(HandObject.of(scene), found.T_world_root, found.q, none, none)
    np.testing.assert_allclose(after.distance[found.touching], 2e-3, atol=1.1e-5)


def test_links_that_are_no_contact_links_keep_their_clearance(scene: Scene) -> None:
    """Contact links and the palm, which does not move, have none; what a result calls the contact error knows it."""
    clearance = 3e-3
    selection = ContactSelection(other_link_distance=0.02)
    config = Config(clearance=clearance, contact_selection=selection, weights=Weights(wrench=0.0))
    found = refine(scene, config)
    assert (found.status == Status.CONVERGED).all()
    none = np.full((4, len(scene.links), 3), np.nan)
    distance = measure(HandObject.of(scene), found.T_world_root, found.q, none, none).distance
    tips = {contact.link for contact in scene.hand.contacts}
    other = np.array([name not in tips and name != scene.hand.base_link for name in scene.links])
    assert (found.touching & other).any()
    assert (distance[:, other] > clearance - 1.1e-5).all()
    expected = np.broadcast_to(np.where(other, clearance, 0.0), distance.shape)
    np.testing.assert_allclose(distance[found.touching], expected[found.touching], atol=1.1e-5)
    named = ContactSelection(links=tuple(name for name, is_other in zip(scene.links, other, strict=True) if is_other))
    chain = Chain(scene.hand, scene.links)
    assert not clearances(replace(config, contact_selection=named), scene.hand, chain).any()


def test_a_hand_that_is_simulated_with_other_geometry_has_a_clearance_by_itself(scene: Scene) -> None:
    chain = Chain(scene.hand, scene.links)
    assert not clearances(Config(), scene.hand, chain).any()
    simulated = replace(scene.hand, mjcf=scene.hand.urdf.with_name("hand.xml"), collision="mjcf")
    assert clearances(Config(), simulated, chain).max() == OTHER_MODEL_CLEARANCE_M
    assert not clearances(Config(clearance=0.0), simulated, chain).any()
    assert not clearances(Config(), replace(simulated, collision="urdf"), chain).any()
    assert not clearances(Config(), replace(simulated, mjcf=scene.hand.urdf), chain).any()


def test_links_given_by_name_touch_and_others_need_not(scene: Scene) -> None:
    names = scene.links[1], scene.links[3]
    found = refine(scene, replace(GEOMETRY, contact_selection=ContactSelection(links=names)))
    np.testing.assert_array_equal(found.touching, np.tile(np.isin(scene.links, names), (4, 1)))
    assert (found.status == Status.CONVERGED).all()
    none = np.full((4, len(scene.links), 3), np.nan)
    after = measure(HandObject.of(scene), found.T_world_root, found.q, none, none)
    np.testing.assert_allclose(after.distance[found.touching], 0.0, atol=1.1e-5)


def test_what_is_prepared_for_another_object_is_refused(scene: Scene) -> None:
    ball = load_object("sphere:0.05", candidates=64)
    with refused(GraspRefineError, "allegro", "sphere:0.05", "rounded_box"):
        refine(scene, prepared=HandObject(scene.hand, ball))


def test_a_link_that_should_touch_in_a_direction_comes_from_afar(scene: Scene, touched: Refinement) -> None:
    """Not near at first, it was once no part of the grasp, and its direction meant nothing."""
    row, column = np.argwhere(~touched.touching[:, :4])[0]
    wanted = np.full((4, len(scene.links), 3), np.nan)
    wanted[row, column] = [0.0, 0.0, -1.0]
    config = Config(weights=Weights(direction=1e-8, wrench=0.0))
    found = refine(replace(scene, direction=wanted), config)
    assert found.touching[row, column] and (found.touching != touched.touching).sum() == 1
    none = np.full((4, len(scene.links), 3), np.nan)
    before, after = (
        measure(HandObject.of(scene), one.T_world_root, one.q, none, none).distance[row, column]
        for one in (scene, found)
    )
    assert before > ContactSelection().reach and abs(after) < 1e-3


# every solver


@pytest.mark.parametrize("nearest", [False, True], ids=["gap", "nearest"])
@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_lowers_the_true_loss_within_the_limits(scene: Scene, name: str, nearest: bool) -> None:
    config = Config(solver=SOLVERS[name], nearest=nearest, weights=Weights(joint_limits=0.0, wrench=0.0))
    found = refine(scene, config)
    fall = 0.1 if name == "levenberg-marquardt" else 0.8
    assert (found.loss[:, 1] < fall * found.loss[:, 0]).all() and within_limits(scene, found.q)
    start = np.clip(scene.q, scene.hand.lower, scene.hand.upper)
    np.testing.assert_allclose(
        true_loss(scene, scene.T_world_root, start, found, config), found.loss[:, 0], rtol=1e-6, atol=1e-12
    )
    np.testing.assert_allclose(
        true_loss(scene, found.T_world_root, found.q, found, config), found.loss[:, 1], rtol=1e-4, atol=1e-12
    )
    R = found.T_world_root[:, :3, :3]
    np.testing.assert_allclose(R @ R.mT, np.broadcast_to(np.eye(3), R.shape), atol=1e-9)


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_accounts_for_its_work(scene: Scene, name: str) -> None:
    said: list[tuple[int, int, float]] = []
    config = replace(GEOMETRY, solver=SOLVERS[name], tolerance=1e-7)
    wall, cpu = time.perf_counter(), time.process_time()
    with Stopwatch() as watch:
        found = refine(scene, config, lambda *now: said.append(now))
    assert found.queries.sum() == watch.queries
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    # All of it is shared out, what was done before the first iteration too.
    assert 0.9 * cpu < found.cpu_s.sum() <= cpu and found.wall_s.sum() <= wall
    done, iterations, loss = (np.array(column) for column in zip(*said, strict=True))
    assert done[-1] == 4 and (np.diff(done) >= 0).all() and np.isfinite(loss).all()
    np.testing.assert_array_equal(iterations, np.arange(1, found.iterations.max() + 1))
    assert (found.queries >= found.iterations).all() and (found.wall_s > 0).all() and (found.cpu_s >= 0).all()
    np.testing.assert_array_equal(found.status == Status.CONVERGED, found.loss[:, 1] < 1e-7)


@pytest.mark.parametrize("name", SOLVERS)
def test_grasps_that_begin_beyond_their_limits_end_within_them(scene: Scene, name: str) -> None:
    """The loss is that of the grasp which is returned; descent once gave that of joints beyond their limits."""
    q = scene.q.copy()
    q[0, 1], q[1, 5] = scene.hand.upper[1] + 0.2, scene.hand.lower[5] - 0.2
    config = replace(GEOMETRY, solver=SOLVERS[name])
    found = refine(replace(scene, q=q), config)
    assert within_limits(scene, found.q) and (found.loss[:, 1] < found.loss[:, 0]).all()
    np.testing.assert_allclose(
        true_loss(scene, found.T_world_root, found.q, found, config), found.loss[:, 1], rtol=1e-4, atol=1e-12
    )


# ends


def test_a_grasp_that_is_there_already_is_left_alone(aimed: Scene) -> None:
    """Inverse kinematics once integrate it before it was looked at."""
    first = refine(aimed, GEOMETRY)
    there = np.flatnonzero(first.status == Status.CONVERGED)
    scene = replace(aimed.select(there), T_world_root=first.T_world_root[there], q=first.q[there])
    found = refine(scene, GEOMETRY)
    assert (found.status == Status.CONVERGED).all() and not found.iterations.any()
    np.testing.assert_array_equal(found.T_world_root, scene.T_world_root)
    np.testing.assert_array_equal(found.q, scene.q)
    np.testing.assert_array_equal(found.loss[:, 0], found.loss[:, 1])
    np.testing.assert_allclose(found.loss[:, 1], first.loss[there, 1], rtol=1e-3, atol=1e-14)


def test_targets_that_exclude_each_other_end_as_stalled_not_for_want_of_iterations(aimed: Scene) -> None:
    """All links are to touch at the place of the first; new starts use up the iterations, and nothing falls."""
    one = aimed.select(np.array([1]))
    place = np.where(np.isnan(one.target_object), np.nan, one.target_object[:, :1])
    assert (np.isfinite(place[..., 0]).sum(axis=1) >= 2).all()
    config = Config(solver=LevenbergMarquardt(iterations=300, restarts=6))
    found = refine(replace(one, target_object=place), config)
    assert (found.iterations > 60).all() and (found.status == Status.STALLED).all() and (found.loss[:, 1] > 1e-4).all()


def test_targets_off_the_surface_are_named_as_such(aimed: Scene) -> None:
    on_object, on_link = aimed.target_object.copy(), aimed.target_link.copy()
    column = int(np.flatnonzero(np.isfinite(on_object[0, :, 0]))[0])
    away = on_object[0, column] / np.linalg.norm(on_object[0, column])
    on_object[0, column] += 0.005 * away
    # A twentieth of a millimetre is rounding of targets, though no grasp reaches them.
    near = int(np.flatnonzero(np.isfinite(on_object[2, :, 0]))[0])
    on_object[2, near] *= 1.0 + 5e-5 / np.linalg.norm(on_object[2, near])
    link = int(np.flatnonzero(np.isfinite(on_link[1, :, 0]))[0])
    on_link[1, link] += [0.0, 0.0, 0.03]
    config = Config(solver=LevenbergMarquardt(iterations=60))
    found = refine(replace(aimed, target_object=on_object, target_link=on_link), config)
    np.testing.assert_array_equal(found.status[:2], [Status.UNREACHABLE, Status.UNREACHABLE])
    assert (found.status[2:] != Status.UNREACHABLE).all() and found.loss[2, 1] > config.tolerance
    # What they ask for is approached all the same.
    assert (found.loss[:2, 1] < found.loss[:2, 0]).all() and (found.loss[:2, 1] > 1e-6).all()


def test_a_grasp_far_away_has_no_target(scene: Scene) -> None:
    T = scene.T_world_root[:2].copy()
    T[0, 0, 3] += 1.0
    for config in (Config(LevenbergMarquardt(iterations=3), starts=1), NEAREST, SHORT):
        found = refine(replace(scene, T_world_root=T, q=scene.q[:2]), config)
        assert found.status[0] == Status.NO_TARGET and "`contacts`" in Status.NO_TARGET.advice
        assert np.isnan(found.loss[0]).all() and np.isfinite(found.loss[1]).all()
        np.testing.assert_array_equal(found.T_world_root[0], T[0])
        assert found.status[1] != Status.NO_TARGET and found.iterations[0] == 0


@pytest.mark.parametrize("config", [Config(), NEAREST, SHORT], ids=["gap", "nearest", "descent"])
def test_no_grasps_at_all_are_refined_at_once(scene: Scene, config: Config) -> None:
    found = refine(scene.select(np.arange(0)), config)
    assert found.T_world_root.shape == (0, 4, 4) and found.loss.shape == (0, 2)


# grasps on their own


def same(one: Refinement, other: Refinement, index: list[int], own: list[int]) -> None:
    """The grasps `index` of one result are `own` of the other: status and counts exactly, numbers to 1e-7.

    Rounding depends on the size of the batch and on the processor; a grasp ends where its loss is below a tolerance.
    """
    for name in ("status", "iterations", "queries"):
        np.testing.assert_array_equal(getattr(one, name)[index], getattr(other, name)[own], err_msg=name)
    np.testing.assert_allclose(one.T_world_root[index], other.T_world_root[own], atol=1e-7)
    np.testing.assert_allclose(one.q[index], other.q[own], atol=1e-7)
    np.testing.assert_allclose(one.loss[index], other.loss[own], rtol=1e-6, atol=1e-13)


def test_the_width_of_the_batch_changes_nothing(aimed: Scene) -> None:
    """Slots are refilled while others are under way."""
    twice = aimed.select(np.array([0, 1, 2, 3, 3, 2]))
    config = replace(GEOMETRY, solver=LevenbergMarquardt(iterations=60))
    same(refine(twice, replace(config, width=3)), refine(twice, config), list(range(6)), list(range(6)))


def test_new_starts_depend_on_the_grasp_alone(
    scene: Scene, touched: Refinement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another order, among fewer at once; they were once those of the place in the scene."""
    again: list[int] = []
    plain = GraspProblem.restart

    def recorded(problem: GraspProblem, member: np.ndarray, *others: object) -> Point:
        again.extend(member.tolist())
        return plain(problem, member, *others)

    monkeypatch.setattr(GraspProblem, "restart", recorded)
    eight, config = disturbed(scene, touched, 8, 2), replace(GEOMETRY, solver=LevenbergMarquardt(patience=3))
    together = refine(eight, config)
    assert len(set(again)) >= 2 and (together.iterations[again] > 15).all()
    order = [5, 2, 7, 0, 3, 6, 1, 4]
    shuffled = refine(eight.select(np.array(order)), replace(config, width=2))
    np.testing.assert_array_equal(shuffled.status, together.status[order])
    np.testing.assert_allclose(shuffled.q, together.q[order], atol=1e-6)


# descent


@pytest.mark.parametrize("transport", [False, True])
def test_single_precision_and_transport_run(scene: Scene, transport: bool) -> None:
    config = Config(solver=Descent(iterations=8, transport=transport), dtype="float32", nearest=True)
    result = refine(scene, config)
    assert (result.loss[:, 1] < 0.8 * result.loss[:, 0]).all()
    R = result.T_world_root[:, :3, :3]
    np.testing.assert_allclose(R @ R.mT, np.broadcast_to(np.eye(3), R.shape), atol=1e-5)


# descent on a ball, which no piece of a polytope spoils


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


LONG = Descent(iterations=50, step_translation=2e-3, step_rotation=2e-2, step_joints=4e-2)
"""Steps of twice the default length, in a third of the iterations that the default ones need here."""
BALL = Config(
    solver=LONG,
    nearest=True,
    contact_selection=ContactSelection(reach=0.06, other_link_distance=0.0),
    weights=Weights(penetration=10.0, self_penetration=0.0),
    tolerance=8e-5,
)


def test_all_fingertips_come_to_the_ball_and_none_into_it(on_ball: Scene) -> None:
    two = on_ball.select(np.array([0, 4]))
    grasped = refine(two, BALL)
    before, after = (
        measure(HandObject.of(on_ball), T, q, grasped.target_link, grasped.target_object)
        for T, q in ((two.T_world_root, two.q), (grasped.T_world_root, grasped.q))
    )
    assert np.nanmax(before.contact_error, axis=1).min() > 0.02 and before.penetration.max() > 0.01
    assert np.nanmax(after.contact_error, axis=1).max() < 0.01 and after.penetration.max() < 1e-3
    assert not after.limits_violated.any()


def test_a_failed_query_ends_a_grasp_with_the_best_it_had(on_ball: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pair that was not answered counts nothing in the loss; the grasp once ended as converged, at a loss of 0."""
    calls = []

    def fails_once(*arguments: object, **keywords: object) -> Witness:
        found = query(*arguments, **keywords)
        calls.append(len(found.distance))
        if len(calls) == 4:
            status, distance = found.status.copy(), found.distance.copy()
            status[0, :4], distance[0, :4] = QueryStatus.FAILED, np.nan
            points = [np.where(status[..., None] > QueryStatus.FAR, 0.0, p) for p in (found.point_a, found.point_b)]
            found = replace(found, point_a=points[0], point_b=points[1], distance=distance, status=status)
        return found

    monkeypatch.setattr(autograd, "query", fails_once)
    short = replace(BALL, solver=Descent(iterations=6))
    found = refine(on_ball, short)
    assert calls[3] == 6 and calls[4] == 5
    assert found.status[0] == Status.NOT_FINITE and found.iterations[0] == 4
    assert 0.0 < found.loss[0, 1] < found.loss[0, 0]
    monkeypatch.undo()
    clean = refine(on_ball, short)
    same(found, clean, [1, 2, 3, 4, 5], [1, 2, 3, 4, 5])
