"""The controller: commands in, states out. It knows no viser.

Commands return at once, can come from any thread and never raise for what a user does: they set a notice. What takes
long is done by one worker thread; whoever listens is told of every new state.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.errors import GraspRefineError
from grasp_refine.grasps import GraspSet
from grasp_refine.hand_object import HandObject
from grasp_refine.scene import Scene
from grasp_refine.se3 import inverse

from .collection import Collection
from .history import History, Steered
from .marks import Mark
from .measuring import measured, unmeasured
from .pose import Pose
from .proved import Proved
from .proving import Prover, protocol_of, prove, watch
from .refining import nearest_targets, refined, targets_of
from .shown_motion import ShownMotion
from .state import Gizmo, Job, JobKind, Notice, State
from .target import Target
from .trace import Trace
from .worker import Control, Stopped, Worker

Change = Callable[[State], State]
"""Makes the next state of the present one."""


class Controller:
    """What can be done with what is open."""

    def __init__(self, collection: Collection, settings: Any, proofs: Mapping[int, Proved] | None = None) -> None:
        """Show the first grasp.

        Args:
            collection: What is open.
            settings: The options of refinement (`State.settings`).
            proofs: What simulation said of the grasps, by number.
        """
        self._lock = threading.RLock()
        self._listeners: list[Callable[[State], None]] = []
        self._worker, self._history = Worker(), History()
        self._control: Control | None = None
        self._prepared: HandObject | None = None
        self._prover = Prover()
        self._notices = 0
        self._state = _opened(State(collection, 0, *_grasp(collection, 0), settings, proofs=proofs or {}), 0)

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def listen(self, listener: Callable[[State], None]) -> None:
        """Tell `listener` of every new state; it must return at once and call no command."""
        with self._lock:
            self._listeners.append(listener)

    def close(self) -> None:
        """Stop what is being done, and the worker."""
        self.stop()
        self._worker.close()

    # what is shown

    def change_collection(self, collection: Collection, number: int = 0) -> None:
        """Show something else: after an upload, or when more is known of the same grasps."""
        with self._lock:
            same_grasps = collection.problem is self._state.collection.problem
            if same_grasps and number == self._state.number:
                self._set(collection=collection)
                return
            self.stop()
            self._history.clear()
            now = replace(self._state, collection=collection, proofs=self._state.proofs if same_grasps else {})
            self._become(_opened(now, number))

    def show(self, number: int) -> None:
        """Show another grasp."""
        if 0 <= number < len(self._state.collection) and number != self._state.number:
            self.change_collection(self._state.collection, number)

    def set_showing(self, **changes: Any) -> None:
        """Show or hide parts of the scene: fields of `Showing`."""
        with self._lock:
            self._set(showing=replace(self._state.showing, **changes))

    def set_side_by_side(self, beside: bool) -> None:
        """Draw the grasp as it came beside that which is shown, or not."""
        self._set(side_by_side=beside)

    def say(self, text: str, bad: bool = False) -> None:
        """Tell the user something."""
        with self._lock:
            self._notices += 1
            self._set(notice=Notice(self._notices, text, bad))

    def mark(self, number: int, mark: Mark) -> None:
        """Say what one thinks of a grasp: "good", "bad" or "" for nothing; kept beside the file."""
        with self._lock:
            collection = self._state.collection.with_mark(number, mark)
            self._set(collection=collection)
            try:
                collection.save_marks(number)
            except GraspRefineError as error:
                self.say(f"{error}; the mark is kept until the viewer ends", bad=True)

    def measure(self) -> None:
        """Find out what the grasps are worth of which no file tells; whatever the user wants done comes first."""
        with self._lock:
            collection = self._state.collection
            if not unmeasured(collection).any():
                return

            def work(control: Control) -> None:
                measured(collection, control.tell, control.check, self._know)

            self.run_job("measure", "measuring grasps", work)

    def _know(self, found: Collection) -> None:
        """Keep what was measured, also when measuring was stopped."""
        with self._lock:
            now = self._state.collection
            if now.problem is found.problem:
                self._set(collection=now.with_columns(*found.columns.values()))

    # refining

    def set_settings(self, settings: Any) -> None:
        """Refine with other options from the next start on."""
        self._set(settings=settings)

    def start(self, paused: bool = False) -> None:
        """Refine what is shown; go on if that is paused."""
        with self._lock:
            job = self._state.job
            if job is not None and job.kind == "refine":
                if job.paused and not paused:
                    self._hold(False)
                return
            if job is not None and job.kind != "measure":
                return
            try:
                # Options that cannot be are refused before anything begins.
                config = self._state.settings.config()
            except GraspRefineError as error:
                self.say(str(error), bad=True)
                return
            self._push("")
            pose = self._state.shown
            self._set(pose=pose, trace=None, frame=None, outcome=None, motion=None, picked=None, proof=None)
            scene, targets = self._state.scene, self._state.targets
            name = self._state.collection.group(self._state.number)

            def work(control: Control) -> Change:
                def show(trace: Trace) -> None:
                    self._if_wanted(control, pose=trace.pose(len(trace) - 1), trace=trace)

                found = refined(self._hand_object(), scene, pose, targets, config, control, show, name)
                return lambda state: replace(state, pose=found.pose, trace=found.trace, outcome=found.outcome)

            self.run_job("refine", "refining", work)
            if paused and self._control is not None:
                self._hold(True)

    def pause(self) -> None:
        """Hold the refinement, or let it go on."""
        with self._lock:
            job = self._state.job
            if job is not None and job.kind == "refine":
                self._hold(not job.paused)

    def step_once(self) -> None:
        """One iteration: begins a refinement that waits after each of them, or lets a waiting one do the next."""
        with self._lock:
            if self._state.job is None or self._state.job.kind != "refine":
                self.start(paused=True)
            elif not self._state.job.paused:
                self._hold(True)
            if self._control is not None:
                self._control.step()

    def stop(self) -> None:
        """End what is being done; what it has come to stays."""
        with self._lock:
            control, self._control = self._control, None
            if control is not None:
                control.stop()
            if self._state.job is not None:
                self._set(job=None)

    def reset(self) -> None:
        """Put hand, object and targets back to where they were when the grasp was opened, before any refinement."""
        with self._lock:
            self.stop()
            self._push("")
            now = self._state
            self._set(
                pose=now.initial,
                targets=targets_of(now.scene),
                T_world_object=np.eye(4),
                trace=None,
                frame=None,
                outcome=None,
                proof=None,
                motion=None,
                picked=None,
            )

    def scrub(self, frame: int | None) -> None:
        """Look at an iteration; None: at where the hand is now."""
        with self._lock:
            trace = self._state.trace
            if trace is not None:
                frame = None if frame is None else min(max(frame, 0), len(trace) - 1)
                self._set(frame=frame, motion=None)

    # steering

    def set_gizmo(self, gizmo: Gizmo) -> None:
        """What can be dragged."""
        self._set(gizmo=gizmo)

    def move_root(self, T_object_root: np.ndarray) -> None:
        """Put the base link of the hand elsewhere (4, 4), object frame."""
        with self._lock:
            self._steer("hand", pose=Pose(np.array(T_object_root, dtype=float), self._state.shown.q))

    def set_joint(self, index: int, value: float) -> None:
        """Set one joint, within its limits; radians or metres."""
        with self._lock:
            hand, shown = self._state.collection.hand, self._state.shown
            q = shown.q.copy()
            q[index] = np.clip(value, hand.lower[index], hand.upper[index])
            self._steer(f"joint {index}", pose=Pose(shown.T_object_root, q))

    def move_object(self, T_world_object: np.ndarray) -> None:
        """Put the object elsewhere (4, 4) while the hand stays where it is drawn."""
        with self._lock:
            now, T = self._state, np.array(T_world_object, dtype=float)
            T_hand = inverse(T) @ now.T_world_object @ now.shown.T_object_root
            self._steer("object", pose=Pose(T_hand, now.shown.q), T_world_object=T)

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
        if self._state.picking:
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
                found = nearest_targets(self._hand_object(), now.scene, now.shown, now.settings.config())
            except GraspRefineError as error:
                self.say(str(error), bad=True)
                return
            if not found:
                self.say("no link is within reach of the object: move the hand closer", bad=True)
            else:
                self._steer("", targets=found)

    # proving

    def prove(self, setting: str = "force-closure", friction: float | None = None) -> None:
        """Test the grasp that is shown in MuJoCo."""
        with self._lock:
            try:
                protocol = protocol_of(setting, friction)
            except GraspRefineError as error:
                self.say(str(error), bad=True)
                return
            now = self._state
            pose, scene, came = now.shown if now.motion is None else now.pose, now.scene, _came(now)

            def work(control: Control) -> Change:
                prepared, tell, check = self._hand_object(), control.tell, control.check
                found = prove(self._prover, scene, pose, protocol, came=came, prepared=prepared, tell=tell, check=check)
                return lambda state: replace(state, proof=found)

            if self.run_job("prove", "testing in MuJoCo", work):
                # What is proved is what was shown, and stays so.
                self._set(pose=pose, frame=None, motion=None, proof=None)

    def watch(self, direction: str) -> None:
        """Simulate one direction of the proof once more, to be looked at."""
        with self._lock:
            now, proof = self._state, self._state.proof
            if proof is None or direction not in proof.directions:
                return
            pose, scene, came = now.pose, now.scene, _came(now)

            def work(control: Control) -> Change:
                prepared, tell, check = self._hand_object(), control.tell, control.check
                found = watch(
                    self._prover, scene, pose, proof, direction, came=came, prepared=prepared, tell=tell, check=check
                )
                return lambda state: replace(state, motion=found, motion_frame=0)

            self.run_job("replay", f"recording the push along {direction}", work)

    def show_motion_frame(self, frame: int) -> None:
        """Look at a frame of the simulation."""
        with self._lock:
            motion = self._state.motion
            if motion is not None:
                self._set(motion_frame=min(max(frame, 0), len(motion) - 1))

    def show_motion(self, motion: ShownMotion) -> None:
        """Look at a simulation, from its start."""
        self._set(motion=motion, motion_frame=0)

    def end_motion(self) -> None:
        """Look at the grasp again."""
        self._set(motion=None, motion_frame=0)

    # jobs

    def run_job(self, kind: JobKind, what: str, work: Callable[[Control], Change | None]) -> bool:
        """Do something long in the worker, unless something else is being done; measuring gives way.

        Returns whether it will be done.

        Args:
            kind: What it is for.
            what: What is being done, for people.
            work: Gets a `Control`, whose `check` it calls often; returns what it changes.
        """
        with self._lock:
            if self._state.job is not None and self._state.job.kind != "measure":
                return False
            self.stop()
            control = Control(lambda share, now: self._if_wanted(control, share=share, what=now))
            self._control = control
            self._set(job=Job(kind, what))
            self._worker.do(lambda: self._work(control, work), lambda error: self._failed(control, error))
            return True

    def _work(self, control: Control, work: Callable[[Control], Change | None]) -> None:
        if control.stopped:
            return
        try:
            change = work(control)
        except GraspRefineError as error:
            if not control.stopped:
                self._failed(control, error)
            return
        with self._lock:
            if control.stopped:
                raise Stopped
            self._control = None
            self._become(replace(self._state if change is None else change(self._state), job=None))

    def _failed(self, control: Control, error: BaseException) -> None:
        """A job could not be done."""
        with self._lock:
            if control.stopped:
                return
            self._control = None
            self._set(job=None)
            known = isinstance(error, GraspRefineError)
            self.say(str(error) if known else f"this failed ({type(error).__name__}: {error}); see the terminal", True)

    def _if_wanted(self, control: Control, *, share: float | None = None, what: str = "", **changes: Any) -> None:
        """Change the state on behalf of a job, unless it was stopped meanwhile."""
        with self._lock:
            job = self._state.job
            if control.stopped or control is not self._control or job is None:
                return
            if what:
                changes["job"] = replace(job, what=what, share=share)
            self._set(**changes)

    def _hold(self, paused: bool) -> None:
        if self._control is not None and self._state.job is not None:
            self._control.pause(paused)
            self._set(job=replace(self._state.job, paused=paused))

    def _hand_object(self) -> HandObject:
        """What refinement and simulation need of the present hand and object, built once; for the worker."""
        scene, prepared = self._state.scene, self._prepared
        if prepared is None or prepared.hand is not scene.hand or prepared.object is not scene.object:
            self._prepared = prepared = HandObject.of(scene)
        return prepared

    # states

    def _steered(self) -> Steered:
        now = self._state
        return Steered(now.shown if now.motion is None else now.pose, now.targets, now.T_world_object)

    def _push(self, what: str) -> None:
        """Remember how things are, before something changes them."""
        self._history.push(self._steered(), what)

    def _steer(self, what: str, **changes: Any) -> None:
        """A change by the user, which can be undone; what is being refined or watched ends."""
        job = self._state.job
        if job is not None and job.kind in ("refine", "prove", "replay"):
            self.stop()
        self._push(what)
        pose = self._state.shown if self._state.motion is None else self._state.pose
        self._set(**{"pose": pose, "frame": None, "motion": None, "proof": None, "outcome": None, **changes})

    def _exchange(self, take: Callable[[Steered], Steered | None]) -> None:
        with self._lock:
            found = take(self._steered())
            if found is None:
                return
            self.stop()
            self._set(
                pose=found.pose,
                targets=found.targets,
                T_world_object=found.T_world_object,
                frame=None,
                motion=None,
                proof=None,
                outcome=None,
                picked=None,
            )

    def _set(self, **changes: Any) -> None:
        with self._lock:
            self._become(replace(self._state, **changes))

    def _become(self, state: State) -> None:
        """Make a state the present one, and tell everybody."""
        with self._lock:
            history = self._history
            self._state = replace(
                state, can_undo=history.can_undo, can_redo=history.can_redo, change=self._state.change + 1
            )
            for listener in self._listeners:
                listener(self._state)


def _came(state: State) -> GraspSet:
    """The grasp that is shown, as its file has it, with pregrasp and squeeze."""
    collection, number = state.collection, state.number
    return collection.group(number).grasps.select(collection.member[number : number + 1])


def _grasp(collection: Collection, number: int) -> tuple[Scene, Pose, Pose]:
    """Scene, hand as it came, and hand as the file has it, of a grasp."""
    scene = collection.scene(number)
    return scene, Pose(*collection.initial(number)), Pose(scene.T_world_root[0], scene.q[0])


def _opened(state: State, number: int) -> State:
    """The state when a grasp of the same collection is opened; how things are looked at stays."""
    scene, initial, pose = _grasp(state.collection, number)
    looks = ("settings", "proofs", "gizmo", "showing", "side_by_side", "notice", "change")
    return State(
        collection=state.collection,
        number=number,
        scene=scene,
        initial=initial,
        pose=pose,
        targets=targets_of(scene),
        proof=state.proofs.get(number),
        **{name: getattr(state, name) for name in looks},
    )
