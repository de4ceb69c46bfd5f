"""A live pull by the controller: it runs beside the page, follows the user's force, and ends cleanly."""

from collections.abc import Iterator

import numpy as np
import pytest

from grasp_refine.core.se3 import transform_points
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.drawing.glyphs import push_arrow
from grasp_refine_apps.viewer.jobs import pulling
from grasp_refine_apps.viewer.jobs.controller import Controller
from open_viewer import controller, example, settled
from websocket_page import until


@pytest.fixture(scope="module")
def problem() -> Problem:
    """A grasp that holds."""
    return example(index=(1,))


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    made = controller(problem)
    yield made
    made.close()


def pulled(viewer: Controller) -> None:
    """Start a pull, and wait for its first frame."""
    viewer.simulation.pull()
    until(lambda: viewer.state.motion is not None or viewer.state.job is None)
    assert viewer.state.motion is not None, viewer.state.notice


def test_the_force_of_the_user_moves_the_object_and_stop_leaves_the_last_frame(viewer: Controller) -> None:
    pulled(viewer)
    first = viewer.state.motion
    assert first.live and len(first) == 1 and not first.is_pushed(0)
    viewer.simulation.pull_steadily(5.0, "-z")
    until(lambda: viewer.state.motion.is_pushed(0) and viewer.state.motion.time[0] > first.time[0] + 0.5)
    found = viewer.state.motion
    np.testing.assert_allclose(found.force, [0.0, 0.0, -5.0])
    assert found.object_pose(0)[2, 3] < first.object_pose(0)[2, 3] - 1e-4
    assert "5.0 N" in found.text(0) and not found.is_lost(0)
    viewer.stop()
    settled(viewer)
    last = viewer.state.motion
    assert last.live and viewer.state.trial is None
    # The grasp itself is as before, and the next job can start.
    assert viewer.state.standing is viewer.state.pose and not viewer.state.undo_steps
    pulled(viewer)
    assert not viewer.state.motion.is_pushed(0), "a new pull begins without force"
    viewer.stop()


def test_the_arrow_of_a_pull_begins_at_the_point_that_is_dragged(viewer: Controller) -> None:
    pulled(viewer)
    point = np.array([0.02, 0.01, 0.05])
    viewer.simulation.pull_point(point, point + (0.0, 0.0, 0.01))
    until(lambda: viewer.state.motion.is_pushed(0))
    motion = viewer.state.motion
    T, prepared = motion.object_pose(0), viewer.contacts.prepared(viewer.state.scene)
    start, end = push_arrow(prepared, T, motion.force, 0.02, motion.pulled)
    np.testing.assert_allclose(start, transform_points(T, point), atol=1e-12)
    np.testing.assert_allclose(np.cross(end - start, motion.force), 0.0, atol=1e-9)
    viewer.simulation.pull_point(None, None)
    viewer.simulation.pull_steadily(2.0, "+x")
    until(lambda: viewer.state.motion.is_pushed(0) and viewer.state.motion.pulled is None)
    viewer.stop()


def test_a_point_is_pulled_by_a_spring_until_the_object_is_lost_and_the_pull_ends(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pulling, "LOST_SECONDS", 0.1)
    pulled(viewer)
    viewer.simulation.pull_point(np.array([0.0, 0.0, 0.05]), np.array([0.0, 0.0, 0.3]))
    settled(viewer)
    motion = viewer.state.motion
    assert motion.live and motion.is_lost(0) and not motion.succeeds and viewer.state.notice is None


def test_what_is_shown_instead_ends_a_pull_and_so_does_time(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    pulled(viewer)
    viewer.player.show(None)
    settled(viewer)
    assert viewer.state.motion is None
    pulled(viewer)
    pose = viewer.state.pose
    viewer.editor.set_joint(0, 0.1)
    settled(viewer)
    assert viewer.state.motion is None and viewer.state.pose is not pose
    viewer.editor.undo()
    monkeypatch.setattr(pulling, "MAX_SECONDS", 0.2)
    pulled(viewer)
    settled(viewer)
    assert viewer.state.motion.live and 0.2 <= viewer.state.motion.time[0] < 0.3


def test_a_hand_that_cannot_close_is_reported(viewer: Controller) -> None:
    T = viewer.state.pose.T_object_root.copy()
    T[:3, 3] *= 0.2
    viewer.editor.move_root(T)
    viewer.simulation.pull()
    settled(viewer)
    assert viewer.state.notice.bad and viewer.state.motion is None
