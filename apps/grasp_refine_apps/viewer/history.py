"""Undo and redo: what a user steers, kept as values."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.target import Target

MOST = 200
"""Steps that can be undone."""

ONE_MOVEMENT = 0.7
"""Changes of the same thing that follow each other within so many seconds are one step: a slider that is dragged."""


@dataclass(frozen=True, eq=False)
class Steered:
    """What can be undone."""

    pose: Pose
    """Where the hand is."""
    targets: tuple[Target, ...]
    """Where links should touch."""
    T_world_object: np.ndarray
    """Where the object is drawn (4, 4)."""


class History:
    """What was before, and what was undone."""

    def __init__(self) -> None:
        """Nothing was done yet."""
        self._before: list[Steered] = []
        self._after: list[Steered] = []
        self._last: tuple[str, float] = ("", -np.inf)

    @property
    def can_undo(self) -> bool:
        """Whether there is something to undo."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """Whether there is something to do again."""
        return bool(self._after)

    def push(self, now: Steered, what: str = "") -> None:
        """Keep what is, before `what` changes; the same named thing within `ONE_MOVEMENT` goes on with one step."""
        moment = time.monotonic()
        (name, last), self._last = self._last, (what, moment)
        if what and what == name and moment - last < ONE_MOVEMENT and self._before:
            return
        self._before = [*self._before[1 - MOST :], now]
        self._after = []

    def undo(self, now: Steered) -> Steered | None:
        """What was before; None: nothing."""
        return self._exchange(self._before, self._after, now)

    def redo(self, now: Steered) -> Steered | None:
        """What was undone last; None: nothing."""
        return self._exchange(self._after, self._before, now)

    def clear(self) -> None:
        """Forget everything: another grasp is shown."""
        self._before, self._after, self._last = [], [], ("", -np.inf)

    def _exchange(self, out: list[Steered], into: list[Steered], now: Steered) -> Steered | None:
        self._last = ("", -np.inf)
        if not out:
            return None
        into.append(now)
        return out.pop()
