"""Commands on many grasps: refinement and simulation of each as it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.plurals import count_text
from grasp_refine.results.outcome import Outcome
from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.batches import batches, pose_of, refine_batch
from grasp_refine_apps.viewer.jobs.editor import MAX_STEPS
from grasp_refine_apps.viewer.jobs.store import BUSY_MESSAGE, Store
from grasp_refine_apps.viewer.jobs.targets import Prepare
from grasp_refine_apps.viewer.jobs.validating import MakeWorld, PosedGrasp, protocol_of, run_trial
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.work import NO_RESULTS, Work, now


class ManyGrasps:
    """Commands on many grasps; results are kept one by one, as they arrive."""

    def __init__(self, store: Store, background: Background, prepare: Prepare, make_world: MakeWorld) -> None:
        """Work on what the state has."""
        self._store, self._background = store, background
        self._prepare, self._make_world = prepare, make_world

    def refine(self, numbers: Sequence[int]) -> None:
        """Refine the current grasps, except grasps that these settings have refined; each is kept when done."""
        store = self._store
        with store.lock:
            config = store.checked(store.state.settings.config)
            if config is None:
                return
            collection = store.state.collection

            def is_refined(number: int, work: Work) -> bool:
                same_task = work.refined_for is collection.group(number).scene.task
                return same_task and work.outcome is not None and work.config == config

            wanted = self._without(numbers, is_refined)
            if not wanted:
                store.notify("all of them are refined with these settings: change the settings, or reset a grasp")
                return

            def work(control: Control) -> None:
                done, collection = 0, self._background.cut_all(wanted, control)
                todo = self._works(wanted)
                for batch in batches(collection, todo):
                    control.report(done / len(todo), f"refining {done + 1} of {len(todo)} grasps")
                    control.check()
                    scene = batch.group.scene
                    outcome = refine_batch(batch, config, self._prepare(scene.hand, scene.object), control)
                    for i, number in enumerate(batch.numbers):
                        results = {"config": config, "refined_for": scene.task}
                        self._keep_refined(control, number, todo[number], outcome.select(np.array([i])), results)
                    done += len(batch.numbers)
                store.notify(f"{count_text(done, 'grasp')} refined: they are listed in Browse, and not saved yet")

            self._run("refining", work)

    def test(self, numbers: Sequence[int]) -> None:
        """Simulate the current grasps, except grasps that the protocol has tested; each result is kept at once."""
        store = self._store
        with store.lock:
            protocol = store.checked(lambda: protocol_of(*store.state.protocol))
            if protocol is None:
                return

            def is_tested(_: int, work: Work) -> bool:
                # That of a trial says how many points touch.
                tried = None if work.trial is None else work.trial.protocol
                return tried is not None and tried == protocol.for_contacts(bool(tried.multiccd))

            wanted = self._without(numbers, is_tested)
            if not wanted:
                store.notify("all of them are tested by this protocol")
                return

            def work(control: Control) -> None:
                collection = self._background.cut_all(wanted, control)
                todo = self._works(wanted)
                quiet = Control(lambda share, what: control.check())
                for done, (number, start) in enumerate(todo.items()):
                    control.report(done / len(todo), f"testing {done + 1} of {len(todo)} grasps")
                    control.check()
                    grasp = PosedGrasp.of(collection, number, start.standing)
                    trial = run_trial(self._make_world, grasp.with_bodies(self._prepare), protocol, quiet)
                    self._keep(control, number, start, {"trial": trial, "tested_at": now()})
                trials = [store.state.works[number].trial for number in todo]
                held = sum(trial is not None and trial.held for trial in trials)
                store.notify(f"{count_text(len(todo), 'grasp')} tested: {held} held")

            self._run("testing", work)

    def _without(self, numbers: Sequence[int], done: Callable[[int, Work], bool]) -> list[int]:
        """Numbers of some grasps whose work is not done."""
        works = self._store.state.works
        return [number for number in numbers if number not in works or not done(number, works[number])]

    def _works(self, numbers: Sequence[int]) -> dict[int, Work]:
        """Works on some grasps; takes a moment for many."""
        state = self._store.state
        return {n: state.works.get(n) or state.collection.work(n) for n in numbers if 0 <= n < len(state.collection)}

    def _run(self, what: str, work: Callable[[Control], None]) -> None:
        if not self._store.run_job("batch", what, work):
            self._store.notify(BUSY_MESSAGE, bad=True)

    def _keep_refined(
        self, control: Control, number: int, start: Work, outcome: Outcome, results: dict[str, Any]
    ) -> None:
        """Keep the result of one of many refinements, unless the grasp was changed meanwhile."""
        with self._store.lock:
            work = self._store.state.works.get(number, start)
            steps = (*work.undo_steps, *work.snapshots)[-MAX_STEPS:]
            results |= {"pose": pose_of(outcome, 0), "outcome": outcome, "counted": Counted(outcome.contact_gap[0])}
            undone = {"trace": None, "frame": None, "undo_steps": steps, "redo_steps": ()}
            self._keep(control, number, start, {**NO_RESULTS, **results, "refined_at": now(), **undone})

    def _keep(self, control: Control, number: int, start: Work, changes: dict[str, Any]) -> None:
        """Change the work on a grasp for a job, unless the job was stopped or the grasp changed since `start`."""
        with self._store.lock:
            control.check()
            present = self._store.state.works.get(number, start)
            if present.standing.same(start.standing) and present.targets is start.targets:
                self._store.become(self._store.state.with_work(number, replace(present, **changes)))
