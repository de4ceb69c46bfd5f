"""Recorded iterations of one refinement, for the timeline and the plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.contacts import contacts_of, distances_text
from grasp_refine_apps.viewer.pose import Pose, Target


@dataclass(frozen=True, eq=False)
class Trace:
    """K iterations of one grasp; arrays have one row each and grow while it is refined."""

    T: Float[np.ndarray, "K 4 4"]
    """Poses of the base link (K, 4, 4) in the object's frame, metres."""
    q: Float[np.ndarray, "K n"]
    """Joint values (K, n)."""
    touching: Bool[np.ndarray, "K L"]
    """Links (K, L) that should touch."""
    loss: Float[np.ndarray, " K"]
    """Losses (K,) in m^2; those of different stages do not compare."""
    contact_error: Float[np.ndarray, " K"]
    """Largest of gap and target misses (K,), metres."""
    penetration: Float[np.ndarray, " K"]
    """Deepest of all links (K,), metres."""
    label: tuple[str, ...]
    """Description of each iteration (K,), for users."""
    margin: float = 0.0
    """Gap in metres that contacts should keep."""

    def __len__(self) -> int:
        """Return the number of iterations."""
        return len(self.loss)

    def text(self, k: int) -> str:
        """Text on the measures of an iteration."""
        return distances_text(float(self.contact_error[k]), float(self.penetration[k]))

    def pose(self, k: int) -> Pose:
        """Return the pose of the hand in an iteration."""
        return Pose(self.T[k], self.q[k])


INITIAL_CAPACITY = 256
"""Initial capacity in iterations; it is doubled when it is used up."""


def subsample(count: int, limit: int) -> Int[np.ndarray, " k"]:
    """Return at most `limit` of `count` indices from 0, evenly spaced, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, limit)).round().astype(int))


class Recorder:
    """Builder of the trace of the one grasp of a scene while it is refined."""

    def __init__(self, prepared: HandObject, targets: Sequence[Target], margin: float) -> None:
        """Record nothing yet.

        Args:
            prepared: Hand and object.
            targets: Target points of links on the object; empty: links touch anywhere.
            margin: Gap in metres that contacts should keep.
        """
        self._prepared, self._targets, self._margin = prepared, targets, margin
        self._columns: list[np.ndarray] = []
        self._labels: list[str] = []

    def add(self, state: IterationState) -> None:
        """Keep an iteration; of several starts at once, that with the lowest loss."""
        best = int(np.argmin(np.nan_to_num(state.loss, nan=np.inf)))
        pose = Pose(state.point.T[best].copy(), state.point.q[best].copy())
        self.keep(pose, state.touching[best], float(state.loss[best]), state.stage)

    def keep(self, pose: Pose, touching: np.ndarray, loss: float, label: str) -> None:
        """Keep a pose of the hand, with its measures."""
        found = contacts_of(
            self._prepared,
            pose.T_object_root,
            pose.q,
            touching=touching,
            targets=self._targets,
            margin=self._margin,
        )
        row = (pose.T_object_root, pose.q, touching, loss, found.contact_error, found.penetration)
        count = len(self._labels)
        if not self._columns:
            self._columns = [np.empty((INITIAL_CAPACITY, *np.shape(value)), np.asarray(value).dtype) for value in row]
        elif count == len(self._columns[0]):
            # Traces that were returned before keep views of the old arrays.
            self._columns = [np.concatenate([column, np.empty_like(column)]) for column in self._columns]
        for column, value in zip(self._columns, row, strict=True):
            column[count] = value
        self._labels.append(label)

    def trace(self) -> Trace | None:
        """Return what was kept so far, without copying it; None: nothing."""
        count = len(self._labels)
        if not count:
            return None
        T, q, touching, loss, contact_error, penetration = (column[:count] for column in self._columns)
        return Trace(T, q, touching, loss, contact_error, penetration, tuple(self._labels), self._margin)
