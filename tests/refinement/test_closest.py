"""The closest grasp that is good enough: small changes first, and no farther than needed."""

from dataclasses import replace

import numpy as np
import pytest

from claw import around, capsule, claw
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import log_so3
from grasp_refine.hands.displacement import Displacement
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import FULL_START, MOVED_SHARE, Search, search
from grasp_refine.refinement.phases import CLOSE, KEEP
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from search_attempts import attempts

CONFIG = Config(starts=4, solver=LevenbergMarquardt(iterations=15))
RUNNING = np.full(6, Status.RUNNING)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Six hands of round fingertips about a capsule."""
    return around(claw(tmp_path_factory.mktemp("claw")), capsule(), 6, 1)


@pytest.fixture(scope="module")
def prepared(scene: Scene) -> HandObject:
    return HandObject.of(scene)


def search_of(scene: Scene, prepared: HandObject, config: Config) -> Search:
    return Search(scene, prepared, config, RUNNING.copy(), None, None)


def test_an_input_that_is_good_enough_has_its_contacts_closed_and_nothing_else(
    scene: Scene, prepared: HandObject
) -> None:
    """The bar is the quality of the closed grasps themselves: half of them reach it."""
    every = np.arange(6)
    some = search_of(scene, prepared, CONFIG)
    closed = some.attempt(every, some.inputs, (KEEP,))
    selection = replace(CONFIG.contact_selection, reach=0.005, other_link_distance=0.002)
    near, all_near = (goal_of(scene, each, prepared).touching for each in (selection, CONFIG.contact_selection))
    assert not (closed.goal.touching & ~near).any() and near.sum() < all_near.sum()
    good = np.minimum(closed.quality, some.judge(every, some.inputs)[2])
    bar = float(np.median(good))
    found = search(scene, prepared, replace(CONFIG, confidence=bar), RUNNING.copy())
    kept = good >= bar
    assert 0 < kept.sum() < 6
    np.testing.assert_allclose(found.minimum.point.q[kept], closed.minimum.point.q[kept], atol=1e-9)
    np.testing.assert_allclose(found.minimum.point.T[kept], closed.minimum.point.T[kept], atol=1e-9)
    moved = Displacement.of(scene.hand).between(
        closed.minimum.point.T, closed.minimum.point.q, found.minimum.point.T, found.minimum.point.q
    )
    assert (moved[~kept] > 1e-4).all()


def test_of_attempts_that_are_good_enough_the_nearest_counts(scene: Scene, prepared: HandObject) -> None:
    some, every = search_of(scene, prepared, CONFIG), np.arange(6)
    some.take(every, attempts(prepared, [1.0, 1.0, 0.05, 0.05, 0.05, 1.0], [False] * 6, 1.0, 0.02))
    # Worse but good enough and nearer; better but not good enough; and farther.
    some.take(every, attempts(prepared, [0.09, 0.9, 0.09, 0.5, 0.01, 1.5], [False] * 6, 2.0, 0.01))
    np.testing.assert_array_equal(some.best.minimum.point.q[:, 0], [2.0, 2.0, 2.0, 1.0, 2.0, 1.0])
    some.take(every, attempts(prepared, [0.01] * 6, [False] * 6, 3.0, 0.015))
    np.testing.assert_array_equal(some.best.minimum.point.q[:, 0], [2.0, 3.0, 2.0, 3.0, 2.0, 3.0])


def test_grasps_that_are_moved_keep_a_reserve(scene: Scene, prepared: HandObject) -> None:
    """After more than closing, a fifth of the allowed probability of failing is good enough."""
    some, every = search_of(scene, prepared, CONFIG), np.arange(6)
    moved = some.attempt(every, some.inputs, (replace(CLOSE, iterations=0), CLOSE))
    between = float(np.median(moved.quality[moved.quality < 1.0]))
    for confidence in (between, 1e-9):
        again = search_of(scene, prepared, replace(CONFIG, confidence=confidence))
        found = again.attempt(every, again.inputs, (replace(CLOSE, iterations=0), CLOSE))
        np.testing.assert_array_equal(found.enough, moved.quality >= 1.0 - MOVED_SHARE * (1.0 - confidence))


def test_results_are_nearer_than_the_strongest(scene: Scene, prepared: HandObject) -> None:
    moved = {}
    for prefer in ("closest", "strongest"):
        found = search(scene, prepared, replace(CONFIG, prefer=prefer, confidence=0.5), RUNNING.copy()).minimum.point
        moved[prefer] = Displacement.of(scene.hand).between(scene.T_world_root, scene.q, found.T, found.q)
    assert moved["closest"].mean() < 0.8 * moved["strongest"].mean()


def test_starts_go_from_small_changes_to_large_ones(scene: Scene, prepared: HandObject) -> None:
    """Far from the joint limits the k-th start has its own noise times k / FULL_START."""
    one, member = search_of(scene, prepared, CONFIG), np.zeros(4, dtype=int)
    number = np.array([1, 2, 3, 5])
    small = one.perturb(member, number)
    large = search_of(scene, prepared, replace(CONFIG, prefer="strongest")).perturb(member, number)
    share = np.minimum(number / FULL_START, 1.0)
    first = scene.T_world_root[0]
    turned, whole = (log_so3(found.T[:, :3, :3] @ first[:3, :3].T) for found in (small, large))
    np.testing.assert_allclose(turned, share[:, None] * whole, atol=1e-9)
    np.testing.assert_allclose(small.q - one.q[0], share[:, None] * (large.q - one.q[0]), atol=1e-12)
    assert np.linalg.norm(whole, axis=1).min() > 0.05


@pytest.mark.parametrize("value", [0.0, 1.0, -0.5])
def test_a_confidence_is_a_probability_below_1(value: float) -> None:
    with pytest.raises(GraspRefineError, match="confidence must be above 0 and below 1"):
        Config(confidence=value)
