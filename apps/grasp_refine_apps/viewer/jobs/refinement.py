"""Commands that refine the shown grasp."""

from __future__ import annotations

from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.refining import refine_grasp
from grasp_refine_apps.viewer.jobs.store import Change, Store
from grasp_refine_apps.viewer.jobs.targets import Prepare
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.meters.meter import ContactMeter
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.model.work import NO_RESULTS, now


class Refinement:
    """Refinement of the shown grasp: start, pause and single iterations."""

    def __init__(
        self, store: Store, editor: Editor, background: Background, contacts: ContactMeter, prepare: Prepare
    ) -> None:
        """Refine what the state shows."""
        self._store, self._editor, self._background = store, editor, background
        self._contacts, self._prepare = contacts, prepare

    def start(self, paused: bool = False) -> None:
        """Refine the shown grasp; resume if its refinement is paused."""
        store = self._store
        with store.lock:
            job = store.state.job
            if job is not None and job.kind == "refine":
                if job.paused and not paused:
                    store.hold(False)
                return
            if (job is not None and job.kind != "measure") or not self._background.ready():
                return
            if store.runs_elsewhere("refine"):
                store.notify(
                    "another page is refining this grasp: it moves here, too; stop it there, or wait for its result"
                )
                return
            # Invalid options are refused before anything starts.
            config = store.checked(store.state.settings.config)
            if config is None:
                return
            pose = store.state.standing
            nothing = {**NO_RESULTS, **dict.fromkeys(("trace", "frame", "motion", "picked"))}
            store.become(self._editor.with_step(store.state, "").evolve(pose=pose, **nothing))
            state = store.state
            scene, targets, group = state.scene, state.targets, state.collection.group(state.number)
            counted_before = self._contacts.counted(state)

            def work(control: Control) -> Change:
                def show(trace: Trace) -> None:
                    store.update_from_job(control, pose=trace.pose(len(trace) - 1), trace=trace)

                prepared = self._prepare(scene.hand, scene.object)
                found = refine_grasp(prepared, scene, pose, targets, config, control, show, group, counted_before)
                refined = {"pose": found.pose, "trace": found.trace, "outcome": found.outcome}
                counted = Counted(found.outcome.contact_gap[0])
                return lambda state: state.evolve(
                    **refined, counted=counted, config=config, refined_for=scene.task, refined_at=now()
                )

            store.run_job("refine", "refining", work)
            if paused:
                store.hold(True)

    def pause(self) -> None:
        """Pause the refinement, or resume it."""
        with self._store.lock:
            job = self._store.state.job
            if job is not None and job.kind == "refine":
                self._store.hold(not job.paused)

    def step(self) -> None:
        """Do one iteration: start a refinement that pauses after each one, or let a paused one do the next."""
        with self._store.lock:
            job = self._store.state.job
            if job is None or job.kind != "refine":
                self.start(paused=True)
            elif not job.paused:
                self._store.hold(True)
            self._store.step()
