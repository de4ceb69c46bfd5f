"""Edits by the user that can be undone: poses of hand and object."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.se3 import inverse
from grasp_refine.objects.region import ContactRegions
from grasp_refine_apps.viewer.jobs.following import follow
from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.meters.meter import ContactMeter
from grasp_refine_apps.viewer.model.pose import Pose, Target, targets_of
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.work import NO_RESULTS

MAX_STEPS = 200
"""Maximum number of steps that can be undone."""

MERGE_WINDOW_S = 2.0
"""Seconds within which successive changes of the same thing are one step, such as a slider, whose drags have no end."""

DRAG = ", drag "
"""Text before the number of a drag in the name of an edit."""


def edit_name(what: str, drag: int | None) -> str:
    """Return the name of an edit, of one drag if it is part of one."""
    return what if drag is None else f"{what}{DRAG}{drag}"


class Editor:
    """Edits of the shown grasp; each stops a running refinement, validation or replay."""

    def __init__(self, store: Store, contacts: ContactMeter) -> None:
        """Start without edits."""
        self._store, self._contacts = store, contacts
        self._last_edit: tuple[str, float] = ("", -np.inf)
        """Name of the last edit that could be continued, and its time."""

    def move_root(self, T_object_root: np.ndarray, drag: int | None = None) -> None:
        """Move the base link of the hand to a pose (4, 4), object frame; all of one `drag` is one step to undo."""
        T = np.array(T_object_root, dtype=float)
        with self._store.lock:
            if np.isfinite(T).all():
                self.edit(edit_name("hand", drag), pose=Pose(T, self._store.state.standing.q))

    def set_joint(self, index: int, value: float) -> None:
        """Set one joint, within its limits; radians or metres."""
        with self._store.lock:
            hand, now = self._store.state.collection.hand, self._store.state.standing
            if 0 <= index < len(now.q) and np.isfinite(value):
                q = now.q.copy()
                q[index] = np.clip(value, hand.lower[index], hand.upper[index])
                self.edit(f"joint {index}", pose=Pose(now.T_object_root, q))

    def move_finger(self, wanted: Target, drag: int) -> None:
        """Bring a point of a link towards a point by the joints of its finger, see `follow`; `drag` as above."""
        scene, now = self._store.state.scene, self._store.state.standing
        pose = self._contacts.using(scene, lambda prepared: follow(prepared, scene, now, wanted))
        with self._store.lock:
            if self._store.state.scene is scene:
                self.edit(edit_name(f"finger {wanted.link}", drag), pose=pose)

    def move_object(self, T_world_object: np.ndarray, drag: int | None = None) -> None:
        """Move the object to a pose (4, 4), world frame, while the hand stays where it is drawn; `drag` as above."""
        T = np.array(T_world_object, dtype=float)
        with self._store.lock:
            if np.isfinite(T).all():
                now = self._store.state
                T_hand = inverse(T) @ now.T_world_object @ now.standing.T_object_root
                self.edit(edit_name("object", drag), pose=Pose(T_hand, now.standing.q), T_world_object=T)

    def reset(self) -> None:
        """Reset hand, object and targets to the input grasp, before any refinement."""
        with self._store.lock:
            now = self._store.state
            of_file = now.initial.same(now.collection.pose(now.number))
            recorded = now.collection.recorded(now.number)
            self.edit(
                "",
                pose=now.initial,
                targets=targets_of(now.scene),
                T_world_object=now.collection.T_world_object(now.number),
                counted=recorded if of_file else self._contacts.near(now.scene, now.initial),
                trial=now.collection.trials.get(now.number) if of_file else None,
                trace=None,
                picked=None,
            )

    def undo(self) -> None:
        """Undo the last change of pose, object, targets or regions."""
        self._exchange("undo_steps", "redo_steps")

    def redo(self) -> None:
        """Redo the last undone change."""
        self._exchange("redo_steps", "undo_steps")

    def edit(self, what: str, **changes: Any) -> None:
        """Apply an edit that can be undone; a running refinement, validation or recording stops."""
        self.interrupt()
        self._store.become(self.edited(self._store.state, what, **changes))

    def edited(self, state: State, what: str, **changes: Any) -> State:
        """Return the state after an edit that can be undone; `what` names a continued movement."""
        state = self.with_step(state, what)
        pose = changes.pop("pose", state.standing)
        # Results of another pose do not hold for this one.
        forgotten = {} if pose is state.pose else NO_RESULTS
        if "targets" in changes:
            # The links with targets count, no longer the file's or a refinement's.
            changes = {"counted": None, **changes}
        return state.evolve(**{"pose": pose, "frame": None, "motion": None, **forgotten, **changes})

    def edit_regions(self, regions: ContactRegions) -> None:
        """Set the regions of the shown object, which can be undone where they were set."""
        self.interrupt()
        state = self.with_step(self._store.state, "")
        *steps, last = state.undo_steps
        last = replace(last, regions_before=state.scene.regions or ContactRegions())
        self._store.become(state.evolve(undo_steps=(*steps, last)).with_regions(regions))

    def with_step(self, state: State, what: str) -> State:
        """Return the state with a step that can be undone, before `what` changes.

        The same `what` within `MERGE_WINDOW_S`, or of the same drag, continues one step; an empty one is always a step
        of its own.
        """
        moment = time.monotonic()
        (name, last), self._last_edit = self._last_edit, (what, moment)
        continued = what and what == name and (DRAG in what or moment - last < MERGE_WINDOW_S)
        if continued and state.undo_steps:
            return state
        steps = (*state.undo_steps, *state.work.snapshots)
        return state.evolve(undo_steps=steps[-MAX_STEPS:], redo_steps=())

    def keep_tested_pose(self, pose: Pose) -> None:
        """Keep the pose that is tested, which is the shown one: an earlier iteration replaces the present pose."""
        state = self._store.state.evolve(frame=None, motion=None)
        if pose is not state.pose:
            state = self.with_step(state, "").evolve(pose=pose, **NO_RESULTS)
        self._store.become(state)

    def interrupt(self) -> None:
        """Stop a running job of the shown grasp; other jobs continue."""
        job = self._store.state.job
        if job is not None and job.kind in ("targets", "refine", "validate", "replay", "pull"):
            self._store.stop()

    def _exchange(self, out: str, into: str) -> None:
        """Return to the last snapshot of the steps `out`, and add the present one to the steps `into`."""
        with self._store.lock:
            now = self._store.state.work
            *others, found = getattr(now, out) or (None,)
            if found is None:
                return
            self._last_edit = ("", -np.inf)
            self.interrupt()
            state = self._store.state
            now, regions = state.work, found.regions_before
            last = now.snapshots[-1]
            if regions is not None:
                last = replace(last, regions_before=state.scene.regions or ContactRegions())
            steps = {out: tuple(others), into: (*getattr(now, into), last)}
            found = replace(found, saved=now.saved, regions_before=None, **steps)
            state = replace(state, picked=None, motion=None).with_work(state.number, found)
            self._store.become(state if regions is None else state.with_regions(regions))
