"""Objects are decomposed, and grasps measured, when nothing else is done."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs import background
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from open_viewer import controller, settled
from websocket_page import until


@pytest.fixture
def rough(problem: Problem) -> Iterator[Controller]:
    """The example, whose mug is only a convex hull yet."""
    (group,) = problem.groups
    made = controller(replace(problem, groups=(group.on(group.scene.object.as_hull()),)))
    yield made
    made.close()


def test_a_refinement_waits_for_the_decomposition_of_its_object(rough: Controller, problem: Problem) -> None:
    obj = problem.groups[0].scene.object
    assert rough.state.scene.object is not obj and not unmeasured(rough.state.collection).any()
    rough.background.measure()
    assert rough.state.job is None, "a hull is not measured"
    rough.refinement.start()
    assert rough.state.job.kind == "cut" and rough.state.notice is not None
    settled(rough)
    assert rough.state.scene.object is obj and rough.state.outcome is None
    assert rough.state.collection.rough == {} and unmeasured(rough.state.collection).all()
    rough.refinement.start()
    assert rough.state.job.kind == "refine"
    settled(rough)
    assert rough.state.outcome is not None


def test_a_decomposition_that_is_stopped_late_is_kept_and_one_that_fails_waits_for_the_user(
    rough: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(objects: object) -> None:
        raise GraspRefineError("cannot be cut")

    monkeypatch.setattr(background, "prepare", fail)
    assert rough.background.cut_shown()
    settled(rough)
    assert rough.state.notice.bad and rough.state.scene.object.rough and not rough.background.cut_shown()
    monkeypatch.setattr(background, "prepare", lambda objects: rough.stop())
    rough.refinement.start()
    until(lambda: rough.state.collection.rough == {})
    assert not rough.background.cut_shown()


def test_measuring_resumes_after_other_jobs_and_while_others_are_shown(viewer: Controller) -> None:
    assert unmeasured(viewer.state.collection).all()
    viewer.background.measure()
    viewer.refinement.start()
    assert viewer.state.job.kind == "refine"
    viewer.grasps.show(1)
    settled(viewer)
    assert not unmeasured(viewer.state.collection).any() and viewer.state.number == 1
    assert np.isfinite(viewer.state.collection.columns["quality_after"].values).all()


def test_measuring_that_is_stopped_stays_so(viewer: Controller) -> None:
    viewer.background.measure()
    viewer.stop()
    assert viewer.state.job is None
    viewer.run_job("export", "next", lambda control: None)
    settled(viewer)
    assert viewer.state.job is None and unmeasured(viewer.state.collection).any()
