"""Search for force closure: the best of several starts by its score, each grasp on its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adaptive_gripper import write_adaptive_gripper
from claw import around, capsule, claw
from grasp_refine.collision.query import query
from grasp_refine.core.array_records import take
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.se3 import exp_so3, transform_points
from grasp_refine.forces.equilibrium import mode_residual
from grasp_refine.forces.quality import DEEP, quality
from grasp_refine.forces.squeeze import CONTACTS, contacts, pressure_shortfall
from grasp_refine.forces.strong_pushes import strong_push_residual
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region import HalfSpace
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import (
    PINCH_SHARE,
    SAME_SCORE,
    START_JOINTS_RAD,
    START_ROTATION_RAD,
    START_TRANSLATION_M,
    Search,
    most_iterations,
)
from grasp_refine.refinement.grasp_problem import GraspProblem, sample_noise
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.refinement.judging import MISS_SCALE_M, SHORTFALL_WEIGHT, YIELDING_WEIGHT, judge
from grasp_refine.refinement.phases import CLOSE, PHASES, SETTLE, SLIDE
from grasp_refine.refinement.pinches import BEST_SCORE, pinch_score
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.iterate import Point, limited
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_patches import patch_misses
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from search_attempts import attempts

CONFIG = Config(starts=3, prefer="strongest", solver=LevenbergMarquardt(iterations=15))
STILL = replace(CONFIG, solver=LevenbergMarquardt(iterations=0))
"""Settings under which no grasp moves."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Four hands of round fingertips about a capsule; some of them need other starts."""
    return around(claw(tmp_path_factory.mktemp("claw")), capsule(), 4, 1)


@pytest.fixture(scope="module")
def prepared(scene: Scene) -> HandObject:
    return HandObject.of(scene)


@pytest.fixture(scope="module")
def iterated(scene: Scene, prepared: HandObject) -> tuple[Refinement, list[IterationState], list[tuple], int]:
    """Grasps with all their starts, the states on the way, the progress, and the number of queries."""
    states: list[IterationState] = []
    progress: list[tuple[int, int, float]] = []
    with Stopwatch() as watch:
        found = refine(scene, CONFIG, lambda *now: progress.append(now), states.append, prepared=prepared)
    return found, states, progress, watch.queries


@pytest.fixture(scope="module")
def held(iterated: tuple[Refinement, Any, Any, Any]) -> Refinement:
    return iterated[0]


@pytest.fixture(scope="module")
def by_geometry(scene: Scene, prepared: HandObject) -> Refinement:
    """The grasps with their contacts closed, whatever the forces."""
    return refine(scene, replace(CONFIG, weights=replace(CONFIG.weights, wrench=0.0)), prepared=prepared)


@pytest.fixture
def insatiable(monkeypatch: pytest.MonkeyPatch) -> None:
    """No score is good enough, so that all starts are tried."""
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)


def score(prepared: HandObject, found: Refinement) -> np.ndarray:
    return judge(prepared, prepared.chain(found.T_world_root, found.q))[0]


def search_of(scene: Scene, prepared: HandObject, config: Config = CONFIG) -> Search:
    return Search(scene, prepared, config, np.full(len(scene.q), Status.RUNNING), None, None)


def same(one: Refinement, other: Refinement, index: list[int], own: list[int]) -> None:
    """The grasps `index` of one result are `own` of the other; costs may be shared otherwise."""
    for name in ("status", "starts", "touching"):
        np.testing.assert_array_equal(getattr(one, name)[index], getattr(other, name)[own], err_msg=name)
    np.testing.assert_allclose(one.T_world_root[index], other.T_world_root[own], atol=1e-6)
    np.testing.assert_allclose(one.q[index], other.q[own], atol=1e-6)
    np.testing.assert_allclose(one.loss[index], other.loss[own], rtol=1e-3, atol=1e-10)


# results


def test_forces_that_balance_are_never_worse_than_closed_contacts(
    held: Refinement, by_geometry: Refinement, prepared: HandObject
) -> None:
    """The attempt by geometry alone is one of those of which the best counts; grasps touch and penetrate nothing."""
    closed, balanced = (score(prepared, found) for found in (by_geometry, held))
    assert (balanced <= closed + SAME_SCORE).all() and (balanced < closed - 0.01).any()
    T = prepared.chain(held.T_world_root, held.q).T_world_link
    distance = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape)).distance
    done = held.status == Status.CONVERGED
    assert done.any() and (distance[done] > -2e-5).all()
    assert np.abs(np.where(held.touching, distance, 0.0)[done]).max() < 2e-5
    assert (held.q >= prepared.hand.lower).all() and (held.q <= prepared.hand.upper).all()


def test_the_loss_is_of_the_last_phase_without_forces(scene: Scene, held: Refinement, prepared: HandObject) -> None:
    """Before and after, of the links that touch at last: squares of gaps and depths."""
    for column, (T, q) in enumerate(((scene.T_world_root, scene.q), (held.T_world_root, held.q))):
        T_link = prepared.chain(T, q).T_world_link
        d = query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape)).distance
        first, second = prepared.self_collision_links
        own = query(prepared.self_collision_pairs, T_link[:, first], T_link[:, second]).distance
        weights = CONFIG.weights
        loss = weights.contact * (held.touching * d**2).sum(axis=1)
        loss += weights.penetration * (np.minimum(d, 0.0) ** 2).sum(axis=1)
        loss += weights.self_penetration * (np.minimum(own, 0.0) ** 2).sum(axis=1)
        np.testing.assert_allclose(held.loss[:, column], loss, rtol=1e-6, atol=1e-13)


def test_all_work_is_counted(scene: Scene, prepared: HandObject, iterated: tuple[Refinement, Any, list, int]) -> None:
    """A tick of the progress for each iteration; queries of all starts, and of the selections of their contacts."""
    found, _, progress, queries = iterated
    done, ticks, loss = (np.array(column) for column in zip(*progress, strict=True))
    np.testing.assert_array_equal(ticks, np.arange(1, len(ticks) + 1))
    assert (np.diff(done) >= 0).all() and done[-1] <= 4 and np.isfinite(loss).all()
    assert found.queries.sum() <= queries and (found.cpu_s > 0).all()
    assert (found.iterations <= most_iterations(CONFIG)).all()
    assert most_iterations(CONFIG) == 15 + 3 * (15 + 15 + 15)
    assert most_iterations(Config(starts=2, prefer="strongest")) == 40 + 2 * (25 + 15 + 40)
    assert most_iterations(Config(starts=2)) == 2 * 40 + (2 + 2) * (25 + 15 + 40)
    # Of a phase without iterations: one evaluation, after the selection.
    search = search_of(scene, prepared, STILL)
    every, point = np.arange(4), Point(scene.T_world_root, scene.q)
    search.attempt(every, point, (CLOSE,))
    goal = goal_of(scene, STILL.contact_selection, prepared)
    problem = GraspProblem(scene, goal, replace(STILL, weights=CLOSE.weights(STILL.weights)), prepared)
    expected = goal.queries + problem.evaluate(every, point, None).num_queries
    np.testing.assert_array_equal(search.queries, expected)
    assert goal.queries.all()
    # The result counts them once.
    whole = force_closure_search.search(scene, prepared, STILL, np.full(4, Status.RUNNING)).minimum.queries
    np.testing.assert_array_equal(refine(scene, STILL, prepared=prepared).queries, whole)


# scores


@pytest.mark.parametrize("kind", ["table", "body", "regions"])
def test_depths_elsewhere_and_contacts_outside_of_regions_cost_their_share(
    scene: Scene, held: Refinement, prepared: HandObject, kind: str
) -> None:
    """The same grasp, not moved at all, with and without a table, a body around the object, or a region."""
    first = np.array([int(np.flatnonzero(held.status == Status.CONVERGED)[0])])
    one, first = replace(scene, T_world_root=held.T_world_root[first], q=held.q[first]), np.array([0])
    frames = prepared.chain(one.T_world_root, one.q)
    T = frames.T_world_link
    if kind == "table":
        lowest = float(transform_points(T, Plane().lowest(prepared.bodies, T))[..., 2].min())
        task, cost = Task(table=lowest + 0.004), 0.004 / DEEP
    elif kind == "body":
        index = prepared.bodies[0].pieces[0]
        center = transform_points(T[0, 0], index.vertices[:1])[0]
        # A small ball, 5 mm beside the axis of the finger.
        T_ball = np.eye(4)
        T_ball[:3, 3] = center + [0.0, 0.003, 0.004]
        ball = EnvironmentBody("ball", build_body("ball", [sphere(0.001)]), T_ball, margin=0.002)
        others = np.linalg.norm(transform_points(T[0, 1:4], np.zeros((3, 3))) - T_ball[:3, 3], axis=-1)
        assert others.min() > 0.02
        depth = index.radius + 0.001 + 0.002 - np.linalg.norm(np.cross(T_ball[:3, 3] - center, _axis(T[0, 0], index)))
        task, cost = Task(scene=Environment((ball,), np.eye(4), lift=0.0)), depth / DEEP
    else:
        cutoff = CONTACTS.cutoff(one.hand, one.links)
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff)
        # A contact is on the side of the object where it should not be.
        outward = -witness.normal[0, int(np.argmin(np.abs(witness.distance[0])))]
        task = Task(avoid=(HalfSpace("side", outward, 0.01),))
        regions = replace(one, task=task).regions
        found = patch_misses(regions, prepared.bodies, one.object.body, T, witness)
        cost = float(found.miss.max()) / MISS_SCALE_M
        assert cost > 0.5
    scores = []
    for asked in (Task(), task):
        search = search_of(replace(one, task=asked), prepared, STILL)
        scores.append(float(search.attempt(first, take(search.inputs, first), (CLOSE,)).score[0]))
    assert scores[1] - scores[0] == pytest.approx(cost, rel=1e-4)


def test_links_in_each_other_cost_their_depth(scene: Scene, prepared: HandObject) -> None:
    hand = scene.hand
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (300, len(hand.lower)))
    T = np.tile(scene.T_world_root[:1], (300, 1, 1))
    frames, pairs = prepared.chain(T, q), prepared.self_collision_links
    inside = -query(prepared.self_collision_pairs, *(frames.T_world_link[:, side] for side in pairs)).distance.min(
        axis=1
    )
    plain = judge(prepared, frames)[0]
    row = int(np.where(np.isfinite(plain), inside, 0.0).argmax())
    assert inside[row] > 1e-3
    search = search_of(replace(scene, T_world_root=T[[row]], q=q[[row]]), prepared, STILL)
    found = search.attempt(np.array([0]), take(search.inputs, np.array([0])), (CLOSE,)).score[0]
    assert found - plain[row] == pytest.approx(inside[row] / DEEP, rel=1e-6)


def _axis(T: np.ndarray, piece: Any) -> np.ndarray:
    along = T[:3, :3] @ (piece.vertices[1] - piece.vertices[0])
    return along / np.linalg.norm(along)


def test_the_score_is_the_sum_of_its_parts_on_a_linkage_gripper(tmp_path: Path) -> None:
    """Shortcomings, strong pushes, set points that end, fingers that yield, and pinches, each with its weight."""
    hand = load_hand(write_adaptive_gripper(tmp_path), candidates=64)
    prepared = HandObject(hand, load_object("sphere:0.025", candidates=64))
    chain, values = Chain(hand, ("right_pad",)), np.linspace(hand.lower[0], hand.upper[0], 201)
    T_pad = chain(np.tile(np.eye(4), (201, 1, 1)), values[:, None]).T_world_link[:, 0]
    at = np.abs(T_pad[:, 0, 3] - 0.004 - 0.0255).argmin()  # pads of 4 mm either way nearly touch a ball between them
    T, q = np.tile(np.eye(4), (2, 1, 1)), np.tile(values[at], (2, 1))
    T[:, 2, 3] = -T_pad[at, 2, 3] + np.array([-0.015, 0.012])
    ends = np.array([[hand.lower[0], values[at] + 1e-3]])
    hand = replace(hand, actuator=replace(hand.actuator, set_points=ends))
    prepared = HandObject(hand, prepared.object)
    frames = prepared.chain(T, q)
    poses = frames.T_world_link
    witness = query(
        prepared.pairs,
        poses,
        np.broadcast_to(np.eye(4), poses.shape),
        cutoff=CONTACTS.cutoff(hand, prepared.chain.links),
    )
    points = contacts(hand, prepared.object, prepared.chain.links, witness, poses)
    of, clearance = (hand, prepared.object, prepared.chain, frames), np.full(len(prepared.chain.links), 3e-4)
    parts = {
        "quality": quality(*of, witness, clearance).score,
        "strong": strong_push_residual(points, prepared.object, T[:, :3, :3]),
        "shortfall": SHORTFALL_WEIGHT * pressure_shortfall(*of, points),
        "yielding": YIELDING_WEIGHT * mode_residual(*of, points),
        "pinch": pinch_score(prepared, frames, witness, points),
    }
    for name, part in parts.items():
        assert np.isfinite(part).all() and part.max() > 0.02, name
    found, pinches, value = judge(prepared, frames, clearance)
    np.testing.assert_array_equal(value, quality(*of, witness, clearance).value)
    np.testing.assert_allclose(found, sum(parts.values()), rtol=1e-9)
    assert (judge(prepared, frames)[0] > found + 0.01).all(), "gaps on purpose are no shortcoming"
    # Two fingers are at best so good that their score is what other hands need not be tried again for.
    jaws = search_of(Scene(hand, prepared.object, T, q), prepared)
    assert pinches.all() and jaws.good == force_closure_search.GOOD_SCORE + BEST_SCORE


def test_without_forces_the_score_is_infinite_and_three_contacts_are_no_pinch(
    scene: Scene, held: Refinement, prepared: HandObject
) -> None:
    T = held.T_world_root.copy()
    T[0, 0, 3] += 1.0
    frames = prepared.chain(T, held.q)
    found, pinches, value = judge(prepared, frames)
    assert np.isinf(found[0]) and np.isfinite(found[1:]).all() and value[0] == 0.0 and (value[1:] > 0.0).all()
    near = query(prepared.pairs, frames.T_world_link, np.tile(np.eye(4), (4, len(scene.links), 1, 1)))
    number = CONTACTS.choose(scene.hand, scene.links, near).sum(axis=1)
    np.testing.assert_array_equal(pinches, number <= 2)
    assert not pinches.all()


def test_an_attempt_counts_where_it_is_better_and_pinches_stay_unless_it_is_much_better(
    tmp_path: Path, scene: Scene, prepared: HandObject
) -> None:
    five = scene.select(np.array([0, 1, 2, 3, 0, 1]))
    search, every = search_of(five, prepared), np.arange(6)
    search.take(every, attempts(prepared, [1.0, 1.0, 1.0, 1.0, 1.0, np.inf], [0, 0, 1, 1, 1, 0], 1.0))
    better = [0.9, 1.0 - 0.1 * SAME_SCORE, 0.9, 0.9 * PINCH_SHARE, 0.05, np.inf]
    search.take(every, attempts(prepared, better, [False] * 6, 2.0), PINCH_SHARE)
    # A grasp without any score keeps its first attempt; a good attempt replaces a pinch in any case.
    np.testing.assert_array_equal(search.best.minimum.point.q[:, 0], [2.0, 1.0, 1.0, 2.0, 2.0, 1.0])
    np.testing.assert_allclose(search.best.score, [0.9, 1.0, 1.0, 0.9 * PINCH_SHARE, 0.05, np.inf])
    # Only the given rows change.
    search.take(np.array([4, 0]), attempts(prepared, [0.01, 0.5], [False, False], 3.0))
    np.testing.assert_array_equal(search.best.minimum.point.q[:, 0], [3.0, 1.0, 1.0, 2.0, 3.0, 1.0])
    np.testing.assert_allclose(search.best.score[[0, 4]], [0.5, 0.01])


# phases and starts


def test_phases_slide_settle_and_close() -> None:
    weights, near = Weights(), ContactSelection()
    assert PHASES == (SLIDE, SETTLE, CLOSE)
    few, solver = (
        LevenbergMarquardt(iterations=10),
        limited(LevenbergMarquardt(iterations=10), iterations=25, last_patience=8),
    )
    assert (solver.iterations, solver.last_patience, few.last_patience) == (10, 8, 12)
    for phase, soft, forces, farther in (
        (SLIDE, 0.01, 1.0, (0.01, 0.005)),
        (SETTLE, 1, 1, (0, 0)),
        (CLOSE, 1, 0, (0, 0)),
    ):
        found = phase.weights(weights)
        assert found.penetration == soft * weights.penetration and found.wrench == forces * weights.wrench
        assert found.self_penetration == soft * weights.self_penetration and found.contact == weights.contact
        touching = phase.touching(near)
        assert touching.reach - near.reach == pytest.approx(farther[0])
        assert touching.other_link_distance - near.other_link_distance == pytest.approx(farther[1])


def test_starts_turn_about_the_contacts_and_shift_the_hand(scene: Scene, prepared: HandObject) -> None:
    """Each number of a grasp is another start, in closed form; slides move by 0.1 m per radian."""
    search = search_of(scene, prepared)
    search.touching[:, :3] = [[True, True, False], [True, False, True], [True, True, True], [False, True, True]]
    member, number = np.array([2, 0, 2, 3]), np.array([1, 2, 2, 1])
    found = search.perturb(member, number)
    noise = sample_noise(scene, scene.T_world_root[member], member, number, CONFIG.seed)
    assert np.abs(noise[0] - noise[2]).max() > 0.1
    for row, m in enumerate(member):
        T = scene.T_world_root[m]
        origins = prepared.chain(T[None], scene.q[[m]]).T_world_link[0, :, :3, 3]
        middle = origins[search.touching[m]].mean(axis=0)
        R = exp_so3(START_ROTATION_RAD * noise[row, 3:6])
        np.testing.assert_allclose(found.T[row, :3, :3], R @ T[:3, :3], atol=1e-12)
        moved = middle + R @ (T[:3, 3] - middle) + START_TRANSLATION_M * noise[row, :3]
        np.testing.assert_allclose(found.T[row, :3, 3], moved, atol=1e-12)
        step = START_JOINTS_RAD * np.where(scene.hand.slides, 0.1, 1.0) * noise[row, 6:]
        np.testing.assert_allclose(found.q[row], scene.q[m] + step, atol=1e-12)


def test_every_start_of_a_grasp_is_another_one(scene: Scene, prepared: HandObject, insatiable: None) -> None:
    """Of five starts, four are perturbed, by the samples 1 to 4 of the grasp."""
    stages = [""]
    firsts: list[np.ndarray] = []

    def first(state: IterationState) -> None:
        """Keep the points at which phases of sliding contacts begin."""
        if state.stage == SLIDE.name and stages[-1] != SLIDE.name:
            firsts.extend(state.point.T)
        stages.append(state.stage)

    one = scene.select(np.array([1]))
    config = replace(CONFIG, starts=5, solver=LevenbergMarquardt(iterations=1))
    found = refine(one, config, on_iteration=first, prepared=prepared)
    assert found.starts.tolist() == [5] and len(firsts) == 5
    assert found.iterations.tolist() == [1 + 5 * 3], "one for each phase of each start, after the gaps"
    noise = sample_noise(one, one.T_world_root[[0] * 4], np.zeros(4, dtype=int), np.arange(1, 5), config.seed)
    R = exp_so3(START_ROTATION_RAD * noise[:, 3:6])
    np.testing.assert_allclose(np.array(firsts)[1:, :3, :3], R @ one.T_world_root[0, :3, :3], atol=1e-9)
    # They turn about the links that touch in the input grasp.
    touching = goal_of(one, config.contact_selection, prepared).touching[0]
    middle = prepared.chain(one.T_world_root, one.q).T_world_link[0, touching, :3, 3].mean(axis=0)
    place = middle + R @ (one.T_world_root[0, :3, 3] - middle) + START_TRANSLATION_M * noise[:, :3]
    np.testing.assert_allclose(np.array(firsts)[1:, :3, 3], place, atol=1e-9)


def test_good_grasps_are_not_tried_again(
    scene: Scene, held: Refinement, by_geometry: Refinement, prepared: HandObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = score(prepared, held)
    assert (held.starts >= 1).all() and (held.starts <= CONFIG.starts).all()
    assert (held.starts[found > force_closure_search.GOOD_SCORE] == CONFIG.starts).all()
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", np.inf)
    once = refine(scene, CONFIG, prepared=prepared)
    np.testing.assert_array_equal(once.starts, 1)
    np.testing.assert_allclose(once.q, by_geometry.q, atol=0.05)


def test_more_starts_are_never_worse(scene: Scene, prepared: HandObject, insatiable: None) -> None:
    two, found = scene.select(np.array([0, 2])), []
    for count in (1, 3):
        found.append(refine(two, replace(CONFIG, starts=count), prepared=prepared))
        np.testing.assert_array_equal(found[-1].starts, count)
    once, often = (score(prepared, one) for one in found)
    assert (often <= once + SAME_SCORE).all() and (often < once - 1e-3).any()


def test_a_grasp_alone_is_the_same_grasp(
    scene: Scene, held: Refinement, prepared: HandObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone, several starts are tried at once; together, one after the other. The first good one counts."""
    monkeypatch.setattr(force_closure_search, "STARTS_AT_ONCE", 4)
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", float(np.median(score(prepared, held))))
    together = refine(scene, CONFIG, prepared=prepared)
    tried = int(np.argmax(together.starts))
    assert together.starts[tried] > 1 and together.starts.min() < together.starts.max()
    for order in ([tried], [3, 0]):
        same(refine(scene.select(np.array(order)), CONFIG, prepared=prepared), together, list(range(len(order))), order)


# budgets and ends


def test_a_budget_of_time_ends_the_search(scene: Scene, held: Refinement, prepared: HandObject) -> None:
    """At most one stage of few iterations is begun when there is hardly any time."""
    short = refine(scene, replace(CONFIG, seconds=1e-6), prepared=prepared)
    assert short.iterations.max() <= 6 < held.iterations.max()
    np.testing.assert_array_equal(short.starts, 1)
    assert np.isfinite(short.q).all() and np.isfinite(short.loss).all()


def test_grasps_that_are_nowhere_near_or_nowhere_at_all_spoil_no_other(
    scene: Scene, held: Refinement, prepared: HandObject
) -> None:
    T, q = scene.T_world_root.copy(), scene.q.copy()
    T[1, 0, 3] += 1.0
    q[2, 4] = np.nan
    states: list[IterationState] = []
    found = refine(replace(scene, T_world_root=T, q=q), CONFIG, on_iteration=states.append, prepared=prepared)
    assert {*np.concatenate([state.row for state in states]).tolist()} == {0, 3}
    assert found.status[1] == Status.NO_TARGET and found.status[2] == Status.NOT_FINITE
    np.testing.assert_array_equal(found.T_world_root[1], T[1])
    np.testing.assert_array_equal(found.q[1], q[1])
    assert np.isnan(found.loss[1:3]).all() and found.starts[2] == 0 and not found.touching[1:3].any()
    same(found, held, [0, 3], [0, 3])
    none = refine(scene.select(np.arange(0)), CONFIG, prepared=prepared)
    assert none.T_world_root.shape == (0, 4, 4) and none.starts.shape == (0,)


def test_target_normals_are_sought_too(scene: Scene, prepared: HandObject) -> None:
    """A tip that should press downwards does so more than without being asked, and still touches."""
    config = replace(CONFIG, starts=1, weights=Weights(direction=1e-2))
    plain = refine(scene, replace(CONFIG, starts=1), prepared=prepared)
    column = int(plain.touching.sum(axis=0).argmax())
    wanted = np.full((4, len(scene.links), 3), np.nan)
    wanted[:, column] = [0.0, 0.0, -1.0]
    found = refine(replace(scene, direction=wanted), config, prepared=prepared)
    assert found.touching[:, column].all()
    # Those of the grasps that are tried.
    mixed, order = wanted.copy(), np.array([3, 1])
    mixed[3, column] = [1.0, 0.0, 0.0]
    search = search_of(replace(scene, direction=mixed), prepared, STILL)
    tried = search.attempt(order, take(search.inputs, order), (CLOSE,))
    np.testing.assert_array_equal(tried.goal.direction, mixed[order])
    along = []
    for one in (plain, found):
        T = prepared.chain(one.T_world_root, one.q).T_world_link
        along.append(-query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape)).normal[:, column, 2])
    assert (along[1] >= along[0] - 1e-6).all() and (along[1] > along[0] + 0.05).any()
