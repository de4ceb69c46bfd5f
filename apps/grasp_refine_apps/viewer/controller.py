"""Controller: turns commands into states, without viser.

Commands return at once, can come from any thread and never raise for user errors: they set a notice. Long jobs run in
one worker thread; listeners are called with every new state.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.editing import Editor
from grasp_refine_apps.viewer.marks import Mark
from grasp_refine_apps.viewer.measuring import unmeasured, with_measures
from grasp_refine_apps.viewer.pose import Pose, targets_of
from grasp_refine_apps.viewer.refining import refine_grasp
from grasp_refine_apps.viewer.shown_motion import ShownMotion
from grasp_refine_apps.viewer.state import DisplayOptions, State
from grasp_refine_apps.viewer.store import Change
from grasp_refine_apps.viewer.trace import Trace
from grasp_refine_apps.viewer.validating import PosedGrasp, protocol_of, record_direction, run_trial, world_cache
from grasp_refine_apps.viewer.worker import Control, Stopped


class Controller(Editor):
    """Commands on the open grasps."""

    def __init__(self, collection: Collection, settings: Any) -> None:
        """Show the first of the open grasps; `settings` are the options of refinement (`State.settings`)."""
        super().__init__(_state_with_grasp(State(collection, 0, *_grasp(collection, 0), settings), 0))
        self._world = world_cache()
        self._measuring = False
        """Whether measuring resumes when the worker is free."""

    # display

    def change_collection(self, collection: Collection, number: int = 0) -> None:
        """Show another collection: after an upload, or with more columns of the same grasps."""
        with self._lock:
            same_grasps = collection.problem is self._state.collection.problem
            if same_grasps and number == self._state.number:
                self._set(collection=collection)
                return
            self._interrupt()
            if not same_grasps:
                self._measuring = False
                if self._state.job is not None and self._state.job.kind == "measure":
                    self._halt()
            self._become(_state_with_grasp(replace(self._state, collection=collection), number))

    def show(self, number: int) -> None:
        """Show another grasp."""
        with self._lock:
            if 0 <= number < len(self._state.collection) and number != self._state.number:
                self.change_collection(self._state.collection, number)

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

            self._measuring = True
            self.run_job("measure", "measuring grasps", work)

    def stop(self) -> None:
        """Stop the running job; its intermediate result stays."""
        with self._lock:
            job = self._state.job
            self._measuring &= job is None or job.kind != "measure"
            super().stop()

    def _ended(self) -> None:
        if self._measuring:
            self.measure()

    def _keep_measures(self, found: Collection) -> None:
        """Keep new measures, also when measuring was stopped."""
        with self._lock:
            now = self._state.collection
            if now.problem is found.problem:
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
            if job is not None and job.kind != "measure":
                return
            # Invalid options are refused before anything starts.
            config = self._checked(self._state.settings.config)
            if config is None:
                return
            pose = self._state.standing
            nothing: dict[str, Any] = dict.fromkeys(("trace", "frame", "outcome", "motion", "picked", "trial"))
            self._become(replace(self._with_step(self._state, ""), pose=pose, **nothing))
            scene, targets = self._state.scene, self._state.targets
            name = self._state.collection.group(self._state.number)

            def work(control: Control) -> Change:
                def show(trace: Trace) -> None:
                    self._update_from_job(control, pose=trace.pose(len(trace) - 1), trace=trace)

                found = refine_grasp(self._hand_object(scene), scene, pose, targets, config, control, show, name)
                return lambda state: replace(state, pose=found.pose, trace=found.trace, outcome=found.outcome)

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

    def run_trial(self, name: str = "dexgraspbench", friction: float | None = None) -> None:
        """Simulate the shown grasp in MuJoCo."""
        with self._lock:
            protocol = self._checked(lambda: protocol_of(name, friction))
            if protocol is None:
                return
            number, grasp = self._state.number, self._posed_grasp(self._state.standing)

            def work(control: Control) -> Change:
                prepared = replace(grasp, prepared=self._hand_object(grasp.scene))
                found = run_trial(self._world, prepared, protocol, control)

                def change(state: State) -> State:
                    collection = state.collection
                    # Results of the collection are of the grasps as in their file.
                    if grasp.pose.same(_grasp(collection, number)[-1]):
                        collection = collection.with_trials({number: found})
                    return replace(state, trial=found, collection=collection)

                return change

            if self.run_job("validate", "testing in MuJoCo", work):
                # The simulated pose is the shown one, and stays shown: an earlier iteration replaces the present pose.
                state = replace(self._state, frame=None, motion=None, trial=None)
                if grasp.pose is not state.pose:
                    state = replace(self._with_step(state, ""), pose=grasp.pose)
                self._become(state)

    def record(self, direction: str) -> None:
        """Simulate one direction of the trial again, recorded for replay."""
        with self._lock:
            trial, grasp = self._state.trial, self._posed_grasp(self._state.pose)
            if trial is None or direction not in trial.directions:
                return

            def work(control: Control) -> Change:
                prepared = replace(grasp, prepared=self._hand_object(grasp.scene))
                found = record_direction(self._world, prepared, trial, direction, control)
                return lambda state: replace(state, motion=found, motion_frame=0)

            self.run_job("replay", f"recording the push along {direction}", work)

    def _posed_grasp(self, pose: Pose) -> PosedGrasp:
        """Return the shown grasp at a pose, as in its file with pregrasp and squeeze."""
        collection, number = self._state.collection, self._state.number
        row = collection.member[number : number + 1]
        group = collection.group(number)
        return PosedGrasp(self._state.scene, pose, group.grasps.select(row), row=int(group.rows[row[0]]))

    def show_motion_frame(self, frame: int) -> None:
        """Show a frame of the simulation."""
        with self._lock:
            motion = self._state.motion
            if motion is not None:
                self._set(motion_frame=min(max(frame, 0), len(motion) - 1))

    def show_motion(self, motion: ShownMotion) -> None:
        """Show a simulation from its start."""
        self._set(motion=motion, motion_frame=0)

    def end_motion(self) -> None:
        """Show the grasp again."""
        self._set(motion=None, motion_frame=0)


def _grasp(collection: Collection, number: int) -> tuple[Scene, Pose, Pose]:
    """Scene, input pose and pose in the file of a grasp."""
    scene = collection.scene(number)
    return scene, Pose(*collection.initial(number)), Pose(scene.T_world_root[0], scene.q[0])


def _state_with_grasp(state: State, number: int) -> State:
    """Return the state with another grasp of the same collection; display options and the running job stay."""
    scene, initial, pose = _grasp(state.collection, number)
    kept = ("settings", "job", "gizmo", "display", "side_by_side", "notice", "change")
    return State(
        collection=state.collection,
        number=number,
        scene=scene,
        initial=initial,
        pose=pose,
        targets=targets_of(scene),
        trial=state.collection.trials.get(number),
        **{name: getattr(state, name) for name in kept},
    )
