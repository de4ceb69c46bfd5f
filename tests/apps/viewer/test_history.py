"""Undo and redo of a user's edits."""

import numpy as np
import pytest

from grasp_refine_apps.viewer import editing
from grasp_refine_apps.viewer.editing import EditSnapshot, History
from grasp_refine_apps.viewer.pose import Pose


def at(x: float) -> EditSnapshot:
    return EditSnapshot(Pose(np.eye(4), np.array([x])), (), np.eye(4))


def value(snapshot: EditSnapshot | None) -> float:
    assert snapshot is not None
    return float(snapshot.pose.q[0])


def test_undo_and_redo_walk_through_what_was() -> None:
    past = History()
    assert not past.can_undo and not past.can_redo
    past.push(at(0.0))
    past.push(at(1.0))
    now = at(2.0)
    assert value(now := past.undo(now)) == 1.0
    assert value(now := past.undo(now)) == 0.0
    assert past.undo(now) is None
    assert value(now := past.redo(now)) == 1.0
    assert value(now := past.redo(now)) == 2.0
    assert past.redo(now) is None


def test_a_new_change_forgets_what_was_undone() -> None:
    past = History()
    past.push(at(0.0))
    now = past.undo(at(1.0))
    past.push(now)
    assert past.can_undo and not past.can_redo


def test_a_movement_is_one_step_and_another_joint_another(monkeypatch: pytest.MonkeyPatch) -> None:
    moments = iter([0.0, 0.1, 0.2, 0.3, 5.0])
    monkeypatch.setattr(editing.time, "monotonic", lambda: next(moments))
    past = History()
    past.push(at(0.0), "joint 1")
    past.push(at(1.0), "joint 1")
    past.push(at(2.0), "joint 2")
    past.push(at(3.0), "joint 2")
    past.push(at(4.0), "joint 2")  # long after
    now = at(5.0)
    steps = []
    while (found := past.undo(now)) is not None:
        now = found
        steps.append(value(now))
    assert steps == [4.0, 2.0, 0.0]


def test_only_so_many_steps_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(editing, "MAX_STEPS", 3)
    past = History()
    for k in range(10):
        past.push(at(float(k)))
    now, steps = at(10.0), 0
    while (found := past.undo(now)) is not None:
        now, steps = found, steps + 1
    assert steps == 3 and value(now) == 7.0
