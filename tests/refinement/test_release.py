"""Links that cannot touch together with the others, and targets out of reach, are released."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from claw import TIPS, around, capsule, claw
from grasp_refine.core.se3 import matvec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.gap_closing import RELEASE_GAP_M, close_gaps, release_links, release_targets
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.solvers.iterate import Minimum, Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject

COUNT = 8
CONFIG = Config(
    solver=LevenbergMarquardt(iterations=60),
    weights=Weights(wrench=0.0),
    max_move=MaxMove(0.0, 0.0),
    contact_selection=ContactSelection(links=TIPS),
)
"""All tips should touch, and the palm stands still: some cannot."""


def gaps(problem: GraspProblem, found: Minimum) -> np.ndarray:
    """Distances (N, L) of links that should touch, metres."""
    witness = problem.evaluate(np.arange(COUNT), found.point, None).witness
    return np.where(problem.goal.touching, np.abs(witness.distance), 0.0)


def test_the_link_farthest_from_touching_is_released(tmp_path: Path) -> None:
    scene = around(claw(tmp_path), capsule(), COUNT, 3)
    prepared = HandObject.of(scene)
    problem = GraspProblem(scene, goal_of(scene, CONFIG.contact_selection, prepared), CONFIG, prepared)
    limits = {"status": np.full(COUNT, Status.RUNNING), "seconds": np.inf}
    found = close_gaps(problem, Point(scene.T_world_root, scene.q), CONFIG.solver, CONFIG.tolerance, **limits)
    before = gaps(problem, found)
    stuck = (found.status != Status.CONVERGED) & (before.max(axis=1) > RELEASE_GAP_M)
    assert 0 < stuck.sum() < COUNT
    after, changed = release_links(problem, found, CONFIG.solver, seconds=np.full(COUNT, np.inf))
    released = problem.goal.touching & ~changed.goal.touching
    np.testing.assert_array_equal(released.sum(axis=1), stuck)
    np.testing.assert_array_equal(released[stuck].argmax(axis=1), before[stuck].argmax(axis=1))
    now = gaps(changed, after)
    assert (now[stuck].max(axis=1) < before[stuck].max(axis=1)).all() and np.median(now[stuck].max(axis=1)) < 1e-4
    np.testing.assert_array_equal(after.point.q[~stuck], found.point.q[~stuck])
    assert (after.iterations >= found.iterations).all() and (after.iterations > found.iterations)[stuck].all()


def test_targets_that_are_missed_are_released_and_their_links_touch_beside_them(tmp_path: Path) -> None:
    """The side's target is beyond reach, in the middle of the object; a target at the index's own contact stays."""
    scene = around(claw(tmp_path), capsule(), COUNT, 3)
    prepared = HandObject.of(scene)
    goal = goal_of(scene, CONFIG.contact_selection, prepared)
    problem = GraspProblem(scene, goal, CONFIG, prepared)
    limits = {"status": np.full(COUNT, Status.RUNNING), "seconds": np.inf}
    touching = close_gaps(problem, Point(scene.T_world_root, scene.q), CONFIG.solver, CONFIG.tolerance, **limits)
    state = problem.evaluate(np.arange(COUNT), touching.point, None)
    index, side = (scene.links.index(name) for name in ("index", "side"))
    on_link, on_object = np.full((2, COUNT, len(scene.links), 3), np.nan)
    for link, away in ((index, 0.0), (side, 0.05)):
        T = state.T_link[:, link]
        on_link[:, link] = matvec(T[:, :3, :3].mT, state.witness.point_a[:, link] - T[:, :3, 3])
        on_object[:, link] = state.witness.point_b[:, link] + [0.0, 0.0, away]
    problem = problem.with_goal(replace(goal, target_link=on_link, target_object=on_object))
    found = close_gaps(problem, touching.point, CONFIG.solver, CONFIG.tolerance, **limits)
    after, changed = release_targets(problem, found, CONFIG.solver, seconds=np.full(COUNT, np.inf))
    assert not changed.goal.aimed[:, side].any()
    np.testing.assert_array_equal(changed.goal.touching, goal.touching)
    distance = np.abs(changed.evaluate(np.arange(COUNT), after.point, None).witness.distance)
    before = np.abs(problem.evaluate(np.arange(COUNT), found.point, None).witness.distance)
    assert changed.goal.aimed[:, index].any()
    assert np.median(distance[:, side]) < 1e-4 < np.median(before[:, side])
