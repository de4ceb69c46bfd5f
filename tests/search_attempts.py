"""Made-up attempts of the search for force closure."""

from dataclasses import replace

import numpy as np

from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.force_closure_search import Attempt
from grasp_refine.refinement.solvers.iterate import Minimum, Point
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject


def attempts(
    prepared: HandObject, scores: list[float], pinches: list[bool], mark: float, displacement: float = 0.0
) -> Attempt:
    """Attempts at as many grasps, whose joint values are a mark; those below `GOOD_SCORE` are good enough."""
    count, n, L = len(scores), len(prepared.hand.joint_names), len(prepared.chain.links)
    none = np.zeros(count)
    point = Point(np.tile(np.eye(4), (count, 1, 1)), np.full((count, n), mark))
    status = np.full(count, Status.STALLED)
    minimum = Minimum(point, np.zeros((count, 2)), status, none.astype(int), none.astype(int), none, none)
    goal = replace(Goal.nothing(count, L), direction=None)
    enough = np.array(scores) <= force_closure_search.GOOD_SCORE
    return Attempt(minimum, goal, np.array(scores), np.array(pinches), none, enough, np.full(count, displacement))
