"""Grasps that hold: the best of several starts, each grasp on its own, never worse than with its contacts closed."""

from dataclasses import replace

import numpy as np
import pytest

from boxed_example import boxed_example
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import transform_points
from grasp_refine.forces.quality import DEEP, Quality, quality
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import CLOSE, GOOD_SCORE, SHORTFALL_WEIGHT, judge
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task

CONFIG, TWO_STARTS = Config(starts=3), Config(starts=2)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The four example grasps of the embedded hand on the embedded box."""
    return boxed_example()


@pytest.fixture(scope="module")
def prepared(scene: Scene) -> HandObject:
    return HandObject.of(scene)


@pytest.fixture(scope="module")
def hard(scene: Scene) -> Scene:
    """The same, moved by 1 cm to the side: more of them need other starts."""
    T = scene.T_world_root.copy()
    T[:, :3, 3] += 0.012 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 1]])
    return replace(scene, T_world_root=T)


@pytest.fixture(scope="module")
def held(hard: Scene, prepared: HandObject) -> Refinement:
    return refine(hard, CONFIG, prepared=prepared)


@pytest.fixture(scope="module")
def by_geometry(hard: Scene, prepared: HandObject) -> Refinement:
    """The same with their contacts closed, whatever the forces."""
    return refine(hard, replace(CONFIG, weights=replace(CONFIG.weights, wrench=0.0)), prepared=prepared)


@pytest.fixture(scope="module")
def told(hard: Scene, prepared: HandObject) -> tuple[Refinement, list[tuple[int, int, float]]]:
    """The same from two starts, and what was told meanwhile."""
    said: list[tuple[int, int, float]] = []
    return refine(hard, TWO_STARTS, lambda *now: said.append(now), prepared=prepared), said


def judged(scene: Scene, prepared: HandObject, T: np.ndarray, q: np.ndarray) -> Quality:
    frames = prepared.chain(T, q)
    poses = frames.T_world_link
    cutoff = CONTACTS.cutoff(scene.hand, scene.links)
    witness = query(prepared.pairs, poses, np.broadcast_to(np.eye(4), poses.shape), cutoff=cutoff)
    return quality(scene.hand, scene.object, prepared.chain, frames, witness)


def score(prepared: HandObject, found: Refinement) -> np.ndarray:
    return judge(prepared, prepared.chain(found.T_world_root, found.q))[0]


def rows(scene: Scene, index: list[int]) -> Scene:
    direction = None if scene.direction is None else scene.direction[index]
    return replace(scene, T_world_root=scene.T_world_root[index], q=scene.q[index], direction=direction)


def same(one: Refinement, other: Refinement, index: list[int], own: list[int], tolerance: float = 1e-6) -> None:
    """What came out for the grasps `index` of one is that of `own` of the other; costs may be shared otherwise."""
    for name in ("status", "starts", "touching"):
        np.testing.assert_array_equal(getattr(one, name)[index], getattr(other, name)[own], err_msg=name)
    np.testing.assert_allclose(one.T_world_root[index], other.T_world_root[own], atol=tolerance)
    np.testing.assert_allclose(one.q[index], other.q[own], atol=tolerance)
    np.testing.assert_allclose(one.loss[index], other.loss[own], rtol=1e-3, atol=1e-10)


# what comes out


def test_quality_is_not_worse_than_before(scene: Scene, hard: Scene, held: Refinement, prepared: HandObject) -> None:
    for given, found in ((scene, refine(scene, CONFIG, prepared=prepared)), (hard, held)):
        before = judged(given, prepared, given.T_world_root, given.q).value
        after = judged(given, prepared, found.T_world_root, found.q).value
        assert (after >= before - 1e-9).all() and (after > before + 0.02).any()


def test_forces_that_balance_are_never_worse_than_closed_contacts(
    hard: Scene, held: Refinement, by_geometry: Refinement, prepared: HandObject
) -> None:
    """The attempt by geometry alone is one of those of which the best counts."""
    closed, balanced = (score(prepared, found) for found in (by_geometry, held))
    assert (balanced <= closed + 1e-6).all() and (balanced < closed - 0.01).any()


def test_what_holds_touches_and_penetrates_nothing(hard: Scene, held: Refinement, prepared: HandObject) -> None:
    T = prepared.chain(held.T_world_root, held.q).T_world_link
    witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
    done = held.status == Status.CONVERGED
    assert done.any()
    assert (witness.distance[done] > -2e-5).all()
    assert np.abs(np.where(held.touching, witness.distance, 0.0)[done]).max() < 2e-5
    assert (held.q >= hard.hand.lower).all() and (held.q <= hard.hand.upper).all()


def test_the_loss_is_that_of_all_terms(hard: Scene, held: Refinement) -> None:
    """Before and after, for the links that touch at last."""
    assert held.loss.shape == (4, 2) and (held.loss > 0.0).all()
    # What contacts and depths leave is far less than forces that do not balance.
    assert (held.loss[:, 1] <= held.loss[:, 0]).sum() >= 3


def test_links_below_the_table_count_like_links_in_the_object(scene: Scene, prepared: HandObject) -> None:
    """The same grasp, not moved at all, with its lowest link on the table, and 4 mm below it."""
    one, first = rows(scene, [0]), np.array([0])
    T = prepared.chain(one.T_world_root, one.q).T_world_link
    lowest = float(transform_points(T, Plane().lowest(prepared.bodies, T))[..., 2].min())
    score = []
    for depth in (0.0, 0.004):
        search = force_closure_search._Search(
            replace(one, task=Task(table=lowest + depth)), prepared,
            replace(CONFIG, solver=LevenbergMarquardt(iterations=0)), np.full(1, Status.RUNNING), None, None,
        )  # fmt: skip
        score.append(float(search.attempt(first, search.initial(first), (CLOSE,)).score[0]))
    assert score[1] - score[0] == pytest.approx(0.004 / DEEP, rel=1e-6)


# starts


def test_good_grasps_are_not_tried_again(hard: Scene, held: Refinement, prepared: HandObject) -> None:
    found = score(prepared, held)
    assert (held.starts >= 1).all() and (held.starts <= CONFIG.starts + 1).all()
    assert (held.starts[found > GOOD_SCORE] >= CONFIG.starts).all()


def test_more_starts_are_never_worse(hard: Scene, prepared: HandObject, monkeypatch: pytest.MonkeyPatch) -> None:
    """None is good enough here, so that all are tried; the first starts are the same ones."""
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)
    scores, starts = [], []
    two = rows(hard, [0, 2])
    for count in (1, 2):
        found = refine(two, replace(CONFIG, starts=count), prepared=prepared)
        scores.append(score(prepared, found))
        starts.append(found.starts)
    assert (scores[1] <= scores[0] + 1e-6).all()
    np.testing.assert_array_equal(starts[1] - starts[0], 1)


def test_a_grasp_that_is_good_at_once_takes_one_start(
    hard: Scene, by_geometry: Refinement, prepared: HandObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", np.inf)
    found = refine(hard, CONFIG, prepared=prepared)
    np.testing.assert_array_equal(found.starts, 1)
    np.testing.assert_allclose(found.q, by_geometry.q, atol=0.05)


def test_a_grasp_alone_is_the_same_grasp(
    hard: Scene, held: Refinement, prepared: HandObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone, several of its starts are tried at once; together, one after the other. Half of them are good enough."""
    found = score(prepared, held)
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", float(np.median(found)))
    together = refine(hard, CONFIG, prepared=prepared)
    tried = int(np.argmax(together.starts))
    assert together.starts[tried] > 1 and together.starts.min() < together.starts.max()
    same(refine(rows(hard, [tried]), CONFIG, prepared=prepared), together, [0], [tried])
    order = [3, 0]
    same(refine(rows(hard, order), CONFIG, prepared=prepared), together, [0, 1], order)


def test_same_seed_same_result_and_another_seed_another(
    hard: Scene, prepared: HandObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)
    config = Config(starts=2, solver=LevenbergMarquardt(iterations=5))
    two = rows(hard, [0, 2])
    one, again, other = (refine(two, replace(config, seed=seed), prepared=prepared) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.T_world_root, again.T_world_root)
    np.testing.assert_array_equal(one.q, again.q)
    search = [
        force_closure_search._Search(two, prepared, replace(config, seed=s), one.status, None, None) for s in (3, 4)
    ]
    first, second = (s.perturb(np.array([0, 1]), np.array([1, 1])) for s in search)
    assert (np.abs(first.q - second.q).max(axis=1) > 1e-3).all()
    assert np.isfinite(other.q).all()


# budgets and ends


def test_grasps_where_set_points_end_are_worse(held: Refinement, prepared: HandObject) -> None:
    """Of hands whose set points are the joint values, which cannot press at all, the score is higher."""
    hand = prepared.hand
    ends = np.repeat(held.q[:1, :, None], 2, axis=2)[0]
    stuck = replace(prepared, hand=replace(hand, actuator=replace(hand.actuator, set_points=ends)))
    assert score(stuck, held)[0] > score(prepared, held)[0] + SHORTFALL_WEIGHT / 2


def test_a_budget_of_time_ends_the_search(hard: Scene, held: Refinement, prepared: HandObject) -> None:
    """At most one stage of few iterations is begun when there is hardly any time."""
    short = refine(hard, replace(CONFIG, seconds=1e-6), prepared=prepared)
    assert short.iterations.max() <= 6 < held.iterations.max()
    np.testing.assert_array_equal(short.starts, 1)
    assert np.isfinite(short.q).all() and np.isfinite(short.loss).all()


def test_progress_is_reported_and_counts_up(told: tuple[Refinement, list[tuple[int, int, float]]]) -> None:
    found, said = told
    done, ticks, loss = (np.array(column) for column in zip(*said, strict=True))
    np.testing.assert_array_equal(ticks, np.arange(1, len(ticks) + 1))
    assert (np.diff(done) >= 0).all() and done[-1] <= 4 and np.isfinite(loss).all()
    assert (found.cpu_s > 0).all() and (found.wall_s > 0).all() and (found.queries >= found.iterations).all()


def test_grasps_that_are_nowhere_near_or_nowhere_at_all_spoil_no_other(
    hard: Scene, told: tuple[Refinement, list[tuple[int, int, float]]], prepared: HandObject
) -> None:
    clean, _ = told
    T, q = hard.T_world_root.copy(), hard.q.copy()
    T[1, 0, 3] += 1.0
    q[2, 4] = np.nan
    found = refine(replace(hard, T_world_root=T, q=q), TWO_STARTS, prepared=prepared)
    assert found.status[1] == Status.NO_TARGET and found.status[2] == Status.NOT_FINITE
    np.testing.assert_array_equal(found.T_world_root[1], T[1])
    np.testing.assert_array_equal(found.q[1], q[1])
    assert np.isnan(found.loss[1:3]).all() and found.starts[2] == 0 and not found.touching[1:3].any()
    same(found, clean, [0, 3], [0, 3])


def test_no_grasps_at_all_hold_at_once(hard: Scene, prepared: HandObject) -> None:
    found = refine(rows(hard, []), CONFIG, prepared=prepared)
    assert found.T_world_root.shape == (0, 4, 4) and found.starts.shape == (0,)


def test_directions_are_sought_too(scene: Scene, prepared: HandObject) -> None:
    """A tip that should press downwards does so more than without being asked, and still touches."""
    config = replace(CONFIG, starts=1, weights=Weights(direction=1e-2))
    plain = refine(rows(scene, [0, 1]), replace(CONFIG, starts=1), prepared=prepared)
    column = int(np.flatnonzero(plain.touching.all(axis=0))[0])
    wanted = np.full((2, len(scene.links), 3), np.nan)
    wanted[:, column] = [0.0, 0.0, -1.0]
    asked = replace(rows(scene, [0, 1]), direction=wanted)
    found = refine(asked, config, prepared=prepared)
    assert found.touching[:, column].all()
    along = []
    for one in (plain, found):
        T = prepared.chain(one.T_world_root, one.q).T_world_link
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
        along.append(-witness.normal[:, column, 2])
    assert (along[1] >= along[0] - 1e-6).all() and (along[1] > along[0] + 0.05).any()
