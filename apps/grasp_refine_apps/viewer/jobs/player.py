"""Playing: the shown iteration of a refinement, and the shown frame of a simulation or a trajectory."""

from __future__ import annotations

from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.model.recording import Recording


class Player:
    """Choice of the shown frame."""

    def __init__(self, store: Store) -> None:
        """Play what the state has."""
        self._store = store

    def scrub(self, frame: int | None) -> None:
        """Show an iteration; None: the present pose of the hand."""
        with self._store.lock:
            trace = self._store.state.trace
            if trace is not None:
                frame = None if frame is None else min(max(frame, 0), len(trace) - 1)
                self._store.set(frame=frame, motion=None)

    def show_frame(self, frame: int) -> None:
        """Show a frame of the simulation or the trajectory, or else an iteration."""
        with self._store.lock:
            motion = self._store.state.motion
            if motion is None:
                self.scrub(frame)
            else:
                self._store.set(motion_frame=min(max(frame, 0), len(motion) - 1))

    def show(self, motion: Recording | None) -> None:
        """Show a simulation, or a trajectory, from its start; None: the grasp again."""
        self._store.set(motion=motion, motion_frame=0)
