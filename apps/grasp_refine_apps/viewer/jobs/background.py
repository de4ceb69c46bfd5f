"""Work that starts by itself: decomposition of the shown object into convex pieces, and measuring of grasps."""

from __future__ import annotations

from collections.abc import Iterable

from grasp_refine.objects.object import Object, prepare
from grasp_refine_apps.viewer.jobs.measuring import unmeasured, with_measures
from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.state import Job


class Background:
    """Decomposition and measuring; both resume when the worker is free."""

    def __init__(self, store: Store) -> None:
        """Start nothing yet."""
        self._store = store
        self._not_cut: set[Object] = set()
        """Objects whose decomposition the user stopped, or that failed."""
        self._measuring = False
        """Whether measuring resumes when the worker is free."""
        self._measured = False
        """Whether grasps are measured as soon as their object is decomposed."""

    def ready(self) -> bool:
        """Return whether the object of the shown grasp is decomposed; if not, decompose it now, and notify the user."""
        with self._store.lock:
            state = self._store.state
            obj = state.scene.object.whole
            if obj is None:
                return True
            self._not_cut.discard(obj)
            self._store.notify("its object is decomposed into convex pieces first: try again when that is done")
            self.cut_shown()
            return False

    def cut_all(self, numbers: Iterable[int], control: Control) -> Collection:
        """Decompose the objects of grasps, for a job; return the collection with them."""
        for at in sorted({int(self._store.state.collection.group_of[number]) for number in numbers}):
            self._cut(at, control)
        return self._store.state.collection

    def cut_shown(self) -> bool:
        """Start to decompose the object of the shown grasp unless it is decomposed; return whether it started."""
        with self._store.lock:
            collection = self._store.state.collection
            at = int(collection.group_of[self._store.state.number])
            obj = collection.rough.get(at)
            if obj is None or obj in self._not_cut:
                return False
            what = f"cutting {collection.problem.groups[at].object} into convex pieces"
            return self._store.run_job("cut", what, lambda control: self._cut(at, control))

    def measure(self) -> None:
        """Measure the grasps whose files have no measures; jobs of the user come first."""
        with self._store.lock:
            collection = self._store.state.collection
            if not unmeasured(collection).any():
                return

            def work(control: Control) -> None:
                # Stopped measuring resumes later; failed measuring would fail again.
                again = False
                try:
                    with_measures(collection, control.report, control.check, self._keep_measures)
                except Stopped:
                    again = True
                    raise
                finally:
                    self._measuring &= again

            self._measuring = self._measured = True
            self._store.run_job("measure", "measuring grasps", work)

    def resume(self) -> None:
        """Decompose the shown object, or else measure, where that is still to do."""
        if not self.cut_shown() and self._measuring:
            self.measure()

    def stopped(self, job: Job | None) -> None:
        """Do not resume a job that the user stops."""
        self._measuring &= job is None or job.kind != "measure"
        if job is not None and job.kind == "cut":
            self._not_cut |= set(self._store.state.collection.rough.values())

    def forget(self) -> None:
        """Stop work on grasps that are not open any more."""
        self._measuring = False
        job = self._store.state.job
        if job is not None and job.kind in ("measure", "batch"):
            self._store.halt()

    def _keep_measures(self, found: Collection) -> None:
        """Keep new measures, also when measuring was stopped."""
        with self._store.lock:
            now = self._store.state.collection
            if now.same_grasps(found):
                self._store.set(collection=now.with_columns(*found.columns.values()))

    def _cut(self, at: int, control: Control) -> None:
        """Decompose the object of a group of the open grasps, unless it is decomposed, for a job."""
        before = self._store.state.collection
        obj = before.rough.get(at)
        if obj is None:
            return
        control.describe(f"cutting {before.problem.groups[at].object} into convex pieces")
        try:
            prepare([obj])
        except BaseException:
            self._not_cut.add(obj)
            raise
        with self._store.lock:
            # Also after a stop: it has taken long.
            state = self._store.state
            if state.collection.same_grasps(before) and at in state.collection.rough:
                collection = state.collection.with_object(at, obj)
                self._store.set(collection=collection, scene=collection.scene(state.number))
                self._measuring |= self._measured
        control.check()
