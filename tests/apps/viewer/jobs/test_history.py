"""Undo and redo of a user's edits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from grasp_refine.core.se3 import transform
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs import editor
from grasp_refine_apps.viewer.jobs.controller import Controller
from open_viewer import controller, settled


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    made = controller(problem)
    yield made
    made.close()


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


def test_undo_and_redo_walk_through_what_was(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", 0.0)
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


def test_a_movement_is_one_step_and_another_joint_another(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", np.inf)
    start = at(viewer)
    for joint, value in ((0, 0.1), (0, 0.2), (1, 0.3), (1, 0.4)):
        viewer.editor.set_joint(joint, value)
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", 0.0)  # long after
    viewer.editor.set_joint(1, 0.5)
    assert undone(viewer) == [(0.2, 0.4), (0.2, start[1]), start]
    # What is changed after an undo is a step of its own.
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", np.inf)
    viewer.editor.redo()
    viewer.editor.set_joint(1, 0.6)
    assert len(viewer.state.undo_steps) == 2


def test_a_drag_is_one_step_however_long_it_pauses(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", 0.0)
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


def test_only_so_many_steps_are_kept(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", 0.0)
    monkeypatch.setattr(editor, "MAX_STEPS", 3)
    for k in range(10):
        viewer.editor.set_joint(0, 0.01 * k)
    assert [value for value, _ in undone(viewer)] == [0.08, 0.07, 0.06]


def test_the_refined_grasp_comes_back_after_an_earlier_iteration_was_edited(viewer: Controller) -> None:
    viewer.refinement.start()
    settled(viewer)
    refined, outcome = viewer.state.pose, viewer.state.outcome
    viewer.player.scrub(3)
    viewer.editor.set_joint(0, 0.3)
    viewer.editor.undo()
    assert viewer.state.pose.same(viewer.state.trace.pose(3)) and viewer.state.outcome is None
    viewer.editor.undo()
    assert viewer.state.pose is refined and viewer.state.outcome is outcome is not None
