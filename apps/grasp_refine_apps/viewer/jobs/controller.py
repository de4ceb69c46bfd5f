"""Controller: turns commands into states, without viser.

Commands return at once, can come from any thread and never raise for user errors: they set a notice. Long jobs run in
one worker thread; listeners are called with every new state.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.scene.protocols.registry import default_protocol
from grasp_refine_apps.viewer.jobs.many import ManyGrasps, now
from grasp_refine_apps.viewer.jobs.measuring import unmeasured, with_measures
from grasp_refine_apps.viewer.jobs.planning import plan_way
from grasp_refine_apps.viewer.jobs.refining import refine_grasp
from grasp_refine_apps.viewer.jobs.store import Change
from grasp_refine_apps.viewer.jobs.validating import protocol_of, record_direction, run_trial
from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from grasp_refine_apps.viewer.meters.comparison import check_comparable
from grasp_refine_apps.viewer.meters.obstacles import ObstacleMeter, Overlap
from grasp_refine_apps.viewer.meters.region_meter import Elsewhere, RegionMeter
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.model.marks import Mark
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.shown_motion import ShownMotion
from grasp_refine_apps.viewer.model.shown_way import ShownWay
from grasp_refine_apps.viewer.model.state import DisplayOptions, Shelved, State
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.model.work import NO_RESULTS

MAX_SHELVED = 6
"""Number of the last opened files that are kept; those with unsaved grasps are kept in any case."""


class Controller(ManyGrasps):
    """Commands on the open grasps."""

    def __init__(self, collection: Collection, settings: Any, compared: Collection | None = None) -> None:
        """Show the first of the open grasps.

        Args:
            collection: The grasps.
            settings: Options of refinement (`State.settings`).
            compared: Grasps that they are compared with; they are on the shelf, too.

        Raises:
            GraspRefineError: the compared grasps are of another hand.
        """
        state = _first_state(collection, 0, settings)
        if compared is not None:
            check_comparable(collection, compared)
            other = Shelved(compared, 0, {}, Listing())
            state = replace(state, shelf=(other,), compared=other)
        super().__init__(state)
        self._obstacles = ObstacleMeter()
        self._misses = RegionMeter()

    def overlaps(self, state: State) -> tuple[Overlap, ...]:
        """Return the links of the shown hand that are in bodies around the object, the deepest first."""
        return self._obstacles(state, self.contacts.prepared(state.scene))

    def elsewhere(self, state: State) -> tuple[Elsewhere, ...]:
        """Return the links of the shown grasp that touch the object where they should not, the farthest first."""
        return self._misses(self.contacts(state), state.scene.regions)

    # display

    def change_collection(self, collection: Collection, number: int = 0) -> None:
        """Show another collection: after an upload, or with more columns of the same grasps.

        Other grasps go to the shelf, unless the new ones are the same with more known of their objects.
        """
        with self._lock:
            same_grasps = collection.same_grasps(self._state.collection)
            if same_grasps and number == self._state.number:
                self._set(collection=collection)
                return
            self._interrupt()
            if not same_grasps:
                self._measuring = False
                if self._state.job is not None and self._state.job.kind in ("measure", "batch"):
                    self._halt()
            self._become(_showing(self._state, collection, number))
            self._cut_shown()

    def reopen(self, at: int) -> None:
        """Show grasps of the shelf again, as they were left; those that are open take their place."""
        with self._lock:
            shelf, compared = self._state.shelf, self._state.compared
            if 0 <= at < len(shelf):
                found = shelf[at]
                self.change_collection(found.collection, found.number)
                others = tuple(each for each in self._state.shelf if each is not found)
                works = {**self._state.works, **found.works}
                # Grasps that were compared are so with those that were open.
                swapped = compared is not None and compared.collection.same_grasps(found.collection)
                compared = self._state.shelf[0] if swapped else None
                self._set(works=works, listing=found.listing, shelf=others, compared=compared)

    def show(self, number: int) -> None:
        """Show another grasp."""
        with self._lock:
            if 0 <= number < len(self._state.collection) and number != self._state.number:
                self.change_collection(self._state.collection, number)

    def compare(self, at: int | None) -> None:
        """Compare the open grasps with those of this place on the shelf, number by number; None: with none."""
        with self._lock:
            state = self._state
            if at is None or not 0 <= at < len(state.shelf):
                self._set(compared=None)
                return
            found = state.shelf[at]
            try:
                check_comparable(state.collection, found.collection)
            except GraspRefineError as error:
                self.notify(str(error), bad=True)
            else:
                self._set(compared=found)

    def set_display(self, display: DisplayOptions) -> None:
        """Show or hide parts of the scene."""
        self._set(display=display)

    def set_side_by_side(self, beside: bool) -> None:
        """Draw the input grasp beside the shown one, or not."""
        self._set(side_by_side=beside)

    def mark(self, number: int, mark: Mark) -> None:
        """Mark a grasp "good", "bad" or "" for no mark; saved beside its file."""
        with self._lock:
            collection = self._state.collection.with_mark(number, mark)
            self._set(collection=collection)
            try:
                collection.save_marks(number)
            except GraspRefineError as error:
                self.notify(f"{error}; the mark is kept until the viewer ends", bad=True)

    def measure(self) -> None:
        """Measure the grasps whose files have no measures; jobs of the user come first."""
        with self._lock:
            collection = self._state.collection
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
            self.run_job("measure", "measuring grasps", work)

    def stop(self) -> None:
        """Stop the running job; its intermediate result stays."""
        with self._lock:
            job = self._state.job
            self._measuring &= job is None or job.kind != "measure"
            if job is not None and job.kind == "cut":
                self._not_cut |= set(self._state.collection.rough.values())
            super().stop()

    def _ended(self) -> None:
        if not self._cut_shown() and self._measuring:
            self.measure()

    def _keep_measures(self, found: Collection) -> None:
        """Keep new measures, also when measuring was stopped."""
        with self._lock:
            now = self._state.collection
            if now.same_grasps(found):
                self._set(collection=now.with_columns(*found.columns.values()))

    # refinement

    def set_settings(self, settings: Any) -> None:
        """Set the options of refinement, from the next start on."""
        self._set(settings=settings)

    def start(self, paused: bool = False) -> None:
        """Refine the shown grasp; resume if its refinement is paused."""
        with self._lock:
            job = self._state.job
            if job is not None and job.kind == "refine":
                if job.paused and not paused:
                    self._hold(False)
                return
            if (job is not None and job.kind != "measure") or not self.ready():
                return
            # Invalid options are refused before anything starts.
            config = self._checked(self._state.settings.config)
            if config is None:
                return
            pose = self._state.standing
            nothing = {**NO_RESULTS, **dict.fromkeys(("trace", "frame", "motion", "picked"))}
            self._become(self._with_step(self._state, "").evolve(pose=pose, **nothing))
            scene, targets = self._state.scene, self._state.targets
            number = self._state.number
            name, start = self._state.collection.group(number), self.contacts.counted(self._state)

            def work(control: Control) -> Change:
                def show(trace: Trace) -> None:
                    self._update_from_job(control, pose=trace.pose(len(trace) - 1), trace=trace)

                found = refine_grasp(self._hand_object(scene), scene, pose, targets, config, control, show, name, start)
                refined = {"pose": found.pose, "trace": found.trace, "outcome": found.outcome}
                counted = Counted(found.outcome.contact_gap[0])
                return lambda state: state.evolve(
                    **refined, counted=counted, config=config, heeded=scene.regions, refined_at=now()
                )

            self.run_job("refine", "refining", work)
            if paused and self._control is not None:
                self._hold(True)

    def pause(self) -> None:
        """Pause the refinement, or resume it."""
        with self._lock:
            job = self._state.job
            if job is not None and job.kind == "refine":
                self._hold(not job.paused)

    def step_once(self) -> None:
        """Do one iteration: start a refinement that pauses after each one, or let a paused one do the next."""
        with self._lock:
            if self._state.job is None or self._state.job.kind != "refine":
                self.start(paused=True)
            elif not self._state.job.paused:
                self._hold(True)
            if self._control is not None:
                self._control.step()

    def scrub(self, frame: int | None) -> None:
        """Show an iteration; None: the present pose of the hand."""
        with self._lock:
            trace = self._state.trace
            if trace is not None:
                frame = None if frame is None else min(max(frame, 0), len(trace) - 1)
                self._set(frame=frame, motion=None)

    # validation

    def set_protocol(self, name: str, friction: float | None = None) -> None:
        """Choose the protocol of the next simulations; a friction of None is its own."""
        self._set(protocol=(name, friction))

    def run_trial(self, *protocol_and_friction: Any) -> None:
        """Simulate the shown grasp in MuJoCo, by the chosen protocol or another one (name, friction)."""
        with self._lock:
            protocol = self._checked(lambda: protocol_of(*(protocol_and_friction or self._state.protocol)))
            if protocol is None or not self.ready():
                return
            grasp = self._posed_grasp(self._state.standing)

            def work(control: Control) -> Change:
                prepared = replace(grasp, prepared=self._hand_object(grasp.scene))
                found = run_trial(self._world, prepared, protocol, control)

                return lambda state: state.evolve(trial=found, tested_at=now())

            if self.run_job("validate", "testing in MuJoCo", work):
                self._pose_for_test(grasp.pose)
                self._set(trial=None, tested_at=None)

    def plan_way(self) -> None:
        """Plan the way of the shown grasp, and show it from its start; a way that is known is shown at once."""
        with self._lock:
            state = self._state
            if state.work.way is not None and state.standing is state.pose:
                self.show_motion(state.work.way)
                return
            if not self.ready():
                return
            grasp = self._posed_grasp(state.standing)

            def work(control: Control) -> Change:
                found = plan_way(replace(grasp, prepared=self._hand_object(grasp.scene)), control)
                return lambda state: state.evolve(way=found, motion=found, motion_frame=0)

            if self.run_job("way", "planning the way", work):
                self._pose_for_test(grasp.pose)

    def record(self, direction: str) -> None:
        """Simulate one direction of the trial again, recorded for replay."""
        with self._lock:
            trial, grasp = self._state.trial, self._posed_grasp(self._state.pose)
            if trial is None or direction not in trial.directions:
                return

            def work(control: Control) -> Change:
                prepared = replace(grasp, prepared=self._hand_object(grasp.scene))
                found = record_direction(self._world, prepared, trial, direction, control)
                return lambda state: state.evolve(motion=found, motion_frame=0)

            self.run_job("replay", f"recording the push along {direction}", work)

    def _pose_for_test(self, pose: Pose) -> None:
        """Keep the pose that is tested, which is the shown one: an earlier iteration replaces the present pose."""
        state = self._state.evolve(frame=None, motion=None)
        if pose is not state.pose:
            state = self._with_step(state, "").evolve(pose=pose, **NO_RESULTS)
        self._become(state)

    def show_motion_frame(self, frame: int) -> None:
        """Show a frame of the simulation."""
        with self._lock:
            motion = self._state.motion
            if motion is not None:
                self._set(motion_frame=min(max(frame, 0), len(motion) - 1))

    def show_motion(self, motion: ShownMotion | ShownWay) -> None:
        """Show a simulation, or a way, from its start."""
        self._set(motion=motion, motion_frame=0)

    def end_motion(self) -> None:
        """Show the grasp again."""
        self._set(motion=None, motion_frame=0)


def _first_state(collection: Collection, number: int, settings: Any) -> State:
    """Return the state that shows a grasp as in its file, without anything made of any."""
    works = {number: collection.work(number)}
    scene = collection.scene(number)
    protocol = default_protocol(in_scene=scene.environment is not None).name, None
    return State(collection, number, scene, Pose(*collection.initial(number)), works, settings, protocol)


def _showing(state: State, collection: Collection, number: int) -> State:
    """Return the state with another grasp shown; what was made of grasps of the same file stays, and so do options."""
    shown = _first_state(collection, number, state.settings)
    same = collection.same_grasps(state.collection)
    kept = {
        name: getattr(state, name)
        for name in ("job", "gizmo", "brush", "display", "side_by_side", "compared", "notice", "protocol")
    }
    kept["change"] = state.change
    if not same:
        kept["compared"] = None
    if same:
        works = {**shown.works, **state.works}
        return replace(shown, works=works, listing=state.listing, shelf=state.shelf, **kept)
    # The same grasps, with more known of their objects, take the place of the old ones.
    better = state.collection.files == collection.files and collection.stand_ins < state.collection.stand_ins
    shelf = state.shelf if better and not state.unsaved else (state.shelved, *state.shelf)
    return replace(
        shown, shelf=tuple(each for at, each in enumerate(shelf) if at < MAX_SHELVED or each.unsaved), **kept
    )
