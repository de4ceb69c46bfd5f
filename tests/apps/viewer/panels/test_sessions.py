"""Pages of one server: each chooses its grasp, all share their work, and what was closed is there again."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.work import now
from grasp_refine_apps.viewer.panels.app import Viewer
from grasp_refine_apps.viewer.server.page import open_server
from open_viewer import controller, settled
from websocket_page import Page, until


@pytest.fixture
def viewer(problem: Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    monkeypatch.chdir(tmp_path)  # where marks of the example are kept
    with Viewer(open_server("127.0.0.1", 0), controller(problem)) as opened:
        yield opened


def joined(viewer: Viewer) -> tuple[Page, Controller]:
    """A new page, and its controller."""
    known = set(viewer.sessions)
    page = Page(viewer.server, viewer.page.access.token)
    (number,) = until(lambda: set(viewer.sessions) - known)
    return page, viewer.sessions[number].controller


def placed(page: Page) -> int:
    """Number of times that the camera of a page was placed."""
    return sum(message["type"] == "SetCameraPositionMessage" for message in page.messages)


def test_each_page_has_its_own_grasp_and_its_own_scene(viewer: Viewer) -> None:
    (first, mine), (second, its) = joined(viewer), joined(viewer)
    assert mine is viewer.controller is not its
    its.grasps.show(2)
    its.set(gizmo="hand", picking=True)
    until(lambda: "/gizmo_hand" in second.nodes() and "/grasp/hand/20" in first.nodes())
    assert "/gizmo_hand" not in first.nodes()
    assert (mine.state.number, mine.state.gizmo, mine.state.picking) == (0, "none", False)
    cameras = placed(first), placed(second)
    its.grasps.show(1)
    until(lambda: placed(second) > cameras[1])
    assert placed(first) == cameras[0]
    first.close()
    second.close()


def test_marks_edits_refinements_and_undo_are_shared_and_the_iteration_is_not(viewer: Viewer) -> None:
    (first, mine), (second, its) = joined(viewer), joined(viewer)
    its.grasps.show(2)
    its.grasps.mark(2, "good")
    its.editor.set_joint(3, 0.4)
    its.refinement.start()
    settled(its)
    assert its.state.outcome is not None and mine.state.outcome is None
    mine.grasps.show(2)
    assert mine.state.collection.mark(2) == "good"
    assert mine.state.work is its.state.work and mine.state.unsaved == (2,)
    mine.player.scrub(1)
    assert mine.state.frame == 1 and its.state.frame != 1 and its.state.trace is mine.state.trace
    # What else changes in that work comes without the other page's iteration.
    its.set(tested_at=now())
    assert mine.state.frame == 1 and mine.state.work.tested_at is its.state.work.tested_at is not None
    its.editor.undo()
    its.editor.undo()
    assert mine.state.pose is its.state.pose is not None and mine.state.pose.same(mine.state.initial)
    # Also of grasps that another page has put aside.
    mine.grasps.open(controller().state.collection)
    its.editor.set_joint(3, 0.3)
    assert mine.state.pose.same(mine.state.initial) and its.state.shelf == ()
    mine.grasps.reopen(0)
    assert mine.state.number == 2 and mine.state.pose is its.state.pose and mine.state.pose.q[3] == 0.3
    first.close()
    second.close()


def test_a_grasp_that_another_page_refines_is_followed_and_not_refined_twice(viewer: Viewer) -> None:
    (first, mine), (second, its) = joined(viewer), joined(viewer)
    its.refinement.step()
    until(lambda: its.state.trace is not None)
    mine.refinement.start()
    assert mine.state.job is None and "another page" in mine.state.notice.text
    assert its.state.job.kind == "refine" and its.state.notice is None
    assert mine.state.pose is its.state.pose and mine.state.trace is its.state.trace
    # Another grasp can be refined meanwhile, and this one afterwards.
    mine.grasps.show(1)
    mine.refinement.start()
    settled(mine)
    its.stop()
    mine.grasps.show(0)
    mine.refinement.start()
    settled(mine)
    assert mine.state.outcome is not None and its.state.outcome is mine.state.outcome
    first.close()
    second.close()


def test_a_page_that_is_loaded_again_is_as_it_was_and_its_jobs_go_on(viewer: Viewer) -> None:
    (first, mine), (second, its) = joined(viewer), joined(viewer)
    its.grasps.show(3)
    its.set(side_by_side=True)
    done = []

    def work(control: Control) -> None:
        until(lambda: len(viewer.sessions) == 1 or control.stopped)
        done.append(control.stopped)

    assert its.run_job("batch", "something long", work)
    second.close()
    until(lambda: done)
    settled(its)
    assert done == [False]
    third, again = joined(viewer)
    assert again is its and again.state.number == 3 and again.state.side_by_side
    # Another page begins like an open one.
    mine.grasps.show(1)
    fourth, other = joined(viewer)
    assert other not in (mine, its) and len(viewer.controllers) == 3
    np.testing.assert_array_equal(other.state.pose.q, other.state.works[other.state.number].pose.q)
    for page in (first, third, fourth):
        page.close()
    until(lambda: not viewer.sessions)
