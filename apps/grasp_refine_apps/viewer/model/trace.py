"""Recorded iterations of one refinement, for the timeline and the plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.refinement.phases import PHASES
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.model.contacts import contacts_of, distances_text
from grasp_refine_apps.viewer.model.counted import REMAINING, Counted
from grasp_refine_apps.viewer.model.pose import Pose, Target
from grasp_refine_apps.viewer.model.recording import Recording

FRAME_S, MAX_PLAY_S = 0.04, 10.0
"""Duration of a played iteration, and of all together, in seconds: many iterations are played faster."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace(Recording):
    """Recording of the K iterations of a refinement, with their measures; it grows while the grasp is refined."""

    gap: Float[np.ndarray, "K L"]
    """Gaps (K, L) in metres that the links should keep which an iteration closes; NaN for others."""
    loss: Float[np.ndarray, " K"]
    """Losses (K,) in m^2; different stages do not compare."""
    remaining: Float[np.ndarray, " K"]
    """Largest gap or target miss (K,) of these links, metres."""
    penetration: Float[np.ndarray, " K"]
    """Deepest of all links (K,), metres."""
    label: tuple[str, ...]
    """Description of each iteration (K,), for users."""
    start: Counted | None = None
    """Contact links of the grasp that is refined."""

    @staticmethod
    def of(T_root: np.ndarray, q: np.ndarray, **measures: Any) -> Trace:
        """Return the trace of iterations at poses (K, 4, 4) and joint values (K, n), with the fields of `measures`."""
        count = len(T_root)
        time = min(FRAME_S, MAX_PLAY_S / count) * np.arange(count)
        return Trace(title="refinement", T_root=T_root, q=q, time=time, **measures)

    def text(self, frame: int) -> str:
        """Return the measures of an iteration in one line."""
        return distances_text(float(self.remaining[frame]), float(self.penetration[frame]), REMAINING)

    def caption(self, frame: int) -> str:
        """Return the number of an iteration, its stage and its measures in two lines."""
        return f"{self.label[frame]}: iteration {frame + 1} of {len(self)}\n{self.text(frame)}"


@dataclass(frozen=True, eq=False)
class _Iteration:
    """One iteration of one run; measures are NaN where it was not followed."""

    run: int
    pose: Pose
    gap: Float[np.ndarray, " L"]
    loss: float
    label: str
    remaining: float = np.nan
    penetration: float = np.nan


class Recorder:
    """Builder of the trace of the one grasp of a scene while it is refined.

    A refinement may try several starts, one after the other and at once. A trace shows one run at a time, from the
    input grasp on: while it refines, the first start that is not done; in the end, the run that led to the result.
    """

    def __init__(
        self,
        prepared: HandObject,
        start: Pose,
        targets: Sequence[Target],
        margin: float,
        counted: Counted | None = None,
    ) -> None:
        """Record nothing yet.

        Args:
            prepared: Hand and object.
            start: Pose of the hand before the refinement.
            targets: Target points of links on the object; empty: links touch anywhere.
            margin: Gap in metres that contacts should keep.
            counted: Contact links of the grasp before the refinement.
        """
        self._prepared, self._start, self._targets = prepared, start, targets
        self._margin, self._counted = margin, counted
        self._iterations: list[_Iteration] = []
        self._runs: dict[tuple[int, int], int] = {}
        self._attempt, self._stage, self._followed = 0, "", 0

    def add(self, state: IterationState) -> None:
        """Keep an iteration of all starts that are tried at once."""
        if state.stage == PHASES[0].name != self._stage:
            self._attempt += 1
        self._stage = state.stage
        first = int(state.member.min())
        for i, member in enumerate(state.member.tolist()):
            run = self._runs.setdefault((self._attempt, member), len(self._runs))
            label = state.stage if run == 0 else f"{state.stage}, start {run + 1}"
            pose = Pose(state.point.T[i].copy(), state.point.q[i].copy())
            gap = np.where(state.touching[i], self._margin, np.nan)
            iteration = _Iteration(run, pose, gap, float(state.loss[i]), label)
            if member == first:
                self._followed, iteration = run, self._measured(iteration)
            self._iterations.append(iteration)

    def _measured(self, iteration: _Iteration) -> _Iteration:
        """Return an iteration with its measures, over the links that should touch in it."""
        pose = iteration.pose
        found = contacts_of(
            self._prepared,
            pose.T_object_root,
            pose.q,
            gap=iteration.gap,
            targets=self._targets,
        )
        return replace(iteration, remaining=found.contact_error, penetration=found.penetration)

    def trace(self) -> Trace | None:
        """Return the run that is followed so far; None: there is no iteration yet."""
        return self._trace([one for one in self._iterations if one.run == self._followed])

    def result(self, end: Pose, gap: np.ndarray, loss: float) -> Trace:
        """Return the run that led to the result; some measures are not known yet."""

        def distance(one: _Iteration) -> float:
            moved = one.pose.T_object_root - end.T_object_root
            return float(np.abs(moved).max() + np.abs(one.pose.q - end.q).max())

        last = _Iteration(-1, end, gap, loss, "the best of all")
        known = [one for one in self._iterations if one.pose.posed]
        run = min(known, key=distance).run if known else 0
        found = self._trace([*(one for one in self._iterations if one.run == run), self._measured(last)])
        assert found is not None
        return found

    def _trace(self, iterations: list[_Iteration]) -> Trace | None:
        """Return the trace of some iterations, with the input grasp before them if they begin elsewhere."""
        if not iterations:
            return None
        first = iterations[0]
        if not np.allclose(first.pose.T_object_root, self._start.T_object_root) or not np.allclose(
            first.pose.q, self._start.q
        ):
            start = _Iteration(first.run, self._start, first.gap, np.nan, "the input grasp")
            iterations = [self._measured(start), *iterations]
        return Trace.of(
            np.stack([one.pose.T_object_root for one in iterations]),
            np.stack([one.pose.q for one in iterations]),
            gap=np.stack([one.gap for one in iterations]),
            loss=np.array([one.loss for one in iterations]),
            remaining=np.array([one.remaining for one in iterations]),
            penetration=np.array([one.penetration for one in iterations]),
            label=tuple(one.label for one in iterations),
            start=self._counted,
        )
