"""Edits of hand, object and targets, undone and redone."""

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, inverse, transform
from grasp_refine_apps.viewer.jobs import editor
from grasp_refine_apps.viewer.jobs.controller import Controller
from open_viewer import settled


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch):
    """Sets the seconds within which changes are one step."""
    return lambda seconds: monkeypatch.setattr(editor, "MERGE_WINDOW_S", seconds)


def at(viewer: Controller) -> tuple[float, float]:
    """The first two joint values, which the tests set."""
    first, second = viewer.state.pose.q[:2].tolist()
    return first, second


def undone(viewer: Controller) -> list[tuple[float, float]]:
    """Undo all steps; where each one leads."""
    found = []
    while viewer.state.undo_steps:
        viewer.editor.undo()
        found.append(at(viewer))
    return found


def test_undo_and_redo_walk_through_what_was(viewer: Controller, window) -> None:
    window(0.0)
    start = at(viewer)
    viewer.editor.undo()
    viewer.editor.redo()
    assert at(viewer) == start and not viewer.state.redo_steps
    for value in (0.1, 0.2):
        viewer.editor.set_joint(0, value)
    assert undone(viewer) == [(0.1, start[1]), start]
    viewer.editor.undo()
    assert at(viewer) == start
    for value in (0.1, 0.2, 0.2):
        viewer.editor.redo()
        assert at(viewer)[0] == value
    # A new change forgets what was undone.
    viewer.editor.undo()
    viewer.editor.set_joint(1, 0.3)
    assert not viewer.state.redo_steps and undone(viewer)[0] == (0.1, start[1])


def test_a_pose_that_was_saved_stays_saved_through_undo_and_redo(viewer: Controller, window) -> None:
    """Steps from before the save knew nothing of it."""
    window(0.0)
    for value in (0.1, 0.2, 0.1):
        viewer.editor.set_joint(0, value)
    viewer.grasps.mark_saved({0: viewer.state.pose})
    unsaved = [viewer.state.num_unsaved]
    for step in (viewer.editor.undo,) * 3 + (viewer.editor.redo,) * 3:
        step()
        unsaved.append(viewer.state.num_unsaved)
    # Saved at 0.1, before and after 0.2; as in the file at the start.
    assert unsaved == [0, 1, 0, 0, 0, 1, 0]


def test_a_movement_is_one_step_and_another_joint_another(viewer: Controller, window) -> None:
    window(np.inf)
    start = at(viewer)
    for joint, value in ((0, 0.1), (0, 0.2), (1, 0.3), (1, 0.4)):
        viewer.editor.set_joint(joint, value)
    window(0.0)  # long after
    viewer.editor.set_joint(1, 0.5)
    assert undone(viewer) == [(0.2, 0.4), (0.2, start[1]), start]
    # What is changed after an undo is a step of its own.
    window(np.inf)
    viewer.editor.redo()
    viewer.editor.set_joint(1, 0.6)
    assert len(viewer.state.undo_steps) == 2


def test_a_drag_is_one_step_however_long_it_pauses(viewer: Controller, window) -> None:
    window(0.0)
    start = viewer.state.pose.T_object_root
    for drag, heights in ((1, (0.1, 0.2, 0.3)), (2, (0.4, 0.5))):
        for height in heights:
            viewer.editor.move_root(transform(np.eye(3), np.array([0.0, 0.0, height])), drag)
    assert len(viewer.state.undo_steps) == 2
    viewer.editor.undo()
    assert viewer.state.pose.T_object_root[2, 3] == 0.3
    viewer.editor.undo()
    assert viewer.state.pose.T_object_root is start
    for x in (0.01, 0.02):
        viewer.editor.move_object(transform(np.eye(3), np.array([x, 0.0, 0.0])), 3)
    assert len(viewer.state.undo_steps) == 1


def test_only_so_many_steps_are_kept(viewer: Controller, window, monkeypatch: pytest.MonkeyPatch) -> None:
    window(0.0)
    monkeypatch.setattr(editor, "MAX_STEPS", 3)
    for k in range(10):
        viewer.editor.set_joint(0, 0.01 * k)
    assert [value for value, _ in undone(viewer)] == [0.08, 0.07, 0.06]


def test_joints_stay_within_their_limits(viewer: Controller) -> None:
    hand, first = viewer.state.collection.hand, viewer.state.pose
    for value, limit in ((99.0, hand.upper[2]), (-99.0, hand.lower[2])):
        viewer.editor.set_joint(2, value)
        assert viewer.state.pose.q[2] == limit
    assert np.array_equal(np.delete(viewer.state.pose.q, 2), np.delete(first.q, 2))


def test_moving_the_object_leaves_the_hand_where_it_is_drawn(viewer: Controller) -> None:
    before = viewer.state.pose.T_object_root
    T = transform(exp_so3(np.array([0.1, -0.2, 0.3])), np.array([0.01, 0.02, -0.03]))
    viewer.editor.move_object(transform(exp_so3(np.array([0.0, 0.4, 0.0])), np.array([0.0, 0.05, 0.0])))
    viewer.editor.move_object(T)
    state = viewer.state
    np.testing.assert_allclose(state.T_world_object @ state.pose.T_object_root, before, atol=1e-12)
    np.testing.assert_allclose(state.pose.T_object_root, inverse(T) @ before, atol=1e-12)
    viewer.editor.undo()
    np.testing.assert_array_equal(viewer.state.T_world_object, np.eye(4))


def test_what_is_not_finite_or_no_joint_is_ignored(viewer: Controller) -> None:
    first = viewer.state.pose
    viewer.editor.set_joint(0, np.nan)
    viewer.editor.set_joint(99, 0.1)
    viewer.editor.move_root(np.full((4, 4), np.inf))
    viewer.editor.move_object(np.full((4, 4), np.nan))
    assert viewer.state.pose is first and not viewer.state.undo_steps


def test_targets_are_moved_replaced_deleted_and_brought_back(viewer: Controller) -> None:
    viewer.targets.set_picking(True)
    for place in (0.0, 0.01):
        viewer.targets.pick_link("link_3.0_tip", np.zeros(3))
        viewer.targets.pick_object(np.array([place, 0.0, 0.0]))
    assert len(viewer.state.targets) == 1 and viewer.state.targets[0].point_object[0] == 0.01
    viewer.targets.move(0, np.array([0.0, 0.02, 0.0]))
    viewer.targets.delete(0)
    viewer.targets.delete(7)
    assert viewer.state.targets == ()
    viewer.editor.undo()
    assert viewer.state.targets[0].point_object[1] == 0.02
    # A click on a hand that was replaced meanwhile.
    viewer.targets.pick_link("no link", np.zeros(3))
    assert viewer.state.picked is None and len(viewer.state.targets) == 1


def test_the_refined_grasp_comes_back_after_an_earlier_iteration_was_edited_or_reset(viewer: Controller) -> None:
    first = viewer.state.pose
    viewer.refinement.start()
    settled(viewer)
    refined, outcome = viewer.state.pose, viewer.state.outcome
    viewer.player.scrub(3)
    viewer.editor.set_joint(0, 0.3)
    viewer.editor.undo()
    assert viewer.state.pose.same(viewer.state.trace.pose(3)) and viewer.state.outcome is None
    viewer.editor.undo()
    assert viewer.state.pose is refined and viewer.state.outcome is outcome is not None
    viewer.editor.reset()
    assert viewer.state.pose.same(first) and viewer.state.trace is None and viewer.state.outcome is None
    viewer.editor.undo()
    assert viewer.state.pose is refined
