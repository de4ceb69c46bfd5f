"""Terms and solvers of users: minimised like ours, checked by finite differences, and refused by name."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.problem.facade import problem_of, refine
from grasp_refine.problem.term_check import check_term
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.rows import JointRows
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.term import Term
from grasp_refine.refinement.terms.torch_term import TorchTerm
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.sampling.sample import sample_grasps
from refusals import refused

QUICK = Config(starts=1, weights=Weights(wrench=0.0))
HEIGHT = 0.16
"""Wanted height of the palm above the object's origin, metres."""


@pytest.fixture(scope="module")
def grasps() -> tuple[Hand, Object, GraspSet]:
    """Four sampled grasps of the Allegro-type hand on a box, and what they are of."""
    hand, box = load_hand("allegro", candidates=64), load_object("box:0.06,0.05,0.09", candidates=64)
    return hand, box, sample_grasps(hand, box, 4, seed=1)


@dataclass(frozen=True)
class Height(Term):
    """The palm is at a height; with its rows."""

    height: float = HEIGHT
    weight: float = 50.0
    sign: float = 1.0

    def residuals(self, state: Any) -> tuple[Any, ...]:
        return (state.T[:, 2, 3] - self.height,)

    def rows(self, state: Any, width: np.ndarray) -> Any:
        (away,) = self.residuals(state)
        jacobian = np.zeros((len(away), 1, 6 + state.q.shape[1]))
        jacobian[:, 0, 2] = self.sign
        yield JointRows(away[:, None], jacobian)


@dataclass(frozen=True)
class Plain(Height):
    """The same without rows of its own."""

    def rows(self, state: Any, width: np.ndarray) -> Any:
        return Term.rows(self, state, width)


def height(state: Any, scene: Any) -> torch.Tensor:
    return state.T[:, 2, 3] - HEIGHT


def everything(state: Any, scene: Any) -> torch.Tensor:
    """Residuals of the base, the joints, the links, distances, and witness points of all links."""
    near = torch.as_tensor(state.witness.valid)
    gaps = torch.where(near, state.witness.distance, 0.0)
    points = torch.where(near[..., None], state.witness.point_b - state.witness.point_a, 0.0).sum(dim=-1)
    parts = state.T[:, 0, :2], state.q[:, 1:3], state.T_link[:, -1, :3, 3], state.T_link[:, 3, :3, 0], gaps, points
    return torch.cat(parts, dim=1)


SQUARES, TORCH = LevenbergMarquardt(iterations=60), TorchTerm(height, weight=50.0)


@pytest.mark.parametrize(
    ("term", "solver"),
    [(Height(), SQUARES), (Plain(), SQUARES), (TORCH, SQUARES), (TORCH, Descent(iterations=80, step_translation=4e-3))],
)
def test_terms_are_minimised(grasps: Any, term: Term, solver: Any):
    config = replace(QUICK, solver=solver)
    hand, box, every = grasps
    before, after = (refine(hand, box, every[:1], config, terms=terms).after.hand_pose[:, 2] for terms in ([], [term]))
    assert np.abs(after - HEIGHT).max() < 0.3 * np.abs(before - HEIGHT).max()


def test_nothing_changes_without_terms_or_with_weights_of_0(grasps: Any):
    plain, none = refine(*grasps, QUICK).after, refine(*grasps, QUICK, terms=[Height(weight=0.0)]).after
    np.testing.assert_array_equal(none.q, plain.q)


@pytest.mark.parametrize("term", [Height(), Plain(), TorchTerm(height), TorchTerm(everything)])
def test_right_derivatives_pass_the_check(grasps: Any, term: Term):
    found = check_term(term, *grasps, tolerance=0.05)
    assert set(found) == {"least squares", "autograd"} and all(len(errors) == 4 for errors in found.values())


def test_a_wrong_sign_is_found(grasps: Any):
    with refused(GraspRefineError, "Height", "rows", "200 %", "translation z"):
        check_term(Height(sign=-1.0), *grasps)


def test_what_does_not_change_cannot_be_checked(grasps: Any):
    with refused(GraspRefineError, "TorchTerm", "does not change"):
        check_term(TorchTerm(lambda state, scene: state.q[:, :1] * 0.0), *grasps)
    with refused(GraspRefineError, "Height", "no part"):
        check_term(Height(weight=0.0), *grasps)


def returns(residuals: Any = None, rows: Any = None) -> Term:
    """A term that returns some residuals or rows."""
    term = Height()
    changes = {} if residuals is None else {"residuals": lambda self, state: residuals}
    changes |= {} if rows is None else {"rows": lambda self, state, width: [rows]}
    return type("Misfit", (Height,), changes)(**vars(term))


@pytest.mark.parametrize(
    ("term", "parts"),
    [
        (returns(residuals=np.zeros(4)), ("Misfit", "residuals", "tuple", "(4, ...)", "(4,)")),
        (returns(residuals=()), ("Misfit", "residuals", "tuple")),
        (returns(residuals=(np.zeros(3),)), ("Misfit", "(4, ...)", "(3,)")),
        (returns(rows=np.zeros(4)), ("Misfit", "JointRows", "LinkRows", "(4,)")),
        (returns(rows=JointRows(np.zeros((4, 1)), np.zeros((4, 1, 6)))), ("Misfit", "(4, R, 22)", "(4, 1, 6)")),
        (TorchTerm(lambda state, scene: 0.0), ("TorchTerm", "(4, ...)", "0.0")),
    ],
)
def test_residuals_and_rows_that_do_not_fit_are_refused(grasps: Any, term: Term, parts: tuple[str, ...]):
    with refused(GraspRefineError, *parts):
        refine(*grasps, QUICK, terms=[term])


class OnlyRows(Height):
    autograd = False


class OnlyGradients(Height):
    least_squares = False


@dataclass(frozen=True)
class MoreWeights(Weights):
    palm: float = 1.0


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: Config(terms=(Height,)), ("terms", "Term")),
        (lambda: Config(terms=(height,)), ("terms", "Term")),
        (lambda: Config(terms=(Height(weight=-1.0),)), ("Height", "weight", "-1")),
        (lambda: Config(terms=(Height(weight="1"),)), ("Height", "weight", "'1'")),
        (lambda: Config(terms=(OnlyRows(),), solver=Descent()), ("OnlyRows", "Descent", "autograd")),
        (lambda: Config(terms=(OnlyGradients(),)), ("OnlyGradients", "LevenbergMarquardt", "least_squares")),
        (lambda: MoreWeights(), ("MoreWeights", "palm", "terms")),
        (lambda: TorchTerm(1.0), ("TorchTerm", "function")),
        (lambda: Config(solver=Descent), ("the class Descent itself", "Descent()")),
        (lambda: Config(solver=height), ("lacks", "needs_autograd", "step")),
        (lambda: Config(solver=GaussNewton(progress="slow")), ("GaussNewton", "progress", "'slow'")),
    ],
)
def test_what_does_not_fit_is_refused_by_name(make: Any, parts: tuple[str, ...]):
    with refused(GraspRefineError, *parts):
        make()


class GaussNewton:
    """Undamped steps of least squares, half as long after each rejected one; a class of its own."""

    needs_autograd, iterations = False, 60

    def __init__(self, progress: Any = 0.01) -> None:
        self.progress = progress

    def start(self, problem: Any, point: Any) -> Any:
        return point, np.ones(len(point.q))

    def accept(self, slots: Any, known: Any) -> Any:
        accepted = known.loss < slots.loss
        return accepted, np.where(accepted, 1.0, 0.5 * slots.state)

    def assess(self, problem: Any, slots: Any, record: Any) -> Any:
        none = np.zeros(len(slots.member), dtype=bool)
        return slots, np.where(slots.since > 8, Status.STALLED, Status.RUNNING), none

    def step(self, problem: Any, slots: Any) -> Any:
        linear = problem.linearize(slots.member, slots.point, slots.known, np.ones(len(slots.member)))
        J, r = linear.jacobian, linear.residual
        if linear.unilateral is not None:
            J = np.where((linear.unilateral & (r < 0))[..., None], 0.0, J)
        damped = J.mT @ J + 1e-3 * np.eye(J.shape[2]) * problem.metric(slots.member)[:, None]
        dx = -np.linalg.solve(damped, J.mT @ r[..., None])[..., 0] * slots.state[:, None]
        dx = np.clip(dx, *problem.step_bounds(slots.member, slots.point))
        return problem.integrate(slots.member, slots.point, dx), slots.state


@pytest.mark.parametrize("wrench", [0.0, Weights.wrench])
def test_a_solver_of_any_class_refines(grasps: Any, wrench: float):
    config = Config(starts=1, weights=Weights(wrench=wrench), solver=GaussNewton())
    refined = refine(*grasps, config)
    error = refined.outcome["contact_error_m"]
    assert np.median(error[:, 1]) < 0.2 * np.median(error[:, 0])
    assert problem_of(*grasps).groups[0].rows.tolist() == [0, 1, 2, 3]
