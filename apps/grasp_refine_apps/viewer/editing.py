"""What the user changes by hand, and can undo: where the hand and the object are, and where links should touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.history import Steered
from grasp_refine_apps.viewer.jobs import Change, Jobs
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.refining import nearest_targets, targets_of
from grasp_refine_apps.viewer.state import Gizmo, State
from grasp_refine_apps.viewer.target import Target
from grasp_refine_apps.viewer.worker import Control


class Editing(Jobs):
    """Jobs, and a hand that steers; a change ends what is being refined, proved or watched."""

    def __init__(self, state: State) -> None:
        """Nothing was changed yet."""
        super().__init__(state)
        self._prepared: HandObject | None = None

    def set_gizmo(self, gizmo: Gizmo) -> None:
        """What can be dragged."""
        self._set(gizmo=gizmo)

    def move_root(self, T_object_root: np.ndarray) -> None:
        """Put the base link of the hand elsewhere (4, 4), object frame."""
        T = np.array(T_object_root, dtype=float)
        with self._lock:
            if np.isfinite(T).all():
                self._steer("hand", pose=Pose(T, self._state.standing.q))

    def set_joint(self, index: int, value: float) -> None:
        """Set one joint, within its limits; radians or metres."""
        with self._lock:
            hand, now = self._state.collection.hand, self._state.standing
            if 0 <= index < len(now.q) and np.isfinite(value):
                q = now.q.copy()
                q[index] = np.clip(value, hand.lower[index], hand.upper[index])
                self._steer(f"joint {index}", pose=Pose(now.T_object_root, q))

    def move_object(self, T_world_object: np.ndarray) -> None:
        """Put the object elsewhere (4, 4) while the hand stays where it is drawn."""
        T = np.array(T_world_object, dtype=float)
        with self._lock:
            if np.isfinite(T).all():
                now = self._state
                T_hand = inverse(T) @ now.T_world_object @ now.standing.T_object_root
                self._steer("object", pose=Pose(T_hand, now.standing.q), T_world_object=T)

    def reset(self) -> None:
        """Put hand, object and targets back to where they were when the grasp was opened, before any refinement."""
        with self._lock:
            now = self._state
            start = {"pose": now.initial, "targets": targets_of(now.scene), "T_world_object": np.eye(4)}
            self._steer("", **start, trace=None, picked=None)

    def undo(self) -> None:
        """Take the last change of pose, object or targets back."""
        self._exchange(self._history.undo)

    def redo(self) -> None:
        """Do again what was undone."""
        self._exchange(self._history.redo)

    # targets

    def set_picking(self, picking: bool) -> None:
        """Whether clicks set targets."""
        self._set(picking=picking, picked=None)

    def pick_link(self, link: str, point_link: np.ndarray) -> None:
        """The user clicked a link at a point (3,) of its frame: it should touch the object where that is clicked."""
        # A click on a hand that is not there any more may come late.
        if self._state.picking and link in self._state.scene.hand.links_by_name:
            self._set(picked=(link, np.array(point_link, dtype=float)))

    def pick_object(self, point_object: np.ndarray) -> None:
        """The user clicked the object at a point (3,) of its frame: there the link that was clicked should touch."""
        with self._lock:
            if not self._state.picking:
                return
            if self._state.picked is None:
                self.say("click a link of the hand first, then the place on the object")
                return
            link, point_link = self._state.picked
            if link not in self._state.scene.links:
                self.say(
                    f"link {link} cannot touch anything, it has no collision geometry: click another one", bad=True
                )
                self._set(picked=None)
                return
            others = tuple(target for target in self._state.targets if target.link != link)
            target = Target(link, point_link, np.array(point_object, dtype=float))
            self._steer("", targets=(*others, target), picked=None)

    def move_target(self, k: int, point_object: np.ndarray) -> None:
        """Put target `k` elsewhere on the object (3,)."""
        with self._lock:
            targets = list(self._state.targets)
            if 0 <= k < len(targets):
                targets[k] = replace(targets[k], point_object=np.array(point_object, dtype=float))
                self._steer(f"target {k}", targets=tuple(targets))

    def delete_target(self, k: int) -> None:
        """Take a target away."""
        with self._lock:
            targets = self._state.targets
            if 0 <= k < len(targets):
                self._steer("", targets=targets[:k] + targets[k + 1 :])

    def clear_targets(self) -> None:
        """Targets: auto. Links within reach touch anywhere."""
        with self._lock:
            if self._state.targets:
                self._steer("", targets=())

    def aim_nearest(self) -> None:
        """Make targets of the points where links within reach are nearest to the object, to be dragged from there."""
        with self._lock:
            now = self._state
            try:
                config = now.settings.config()
            except GraspRefineError as error:
                self.say(str(error), bad=True)
                return

            def work(control: Control) -> Change | None:
                found = nearest_targets(self._hand_object(now.scene), now.scene, now.standing, config)
                if not found:
                    raise GraspRefineError("no link is within reach of the object: move the hand closer")
                return lambda state: self._steered_to(state, "", targets=found)

            self.run_job("aim", "looking for the nearest points", work)

    # how

    def _hand_object(self, scene: Scene) -> HandObject:
        """What refinement and simulation need of the hand and object of a scene, built once; for the worker."""
        prepared = self._prepared
        if prepared is None or prepared.hand is not scene.hand or prepared.object is not scene.object:
            self._prepared = prepared = HandObject.of(scene)
        return prepared

    def _push(self, what: str) -> None:
        """Remember how things are, before something changes them."""
        now = self._state
        self._history.push(Steered(now.standing, now.targets, now.T_world_object), what)

    def _steer(self, what: str, **changes: Any) -> None:
        """A change by the user, which can be undone; what is being refined, proved or recorded ends."""
        self._interrupt()
        self._become(self._steered_to(self._state, what, **changes))

    def _steered_to(self, state: State, what: str, **changes: Any) -> State:
        """The state after a change that can be undone; `what` names movements that go on."""
        self._push(what)
        pose = changes.pop("pose", state.standing)
        # What was found out of another pose is not true of this one.
        forgotten = {} if pose is state.pose else {"trial": None, "outcome": None}
        return replace(state, **{"pose": pose, "frame": None, "motion": None, **forgotten, **changes})

    def _interrupt(self) -> None:
        """Stop what is being done with the grasp that is shown; whatever else is being done goes on."""
        job = self._state.job
        if job is not None and job.kind in ("aim", "refine", "prove", "replay"):
            self.stop()

    def _exchange(self, take: Callable[[Steered], Steered | None]) -> None:
        with self._lock:
            now = self._state
            found = take(Steered(now.standing, now.targets, now.T_world_object))
            if found is not None:
                self._interrupt()
                back = {"pose": found.pose, "targets": found.targets, "T_world_object": found.T_world_object}
                nothing = dict.fromkeys(("frame", "motion", "trial", "outcome", "picked"))
                self._set(**back, **nothing)
