"""Choice of the open and of the shown grasps, with their marks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.meters.comparison import check_comparable
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.marks import Mark
from grasp_refine_apps.viewer.model.pose import Pose


class OpenGrasps:
    """Commands that open, show, compare and mark grasps."""

    def __init__(self, store: Store, editor: Editor, background: Background) -> None:
        """Start with what the state has."""
        self._store, self._editor, self._background = store, editor, background

    def open(self, collection: Collection, number: int = 0) -> None:
        """Show another collection: after an upload, or with more columns of the same grasps.

        Other grasps go to the shelf, unless the new ones are the same with more known of their objects.
        """
        with self._store.lock:
            state = self._store.state
            same_grasps = collection.same_grasps(state.collection)
            if same_grasps and number == state.number:
                self._store.set(collection=collection)
                return
            self._editor.interrupt()
            if not same_grasps:
                self._background.forget()
            self._store.become(self._store.state.showing(collection, number))
            self._background.cut_shown()

    def reopen(self, at: int) -> None:
        """Show grasps of the shelf again, as they were left; the open ones take their place."""
        with self._store.lock:
            shelf, compared = self._store.state.shelf, self._store.state.compared
            if 0 <= at < len(shelf):
                found = shelf[at]
                self.open(found.collection, found.number)
                state = self._store.state
                others = tuple(each for each in state.shelf if each is not found)
                works = {**state.works, **found.works}
                # Compared grasps stay compared with the grasps that were open.
                swapped = compared is not None and compared.collection.same_grasps(found.collection)
                compared = state.shelf[0] if swapped else None
                self._store.set(works=works, listing=found.listing, shelf=others, compared=compared)

    def show(self, number: int) -> None:
        """Show another grasp."""
        with self._store.lock:
            state = self._store.state
            if 0 <= number < len(state.collection) and number != state.number:
                self.open(state.collection, number)

    def compare(self, at: int | None) -> None:
        """Compare the open grasps with the grasps at this place on the shelf, by number; None: with none."""
        with self._store.lock:
            state = self._store.state
            if at is None or not 0 <= at < len(state.shelf):
                self._store.set(compared=None)
                return
            found = state.shelf[at]
            try:
                check_comparable(state.collection, found.collection)
            except GraspRefineError as error:
                self._store.notify(str(error), bad=True)
            else:
                self._store.set(compared=found)

    def mark(self, number: int, mark: Mark) -> None:
        """Mark a grasp "good", "bad" or "" for no mark; saved beside its file."""
        with self._store.lock:
            collection = self._store.state.collection.with_mark(number, mark)
            self._store.set(collection=collection)
            try:
                collection.save_marks(number)
            except GraspRefineError as error:
                self._store.notify(f"{error}; the mark is kept until the viewer ends", bad=True)

    def mark_saved(self, poses: Mapping[int, Pose]) -> None:
        """Note that grasps were saved at these poses."""
        with self._store.lock:
            state = self._store.state
            for number in poses.keys() & state.works.keys():
                state = state.with_work(number, replace(state.works[number], saved=poses[number]))
            self._store.become(state)
