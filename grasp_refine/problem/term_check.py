"""Check of the derivatives of a term of the loss on grasps of a user."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.problem.facade import problem_of
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.derivative_check import finite_differences, gradients, relative_errors
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.terms.term import Term
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject

SMALLEST_GRADIENT = 1e-6
"""Gradients below this part of the largest one count as zero."""

LEFT_OUT = 0.1
"""Share of the grasps, with the largest errors, that may be off: an edge or a face changes within a step."""


def check_term(
    term: Term, hand: Hand, object: Object, grasps: GraspSet, *, tolerance: float = 0.02
) -> dict[str, Float[np.ndarray, " N"]]:
    """Compare the derivatives of a term with central differences, as least squares and gradient solvers take them.

        gr.check_term(MyTerm(), hand, mug, gr.sample_grasps(hand, mug, 8))

    Args:
        term: The term; its `residuals` must belong to the loss, and its `rows` their derivatives.
        hand: The hand.
        object: The object.
        grasps: N grasps on it at which the term is not zero.
        tolerance: Largest relative error of a gradient in nine of ten grasps. Derivatives of the distance are exact;
            sliding of witness points is by contact kinematics, which edges make less exact.

    Returns:
        Relative errors (N,): "least squares" of the rows, "autograd" of the gradients of torch; one of them is missing
        where the term says that it is not for these solvers, or the hand is on an arm.

    Raises:
        GraspRefineError: an error beyond the tolerance, with the unknown that is off most; a term that has no part in
            these grasps, or does not change with them; or residuals or rows of another shape.
    """
    check_kind("term", term, Term)
    scene = problem_of(hand, object, grasps).groups[0].scene
    prepared, name = HandObject.of(scene), type(term).__name__
    config = Config(weights=Weights(**{field.name: 0.0 for field in fields(Weights)}))
    goal = goal_of(scene, config.contact_selection, prepared)
    point, found = Point(scene.T_world_root, scene.q), {}
    if term.least_squares:
        problem = GraspProblem(scene, goal, replace(config, terms=(term,)), prepared)
        if not problem.terms:
            raise GraspRefineError(f"{name} has no part in these grasps: its weight is 0, or its applies(...) is False")
        found["least squares"] = _errors(name, "rows", problem, point, hand, tolerance)
    if term.autograd and hand.arm is None:
        from grasp_refine.refinement.objective import Objective
        from grasp_refine.refinement.solvers.adam import Adam

        objective = Objective(scene, goal, replace(config, terms=(term,), solver=Adam()), prepared)
        found["autograd"] = _errors(name, "gradients of autograd", objective, point, hand, tolerance)
    return found


def _errors(name: str, what: str, problem: object, point: Point, hand: Hand, tolerance: float) -> np.ndarray:
    """Return the relative errors (N,) of one way.

    Raises:
        GraspRefineError: too many are beyond the tolerance, or nothing changes.
    """
    expected, own = finite_differences(problem, point), gradients(problem, point)
    largest = np.linalg.norm(expected, axis=1).max(initial=0.0)
    if not largest > 0.0:
        raise GraspRefineError(f"{name}: its loss does not change near these grasps: give grasps at which it is not 0")
    errors = relative_errors(own, expected, SMALLEST_GRADIENT * largest)
    counted = np.sort(errors)[: max(int(np.ceil((1.0 - LEFT_OUT) * len(errors))), 1)]
    if not counted[-1] <= tolerance:
        row = int(np.argsort(errors)[len(counted) - 1])
        column = int(np.abs(own - expected)[row].argmax())
        unknowns = [f"{way} {axis}" for way in ("translation", "rotation") for axis in "xyz"] + [*hand.joint_names]
        raise GraspRefineError(
            f"{name}: its {what} differ from finite differences by {100 * counted[-1]:.3g} % in grasp {row}, most in "
            f"{unknowns[column]}: {own[row, column]:.6g} instead of {expected[row, column]:.6g}"
        )
    return errors
