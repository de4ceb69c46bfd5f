"""Measures that are kept hold for what is shown, not for what was shown before; one contact error everywhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.se3 import transform
from grasp_refine.hands.hand import list_hands
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.facade import evaluate
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.meter import ContactMeter, title_of
from grasp_refine_apps.viewer.meters.obstacles import ObstacleMeter
from grasp_refine_apps.viewer.meters.region_meter import RegionMeter
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.state import State
from open_viewer import controller, example, settled

ROUNDING_M = 1e-9

EXAMPLES = [
    (path.parent.name, path.stem.removeprefix("example_"))
    for path in sorted((Path(__file__).parents[4] / "robots").glob("*/example_*.npz"))
]


def states(viewer: Controller) -> list[State]:
    """States that differ in what is measured, one after the other, and each between two of the first one."""
    first = viewer.state
    viewer.targets.set_nearest()
    settled(viewer)
    targets = viewer.state.targets
    pose, aside = first.pose, transform(np.eye(3), np.array([0.0, 0.01, 0.0]))
    others = [
        first.evolve(pose=replace(pose, q=pose.q + 0.05)),
        first.evolve(pose=replace(pose, T_object_root=aside @ pose.T_object_root)),
        first.evolve(targets=targets),
        first.evolve(targets=targets[1:]),
        first.evolve(counted=Counted(np.full(len(first.scene.links), 0.004))),
        State.first(Collection.of(example(object="bottle", hand="allegro")), 0, None),
    ]
    regions = [contact_regions(first.scene.object, avoid=f"above:z={z}") for z in (0.04, 0.06)]
    tasks = [Task(table=0.03), Task(table=0.05), *(Task(avoid=each.avoid) for each in regions)]
    others += [replace(first, scene=replace(first.scene, task=task)) for task in tasks]
    return [first, *others, *(each for other in others for each in (first, other))]


def test_whatever_changes_is_measured_anew(viewer: Controller) -> None:
    kept, obstacles, misses = ContactMeter(), ObstacleMeter(), RegionMeter()
    seen = set()
    for state in states(viewer):
        fresh = ContactMeter()
        found, expected = kept(state), fresh(state)
        assert found.contact_error == expected.contact_error and found.link == expected.link
        np.testing.assert_array_equal(found.point_link, expected.point_link)
        np.testing.assert_array_equal(found.target_object, expected.target_object)
        assert obstacles(state, kept.prepared(state.scene)) == ObstacleMeter()(state, fresh.prepared(state.scene))
        assert misses(found, state.scene.regions) == RegionMeter()(expected, state.scene.regions)
        seen.add((found.contact_error, len(obstacles(state, found.prepared)), len(misses(found, state.scene.regions))))
    assert len(seen) > 8


def test_the_input_grasp_is_iteration_0_with_the_same_number(viewer: Controller) -> None:
    def error() -> float:
        return viewer.contacts(viewer.state).contact_error

    opened = error()
    viewer.refinement.start()
    settled(viewer)
    outcome, trace = viewer.state.outcome, viewer.state.trace
    assert outcome is not None and trace is not None
    after = error()
    np.testing.assert_allclose([opened, after], outcome["contact_error_m"][0], atol=ROUNDING_M)
    for frame, expected, title in (
        (0, opened, "contact error"),
        (1, trace.remaining[1], "remaining gap"),
        (len(trace) - 1, after, "contact error"),
    ):
        viewer.player.scrub(frame)
        assert error() == pytest.approx(expected, abs=ROUNDING_M) and title_of(viewer.state) == title
    assert "remaining gap" in trace.text(1)
    viewer.player.scrub(None)
    viewer.editor.reset()
    assert error() == pytest.approx(opened, abs=ROUNDING_M)


def page(problem: Problem) -> np.ndarray:
    """Contact errors in the heading of the viewer, grasp by grasp."""
    viewer, found = controller(problem), []
    for number in range(len(problem)):
        viewer.grasps.show(number)
        assert title_of(viewer.state) == "contact error"
        found.append(viewer.contacts(viewer.state).contact_error)
    viewer.close()
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("hand", "name"), EXAMPLES)
def test_page_table_file_and_validate_have_one_contact_error(hand: str, name: str, tmp_path: Path) -> None:
    assert len(EXAMPLES) > 10 and {hand for hand, _ in EXAMPLES} <= set(list_hands())
    problem = load_problem(ProblemSpec(hand=hand, object=name))
    refined = refine_problem(problem, Config(starts=1))
    before, after = refined.outcome["contact_error_m"].T
    (path,) = refined.save(tmp_path / "refined.npz")
    again = load_problem(ProblemSpec(grasps=path))
    for grasps, errors in ((problem, before), (again, after)):
        np.testing.assert_allclose(page(grasps), errors, atol=ROUNDING_M)
        np.testing.assert_allclose(evaluate(grasps).validated.metrics.contact_error_m, errors, atol=ROUNDING_M)
    with np.load(path) as file:
        np.testing.assert_allclose(file["contact_error_m_before"], before, atol=ROUNDING_M)
        np.testing.assert_allclose(file["contact_error_m_after"], after, atol=ROUNDING_M)
    columns = Collection.of(again).columns
    np.testing.assert_allclose(columns["contact_error_m_after"].values, after, atol=ROUNDING_M)
