"""Order of the work of a problem: simulated worlds are built first, and results are kept before they are simulated."""

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem import refine
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation import robustness
from grasp_refine.validation.engines.mujoco import world

SHORT = Config(solver=LevenbergMarquardt(iterations=1), starts=1)


def test_a_hand_that_mujoco_refuses_costs_no_refinement(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiny inertias were found out after all of the refinement, which was lost."""

    def refuse(*_: object) -> None:
        raise GraspRefineError("refused")

    monkeypatch.setattr(world, "build_world", refuse)
    monkeypatch.setattr(refine, "refine_together", lambda *_, **__: pytest.fail("it was refined"))
    problem = load_problem(ProblemSpec(hand="allegro", object="rounded_box", index=(0,)))
    with pytest.raises(GraspRefineError, match="refused"):
        refine_problem(problem.for_task(Task(Protocol("short"))), SHORT, engines=["mujoco"])


def test_refined_grasps_are_passed_on_before_they_are_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[RefinedGrasps] = []
    monkeypatch.setattr(robustness, "judge", lambda *_, **__: pytest.fail("simulated") if not seen else 1 / 0)
    problem = load_problem(ProblemSpec(hand="allegro", object="rounded_box", index=(0,)))
    with pytest.raises(ZeroDivisionError):
        refine_problem(problem.for_task(Task(Protocol("short"))), SHORT, engines=["mujoco"], on_refined=seen.append)
    assert len(seen) == 1 and seen[0].simulated is None and len(seen[0]) == 1
