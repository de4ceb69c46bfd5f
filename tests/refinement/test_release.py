"""Links that cannot touch together with the others are released, so that these touch."""

from pathlib import Path

import numpy as np

from claw import TIPS, around, capsule, claw
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.gap_closing import RELEASE_GAP_M, close_gaps, release_links
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
    after, goal = release_links(problem, found, CONFIG.solver, seconds=np.full(COUNT, np.inf))
    released = problem.goal.touching & ~goal.touching
    np.testing.assert_array_equal(released.sum(axis=1), stuck)
    np.testing.assert_array_equal(released[stuck].argmax(axis=1), before[stuck].argmax(axis=1))
    now = gaps(problem.with_goal(goal), after)
    assert (now[stuck].max(axis=1) < before[stuck].max(axis=1)).all() and np.median(now[stuck].max(axis=1)) < 1e-4
    np.testing.assert_array_equal(after.point.q[~stuck], found.point.q[~stuck])
    assert (after.iterations >= found.iterations).all() and (after.iterations > found.iterations)[stuck].all()
