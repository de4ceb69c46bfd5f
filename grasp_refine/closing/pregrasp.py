"""Pregrasps: open hands before they close to a grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import Point, Progress, minimise
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

SOLVER = LevenbergMarquardt(iterations=60)
"""Solver of pregrasps; a hand opens in few iterations, or cannot open further."""

TOLERANCE = 1e-6
"""Loss (m^2) at which a hand is open: at most 0.1 mm of clearance missing at one link, at the penetration weight."""


def open_hand(
    scene: Scene, prepared: HandObject | None = None, progress: Progress | None = None
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Return poses (N, 4, 4) of the base link and joint values (N, n) near the grasps at which the hands are open.

    Every link is at least `CLEARANCE`, or `CLEARANCE_OTHERS`, away from the object and above the table, if there is
    one, and does not penetrate other links; joints are within their limits. Root and joints move as little as possible.
    Where there is no such pose, as for a finger behind a rim, the best iterate is returned; for invalid poses
    (`Scene.posed`), NaN.

    Args:
        scene: Hand, object and grasps; targets are ignored.
        prepared: Geometry of this hand and object; None: built here.
        progress: As for `minimise`; an exception that it raises ends the search.
    """
    prepared = prepared or HandObject.of(scene)
    goal = Goal.nothing(len(scene.q), len(scene.links))
    scene = replace(
        scene, target_link=None, target_object=None, direction=None, task=replace(scene.task, touch=(), avoid=())
    )
    problem = GraspProblem(scene, goal, Config(solver=SOLVER), prepared.padded)
    start = Point(scene.T_world_root, np.clip(scene.q, scene.hand.lower, scene.hand.upper))
    posed = scene.posed
    status = np.where(posed, Status.RUNNING, Status.INVALID)
    found = minimise(problem, start, SOLVER, TOLERANCE, status=status, progress=progress).point
    T, q = np.where(posed[:, None, None], found.T, np.nan), np.where(posed[:, None], found.q, np.nan)
    return T, q
