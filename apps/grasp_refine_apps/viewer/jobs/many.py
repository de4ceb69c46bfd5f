"""Commands on many grasps: refinement and simulation of each as it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from grasp_refine.core.plurals import count_text
from grasp_refine.objects.region import ContactRegions
from grasp_refine.refinement.config import Config
from grasp_refine.results.outcome import Outcome
from grasp_refine_apps.viewer.jobs.batches import batches, pose_of, refine_batch
from grasp_refine_apps.viewer.jobs.cutting import Cutter
from grasp_refine_apps.viewer.jobs.editing import MAX_STEPS
from grasp_refine_apps.viewer.jobs.store import BUSY_MESSAGE
from grasp_refine_apps.viewer.jobs.validating import PosedGrasp, protocol_of, run_trial, world_cache
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.validated import TrialResult
from grasp_refine_apps.viewer.model.work import NO_RESULTS, Work


class ManyGrasps(Cutter):
    """Commands on many grasps; results are kept one by one, as they come."""

    def __init__(self, state: State) -> None:
        """Start with what the state has."""
        super().__init__(state)
        self._world = world_cache()

    def refine_many(self, numbers: Sequence[int]) -> None:
        """Refine grasps as they stand, but those that these settings have refined; each is kept as soon as it is."""
        with self._lock:
            config = self._checked(self._state.settings.config)
            if config is None:
                return
            collection = self._state.collection

            def refined(number: int, work: Work) -> bool:
                heeded = work.heeded is collection.group(number).scene.regions
                return heeded and work.outcome is not None and work.config == config

            wanted = self._without(numbers, refined)
            if not wanted:
                self.notify("all of them are refined with these settings: change the settings, or reset a grasp")
                return

            def work(control: Control) -> None:
                done, collection = 0, self.cut_all(wanted, control)
                todo = self._works(wanted)
                for batch in batches(collection, todo):
                    control.report(done / len(todo), f"refining {done + 1} of {len(todo)} grasps")
                    control.check()
                    prepared = self._hand_object(batch.group.scene)
                    outcome = refine_batch(batch, config, prepared, control)
                    for i, number in enumerate(batch.numbers):
                        self._keep_refined(
                            control,
                            number,
                            todo[number],
                            outcome.select(np.array([i])),
                            config,
                            batch.group.scene.regions,
                        )
                    done += len(batch.numbers)
                self.notify(f"{count_text(done, 'grasp')} refined: they are listed in Browse, and not saved yet")

            self._run_batch("refining", work)

    def run_trials(self, numbers: Sequence[int]) -> None:
        """Simulate grasps as they stand, but those that the protocol has tested; each result is kept at once."""
        with self._lock:
            protocol = self._checked(lambda: protocol_of(*self._state.protocol))
            if protocol is None:
                return

            def is_tested(_: int, work: Work) -> bool:
                # That of a trial says how many points touch.
                tried = None if work.trial is None else work.trial.protocol
                return tried is not None and tried == protocol.for_contacts(bool(tried.multiccd))

            wanted = self._without(numbers, is_tested)
            if not wanted:
                self.notify("all of them are tested by this protocol")
                return

            def work(control: Control) -> None:
                self.cut_all(wanted, control)
                todo = self._works(wanted)
                grasps = {number: self._posed_grasp(work.standing, number) for number, work in todo.items()}
                for done, (number, grasp) in enumerate(grasps.items()):
                    quiet = Control(lambda share, what: control.check())
                    control.report(done / len(grasps), f"testing {done + 1} of {len(grasps)} grasps")
                    control.check()
                    prepared = replace(grasp, prepared=self._hand_object(grasp.scene))
                    found = run_trial(self._world, prepared, protocol, quiet)
                    self._keep_trial(control, number, todo[number], found)
                trials = [self._state.works[number].trial for number in grasps]
                held = sum(trial is not None and trial.held for trial in trials)
                self.notify(f"{count_text(len(grasps), 'grasp')} tested: {held} held")

            self._run_batch("testing", work)

    def mark_saved(self, poses: Mapping[int, Pose]) -> None:
        """Note that grasps were saved at these poses."""
        with self._lock:
            state = self._state
            for number in poses.keys() & state.works.keys():
                state = state.with_work(number, replace(state.works[number], saved=poses[number]))
            self._become(state)

    def set_listing(self, listing: Listing) -> None:
        """List other grasps, or in another order."""
        self._set(listing=listing)

    def _without(self, numbers: Sequence[int], done: Callable[[int, Work], bool]) -> list[int]:
        """Numbers of some grasps without those whose work is done."""
        works = self._state.works
        return [number for number in numbers if number not in works or not done(number, works[number])]

    def _works(self, numbers: Sequence[int]) -> dict[int, Work]:
        """Works on some grasps; takes a moment for many."""
        state = self._state
        return {n: state.works.get(n) or state.collection.work(n) for n in numbers if 0 <= n < len(state.collection)}

    def _run_batch(self, what: str, work: Callable[[Control], None]) -> None:
        if not self.run_job("batch", what, work):
            self.notify(BUSY_MESSAGE, bad=True)

    def _keep_refined(
        self,
        control: Control,
        number: int,
        start: Work,
        outcome: Outcome,
        config: Config,
        regions: ContactRegions | None,
    ) -> None:
        """Keep the result of one of many refinements, unless the grasp was changed meanwhile."""
        counted = Counted(outcome.contact_gap[0])
        refined = {**NO_RESULTS, "pose": pose_of(outcome, 0), "outcome": outcome, "counted": counted}
        refined |= {"config": config, "heeded": regions, "refined_at": now()}

        def change(work: Work) -> Work:
            steps = (*work.undo_steps, *work.snapshots)[-MAX_STEPS:]
            return replace(work, **refined, trace=None, frame=None, undo_steps=steps, redo_steps=())

        self._keep(control, number, start, change)

    def _keep_trial(self, control: Control, number: int, start: Work, trial: TrialResult) -> None:
        """Keep the result of one of many simulations, unless the grasp was changed meanwhile."""
        self._keep(control, number, start, lambda work: replace(work, trial=trial, tested_at=now()))

    def _keep(self, control: Control, number: int, start: Work, change: Callable[[Work], Work]) -> None:
        """Change the work on a grasp for a job, unless the job was stopped or the grasp changed since `start`."""
        with self._lock:
            control.check()
            present = self._state.works.get(number, start)
            if present.standing.same(start.standing) and present.targets is start.targets:
                self._become(self._state.with_work(number, change(present)))

    def _posed_grasp(self, pose: Pose, number: int | None = None) -> PosedGrasp:
        """Return a grasp, by default the shown one, at a pose, as in its file with pregrasp and squeeze."""
        collection = self._state.collection
        number = self._state.number if number is None else number
        row = collection.member[number : number + 1]
        group = collection.group(number)
        return PosedGrasp(collection.scene(number), pose, group.grasps.select(row), row=int(group.rows[row[0]]))


def now() -> datetime:
    """Return the present time, of this machine's clock."""
    return datetime.now().astimezone()
