"""One contact error: page, table, file and `validate` have the same number of every example grasp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.hand import list_hands
from grasp_refine.problem.facade import evaluate
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine_apps.viewer.meters.meter import title_of
from grasp_refine_apps.viewer.model.collection import Collection
from open_viewer import controller, settled

ROUNDING_M = 1e-9

EXAMPLES = [
    (path.parent.name, path.stem.removeprefix("example_"))
    for path in sorted((Path(__file__).parents[4] / "robots").glob("*/example_*.npz"))
]


def page(problem: Problem) -> np.ndarray:
    """Contact errors in the heading of the viewer, grasp by grasp."""
    viewer, found = controller(problem), []
    try:
        for number in range(len(problem)):
            viewer.grasps.show(number)
            assert title_of(viewer.state) == "contact error"
            found.append(viewer.contacts(viewer.state).contact_error)
    finally:
        viewer.close()
    return np.array(found)


def validated(problem: Problem) -> np.ndarray:
    return evaluate(problem).validated.metrics.contact_error_m


def test_there_are_examples() -> None:
    assert len(EXAMPLES) > 10 and {hand for hand, _ in EXAMPLES} <= set(list_hands())


@pytest.mark.slow
@pytest.mark.parametrize(("hand", "name"), EXAMPLES)
def test_all_say_the_same_before_and_after(hand: str, name: str, tmp_path: Path) -> None:
    problem = load_problem(ProblemSpec(hand=hand, object=name))
    refined = refine_problem(problem, Config(starts=1))
    before, after = refined.outcome["contact_error_m"].T
    np.testing.assert_allclose(page(problem), before, atol=ROUNDING_M)
    np.testing.assert_allclose(validated(problem), before, atol=ROUNDING_M)
    (path,) = refined.save(tmp_path / "refined.npz")
    again = load_problem(ProblemSpec(grasps=path))
    np.testing.assert_allclose(page(again), after, atol=ROUNDING_M)
    np.testing.assert_allclose(validated(again), after, atol=ROUNDING_M)
    with np.load(path) as file:
        np.testing.assert_allclose(file["contact_error_m_before"], before, atol=ROUNDING_M)
        np.testing.assert_allclose(file["contact_error_m_after"], after, atol=ROUNDING_M)
    columns = Collection.of(again).columns
    np.testing.assert_allclose(columns["contact_error_m_after"].values, after, atol=ROUNDING_M)


def test_the_input_grasp_is_iteration_0_with_the_same_number(problem: Problem) -> None:
    viewer = controller(problem)
    try:
        opened = viewer.contacts(viewer.state).contact_error
        viewer.refinement.start()
        settled(viewer)
        outcome, trace = viewer.state.outcome, viewer.state.trace
        assert outcome is not None and trace is not None
        after = viewer.contacts(viewer.state).contact_error
        np.testing.assert_allclose([opened, after], outcome["contact_error_m"][0], atol=ROUNDING_M)
        viewer.player.scrub(0)
        assert viewer.contacts(viewer.state).contact_error == pytest.approx(opened, abs=ROUNDING_M)
        assert title_of(viewer.state) == "contact error"
        viewer.player.scrub(1)
        assert title_of(viewer.state) == "remaining gap" and "remaining gap" in trace.text(1)
        assert viewer.contacts(viewer.state).contact_error == pytest.approx(trace.remaining[1], abs=ROUNDING_M)
        viewer.player.scrub(len(trace) - 1)
        assert viewer.contacts(viewer.state).contact_error == pytest.approx(after, abs=ROUNDING_M)
        viewer.player.scrub(None)
        viewer.editor.reset()
        assert viewer.contacts(viewer.state).contact_error == pytest.approx(opened, abs=ROUNDING_M)
    finally:
        viewer.close()
