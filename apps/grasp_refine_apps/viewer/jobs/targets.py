"""Edits of target points: where on the object links should touch it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor, edit_name
from grasp_refine_apps.viewer.jobs.refining import nearest_targets
from grasp_refine_apps.viewer.jobs.store import Change, Store
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.pose import Target

Prepare = Callable[[Hand, Object], HandObject]
"""Function that prepares a hand and an object for queries, in the worker."""


class TargetEditor:
    """Edits of the targets of the shown grasp."""

    def __init__(self, store: Store, editor: Editor, background: Background, prepare: Prepare) -> None:
        """Edit what the state has."""
        self._store, self._editor, self._background, self._prepare = store, editor, background, prepare

    def set_picking(self, picking: bool) -> None:
        """Turn setting targets by clicks on or off."""
        self._store.set(picking=picking, picked=None)

    def pick_link(self, link: str, point_link: np.ndarray) -> None:
        """Pick a link at a clicked point (3,), link frame; a click on the object then sets its target."""
        state = self._store.state
        # A click on a hand that was replaced may arrive late.
        if state.picking and link in state.scene.hand.links_by_name:
            self._store.set(picked=(link, np.array(point_link, dtype=float)))

    def pick_object(self, point_object: np.ndarray) -> None:
        """Set the target of the picked link at a clicked point (3,) of the object, object frame."""
        with self._store.lock:
            state = self._store.state
            if not state.picking:
                return
            if state.picked is None:
                self._store.notify("click a link of the hand first, then the place on the object")
                return
            link, point_link = state.picked
            if link not in state.scene.links:
                self._store.notify(
                    f"link {link} cannot touch anything, it has no collision geometry: click another one", bad=True
                )
                self._store.set(picked=None)
                return
            others = tuple(target for target in state.targets if target.link != link)
            target = Target(link, point_link, np.array(point_object, dtype=float))
            self._editor.edit("", targets=(*others, target), picked=None)

    def move(self, k: int, point_object: np.ndarray, drag: int | None = None) -> None:
        """Move target `k` to a point (3,) of the object, object frame; all of one `drag` is one step to undo."""
        with self._store.lock:
            targets = list(self._store.state.targets)
            if 0 <= k < len(targets):
                targets[k] = replace(targets[k], point_object=np.array(point_object, dtype=float))
                self._editor.edit(edit_name(f"target {k}", drag), targets=tuple(targets))

    def delete(self, k: int) -> None:
        """Delete target `k`."""
        with self._store.lock:
            targets = self._store.state.targets
            if 0 <= k < len(targets):
                self._editor.edit("", targets=targets[:k] + targets[k + 1 :])

    def clear(self) -> None:
        """Delete all targets: links within reach touch anywhere."""
        with self._store.lock:
            if self._store.state.targets:
                self._editor.edit("", targets=())

    def set_nearest(self) -> None:
        """Set targets at the points of the object nearest to links within reach, to be dragged from there."""
        with self._store.lock:
            now = self._store.state
            config = self._store.checked(now.settings.config)
            if config is None or not self._background.ready():
                return

            def work(control: Control) -> Change:
                prepared = self._prepare(now.scene.hand, now.scene.object)
                found = nearest_targets(prepared, now.scene, now.standing, config)
                if not found:
                    raise GraspRefineError("no link is within reach of the object: move the hand closer")
                return lambda state: self._editor.edited(state, "", targets=found)

            self._store.run_job("targets", "looking for the nearest points", work)
