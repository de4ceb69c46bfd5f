"""Undo and redo of a user's edits, kept as values."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.target import Target

MAX_STEPS = 200
"""Maximum number of steps that can be undone."""

MERGE_WINDOW_S = 0.7
"""Seconds within which successive changes of the same thing are one step, such as a dragged slider."""


@dataclass(frozen=True, eq=False)
class EditSnapshot:
    """Snapshot of the state that can be edited."""

    pose: Pose
    """Pose of the hand, object frame."""
    targets: tuple[Target, ...]
    """Target points of links on the object."""
    T_world_object: np.ndarray
    """Pose of the object (4, 4), world frame."""


class History:
    """Snapshots before the present state, and undone ones."""

    def __init__(self) -> None:
        """Start with an empty history."""
        self._before: list[EditSnapshot] = []
        self._after: list[EditSnapshot] = []
        self._last: tuple[str, float] = ("", -np.inf)

    @property
    def can_undo(self) -> bool:
        """Whether there is something to undo."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """Whether there is something to do again."""
        return bool(self._after)

    def push(self, now: EditSnapshot, what: str = "") -> None:
        """Keep a snapshot before `what` changes; the same `what` within `MERGE_WINDOW_S` continues one step."""
        moment = time.monotonic()
        (name, last), self._last = self._last, (what, moment)
        if what and what == name and moment - last < MERGE_WINDOW_S and self._before:
            return
        self._before = [*self._before[1 - MAX_STEPS :], now]
        self._after = []

    def undo(self, now: EditSnapshot) -> EditSnapshot | None:
        """Return the snapshot before the last step; None: there is none."""
        return self._exchange(self._before, self._after, now)

    def redo(self, now: EditSnapshot) -> EditSnapshot | None:
        """Return the last undone snapshot; None: there is none."""
        return self._exchange(self._after, self._before, now)

    def clear(self) -> None:
        """Clear the history: another grasp is shown."""
        self._before, self._after, self._last = [], [], ("", -np.inf)

    def _exchange(self, out: list[EditSnapshot], into: list[EditSnapshot], now: EditSnapshot) -> EditSnapshot | None:
        self._last = ("", -np.inf)
        if not out:
            return None
        into.append(now)
        return out.pop()
