"""Cutting of objects into convex pieces when they are needed: those of grasps that are shown, or worked on."""

from __future__ import annotations

from collections.abc import Iterable

from grasp_refine.objects.object import Object, prepare
from grasp_refine_apps.viewer.jobs.region_editing import RegionEditor
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.state import State


class Cutter(RegionEditor):
    """Editor that cuts objects."""

    def __init__(self, state: State) -> None:
        """Start with what the state has."""
        super().__init__(state)
        self._not_cut: set[Object] = set()
        """Objects whose decomposition the user stopped, or that failed."""
        self._measuring = False
        """Whether measuring resumes when the worker is free."""
        self._measured = False
        """Whether grasps are measured as soon as their object is cut."""

    def ready(self) -> bool:
        """Return whether the object of the shown grasp is cut; otherwise it is cut now, and the user is told."""
        with self._lock:
            state = self._state
            obj = state.scene.object.whole
            if obj is None:
                return True
            self._not_cut.discard(obj)
            self.notify("its object is cut into convex pieces first: try again when that is done")
            self._cut_shown()
            return False

    def cut_all(self, numbers: Iterable[int], control: Control) -> Collection:
        """Cut the objects of grasps, for a job; return the collection with them."""
        for at in sorted({int(self._state.collection.group_of[number]) for number in numbers}):
            self._cut(at, control)
        return self._state.collection

    def _cut_shown(self) -> bool:
        """Begin to cut the object of the shown grasp unless it is cut; return whether that was begun."""
        with self._lock:
            collection = self._state.collection
            at = int(collection.group_of[self._state.number])
            obj = collection.rough.get(at)
            if obj is None or obj in self._not_cut:
                return False
            what = f"cutting {collection.problem.groups[at].object} into convex pieces"
            return self.run_job("cut", what, lambda control: self._cut(at, control))

    def _cut(self, at: int, control: Control) -> None:
        """Cut the object of a group of the open grasps, unless it is cut, for a job."""
        before = self._state.collection
        obj = before.rough.get(at)
        if obj is None:
            return
        control.describe(f"cutting {before.problem.groups[at].object} into convex pieces")
        try:
            prepare([obj])
        except BaseException:
            self._not_cut.add(obj)
            raise
        with self._lock:
            # Also after a stop: it has taken long.
            collection = self._state.collection
            if collection.same_grasps(before) and at in collection.rough:
                collection = collection.with_object(at, obj)
                self._set(collection=collection, scene=collection.scene(self._state.number))
                self._measuring |= self._measured
        control.check()
