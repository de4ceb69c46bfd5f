"""Edits by the user that can be undone: poses of hand and object, and targets of links."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse
from grasp_refine.objects.region import ContactRegions
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.jobs.refining import nearest_targets
from grasp_refine_apps.viewer.jobs.store import Change, Store
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.meters.meter import ContactMeter
from grasp_refine_apps.viewer.model.pose import Pose, Target, targets_of
from grasp_refine_apps.viewer.model.state import Gizmo, State
from grasp_refine_apps.viewer.model.work import NO_RESULTS

MAX_STEPS = 200
"""Maximum number of steps that can be undone."""

MERGE_WINDOW_S = 2.0
"""Seconds within which successive changes of the same thing are one step, such as a slider, whose drags have no end."""


DRAG = ", drag "
"""Text before the number of a drag in the name of an edit."""


def _name(what: str, drag: int | None) -> str:
    """Name of an edit, of one drag if it is part of one."""
    return what if drag is None else f"{what}{DRAG}{drag}"


class Editor(Store):
    """Store with edits; an edit stops a running refinement, validation or replay."""

    def __init__(self, state: State) -> None:
        """Start without edits."""
        super().__init__(state)
        self._last_edit: tuple[str, float] = ("", -np.inf)
        """Name of the last edit that could be continued, and its time."""
        self._prepared: HandObject | None = None
        self.contacts = ContactMeter()
        """Contacts of the shown grasp of a state."""

    def set_gizmo(self, gizmo: Gizmo) -> None:
        """Choose the body that can be dragged."""
        self._set(gizmo=gizmo)

    def move_root(self, T_object_root: np.ndarray, drag: int | None = None) -> None:
        """Move the base link of the hand to a pose (4, 4), object frame; all of one `drag` is one step to undo."""
        T = np.array(T_object_root, dtype=float)
        with self._lock:
            if np.isfinite(T).all():
                self._edit(_name("hand", drag), pose=Pose(T, self._state.standing.q))

    def set_joint(self, index: int, value: float) -> None:
        """Set one joint, within its limits; radians or metres."""
        with self._lock:
            hand, now = self._state.collection.hand, self._state.standing
            if 0 <= index < len(now.q) and np.isfinite(value):
                q = now.q.copy()
                q[index] = np.clip(value, hand.lower[index], hand.upper[index])
                self._edit(f"joint {index}", pose=Pose(now.T_object_root, q))

    def move_object(self, T_world_object: np.ndarray, drag: int | None = None) -> None:
        """Move the object to a pose (4, 4), world frame, while the hand stays where it is drawn; `drag` as above."""
        T = np.array(T_world_object, dtype=float)
        with self._lock:
            if np.isfinite(T).all():
                now = self._state
                T_hand = inverse(T) @ now.T_world_object @ now.standing.T_object_root
                self._edit(_name("object", drag), pose=Pose(T_hand, now.standing.q), T_world_object=T)

    def reset(self) -> None:
        """Reset hand, object and targets to the input grasp, before any refinement."""
        with self._lock:
            now = self._state
            start = {
                "pose": now.initial,
                "targets": targets_of(now.scene),
                "T_world_object": now.collection.T_world_object(now.number),
            }
            of_file = now.initial.same(now.collection.pose(now.number))
            start["counted"] = (
                now.collection.recorded(now.number) if of_file else self.contacts.near(now.scene, now.initial)
            )
            trial = now.collection.trials.get(now.number) if of_file else None
            self._edit("", **start, trial=trial, trace=None, picked=None)

    def undo(self) -> None:
        """Undo the last change of pose, object, targets or regions."""
        self._exchange("undo_steps", "redo_steps")

    def redo(self) -> None:
        """Redo the last undone change."""
        self._exchange("redo_steps", "undo_steps")

    # targets

    def set_picking(self, picking: bool) -> None:
        """Turn setting targets by clicks on or off."""
        self._set(picking=picking, picked=None)

    def pick_link(self, link: str, point_link: np.ndarray) -> None:
        """Pick a link at a clicked point (3,), link frame; a click on the object then sets its target."""
        # A click on a hand that was replaced may arrive late.
        if self._state.picking and link in self._state.scene.hand.links_by_name:
            self._set(picked=(link, np.array(point_link, dtype=float)))

    def pick_object(self, point_object: np.ndarray) -> None:
        """Set the target of the picked link at a clicked point (3,) of the object, object frame."""
        with self._lock:
            if not self._state.picking:
                return
            if self._state.picked is None:
                self.notify("click a link of the hand first, then the place on the object")
                return
            link, point_link = self._state.picked
            if link not in self._state.scene.links:
                self.notify(
                    f"link {link} cannot touch anything, it has no collision geometry: click another one", bad=True
                )
                self._set(picked=None)
                return
            others = tuple(target for target in self._state.targets if target.link != link)
            target = Target(link, point_link, np.array(point_object, dtype=float))
            self._edit("", targets=(*others, target), picked=None)

    def move_target(self, k: int, point_object: np.ndarray, drag: int | None = None) -> None:
        """Move target `k` to a point (3,) of the object, object frame; `drag` as above."""
        with self._lock:
            targets = list(self._state.targets)
            if 0 <= k < len(targets):
                targets[k] = replace(targets[k], point_object=np.array(point_object, dtype=float))
                self._edit(_name(f"target {k}", drag), targets=tuple(targets))

    def delete_target(self, k: int) -> None:
        """Delete target `k`."""
        with self._lock:
            targets = self._state.targets
            if 0 <= k < len(targets):
                self._edit("", targets=targets[:k] + targets[k + 1 :])

    def clear_targets(self) -> None:
        """Delete all targets: links within reach touch anywhere."""
        with self._lock:
            if self._state.targets:
                self._edit("", targets=())

    def target_nearest_points(self) -> None:
        """Set targets at the points of the object nearest to links within reach, to be dragged from there."""
        with self._lock:
            now = self._state
            config = self._checked(now.settings.config)
            if config is None or not self.ready():
                return

            def work(control: Control) -> Change | None:
                found = nearest_targets(self._hand_object(now.scene), now.scene, now.standing, config)
                if not found:
                    raise GraspRefineError("no link is within reach of the object: move the hand closer")
                return lambda state: self._edited_state(state, "", targets=found)

            self.run_job("targets", "looking for the nearest points", work)

    # internals

    def _edit_regions(self, regions: ContactRegions) -> None:
        """Set the regions of the shown object, which can be undone where they were set."""
        self._interrupt()
        state = self._with_step(self._state, "")
        *steps, last = state.undo_steps
        last = replace(last, regions_before=state.scene.regions or ContactRegions())
        self._become(with_regions(state.evolve(undo_steps=(*steps, last)), regions))

    def ready(self) -> bool:
        """Return whether the object of the shown grasp can be queried."""
        return True

    def _hand_object(self, scene: Scene) -> HandObject:
        """Return hand and object of a scene, prepared once for refinement and simulation; for the worker."""
        prepared = self._prepared
        if prepared is None or prepared.hand is not scene.hand or prepared.object is not scene.object:
            self._prepared = prepared = HandObject.of(scene)
        return prepared

    def _with_step(self, state: State, what: str) -> State:
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

    def _edit(self, what: str, **changes: Any) -> None:
        """Apply an edit that can be undone; a running refinement, validation or recording stops."""
        self._interrupt()
        self._become(self._edited_state(self._state, what, **changes))

    def _edited_state(self, state: State, what: str, **changes: Any) -> State:
        """Return the state after an edit that can be undone; `what` names a continued movement."""
        state = self._with_step(state, what)
        pose = changes.pop("pose", state.standing)
        # Results of another pose do not hold for this one.
        forgotten = {} if pose is state.pose else NO_RESULTS
        if "targets" in changes:
            # The links with targets count, no longer those of the file or of a refinement.
            changes = {"counted": None, **changes}
        return state.evolve(**{"pose": pose, "frame": None, "motion": None, **forgotten, **changes})

    def _interrupt(self) -> None:
        """Stop a running job of the shown grasp; other jobs continue."""
        job = self._state.job
        if job is not None and job.kind in ("targets", "refine", "validate", "replay"):
            self.stop()

    def _exchange(self, out: str, into: str) -> None:
        """Return to the last snapshot of the steps `out`, and add the present one to the steps `into`."""
        with self._lock:
            now = self._state.work
            *others, found = getattr(now, out) or (None,)
            if found is None:
                return
            self._last_edit = ("", -np.inf)
            self._interrupt()
            now, regions = self._state.work, found.regions_before
            last = now.snapshots[-1]
            if regions is not None:
                last = replace(last, regions_before=self._state.scene.regions or ContactRegions())
            steps = {out: tuple(others), into: (*getattr(now, into), last)}
            self._set(picked=None, motion=None)
            found = replace(found, saved=now.saved, regions_before=None, **steps)
            state = self._state.with_work(self._state.number, found)
            self._become(state if regions is None else with_regions(state, regions))


def with_regions(state: State, regions: ContactRegions) -> State:
    """Return the state with other regions of the shown object, for all grasps on it."""
    collection = state.collection.with_regions(int(state.collection.group_of[state.number]), regions)
    return state.evolve(collection=collection, scene=collection.scene(state.number))
