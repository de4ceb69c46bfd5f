"""Validation of one grasp in simulation, as by `refine-grasp validate`, with progress and interruption."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from mujoco.batch import Batch

from grasp_refine.closing.motion import Motion, closing_motion, motion_of
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions, StepCallback
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.robustness import offset_labels
from grasp_refine.validation.simulation import close, push
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.viewer.jobs.replaying import replay_recording
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.validated import TrialResult

MAX_HANDS, MAX_WORLDS = 2, 6
"""Numbers of cached hands, and of cached worlds of a hand, an object and a protocol."""

MAX_FRICTION = 10.0
"""Largest coefficient of friction; rubber on rubber has less than 2."""

STEPS_PER_REPORT = 20
"""Simulation steps between two reports of progress."""

PREPARING = "preparing the simulation"
"""Description of the first step of a trial."""


def protocol_of(name: str, friction: float | None = None) -> Protocol:
    """Return the protocol of a name, with another coefficient of sliding friction if one is given.

    Raises:
        GraspRefineError: there is none of that name, or the friction is out of range.
    """
    if name not in PROTOCOLS:
        raise GraspRefineError(f"no protocol '{name}': there are {', '.join(PROTOCOLS)}")
    if friction is not None and not 0 < friction <= MAX_FRICTION:
        raise GraspRefineError(f"friction must be above 0 and at most {MAX_FRICTION:g}, got {friction:g}")
    return PROTOCOLS[name].with_friction(friction)


MakeWorld = Callable[[Scene, Protocol], World]
"""Function that returns the world in which grasps of a scene are simulated; raises a GraspRefineError if it cannot."""


def world_cache() -> MakeWorld:
    """Return a function that makes worlds for MuJoCo, and keeps them and their hands for the next grasp."""
    make_hand = lru_cache(MAX_HANDS)(model_of)

    @lru_cache(MAX_WORLDS)
    def make_world(hand: Hand, obj: Object, task: Task) -> World:
        return build_world(make_hand(hand), obj, task)

    # Pushes act on an object in empty space.
    return lambda scene, protocol: make_world(
        scene.hand,
        scene.object,
        Task(protocol).over(scene.task).for_simulation if protocol.tabletop else Task(protocol),
    )


@dataclass(frozen=True, eq=False)
class PosedGrasp:
    """One grasp with the hand at a pose, to be simulated."""

    scene: Scene
    """Hand, object and table, and the one input grasp."""
    pose: Pose
    """Pose of the hand."""
    file_grasp: GraspSet | None = None
    """The one grasp as in its file; None: it is in none."""
    row: int = 0
    """Row of the grasp in its file, on which offsets of the object depend."""
    prepared: HandObject | None = None
    """Prepared hand and object; None: built when needed."""

    @staticmethod
    def of(collection: Collection, number: int, pose: Pose) -> PosedGrasp:
        """Return a grasp of a collection at a pose, as in its file with pregrasp and squeeze."""
        row, group = collection.member[number : number + 1], collection.group(number)
        return PosedGrasp(collection.scene(number), pose, group.grasps.select(row), row=int(group.rows[row[0]]))

    def with_bodies(self, prepare: Callable[[Hand, Object], HandObject]) -> PosedGrasp:
        """Return the grasp with its hand and object prepared for queries."""
        return replace(self, prepared=prepare(self.scene.hand, self.scene.object))

    def motion(self, check: Callable[[], None] = lambda: None) -> tuple[Motion, Mapping[str, str]]:
        """Return the closing motion, and the source of pregrasp and squeeze: stage -> "file" or "own".

        They come from the file if it has them and the pose is the file's; otherwise they are generated.

        Args:
            check: Called often; its exceptions end the work.
        """
        scene, pose, of_file = self.scene, self.pose, self.file_grasp
        is_file_pose = pose.same(Pose(scene.T_world_root[0], scene.q[0]))
        owners = {
            name: "file" if is_file_pose and of_file is not None and getattr(of_file, name) is not None else "own"
            for name in OTHER_STAGES
        }
        own = None
        if "own" in owners.values():
            posed = replace(scene, T_world_root=pose.T_object_root[None], q=pose.q[None])
            own = closing_motion(posed, self.prepared, lambda finished, iteration, loss: check())
        if own is not None and "file" not in owners.values():
            return own, owners
        assert of_file is not None  # some stages are of its file
        return motion_of(of_file, scene.hand, own), owners


def run_trial(make_world: MakeWorld, grasp: PosedGrasp, protocol: Protocol, control: Control) -> TrialResult:
    """Simulate one grasp.

    Args:
        make_world: Function of `world_cache`.
        grasp: The grasp.
        protocol: Protocol of the simulation.
        control: Receives the progress, and can stop the simulation.

    Raises:
        GraspRefineError: MuJoCo cannot make the hand or the world.
        Stopped: the job was stopped.
    """
    control.report(0.0, PREPARING)
    control.check()
    grasp = replace(grasp, scene=replace(grasp.scene, task=Task(protocol).over(grasp.scene.task)))
    world = make_world(grasp.scene, protocol)
    protocol = world.protocol
    control.check()
    motion, owners = grasp.motion(control.check)
    pushing = "lifting the object" if protocol.tabletop else f"pushing in {len(protocol.directions)} directions"
    observer = trial_observer(protocol, pushing, control)
    closed = close(world, motion, Conditions.nominal(world, 1), on_step=observer)
    trials = push(world, closed, on_step=observer)
    if protocol.noise.count:

        def report(done: float) -> None:
            control.report(done / protocol.noise.count, "trying it with the object elsewhere")
            control.check()

        label = offset_labels(world, motion, numbers=np.array([grasp.row]), progress=report)
        trials = replace(trials, label=label)
    control.report(1.0, "done")
    return TrialResult.of(trials, 0, protocol, owners, motion)


def record_direction(
    make_world: MakeWorld, grasp: PosedGrasp, trial: TrialResult, direction: str, control: Control
) -> Recording:
    """Simulate one direction again, this time recorded.

    Args:
        make_world: Function of `world_cache`.
        grasp: The grasp; its motion is only needed where the result has none.
        trial: Result of the trial.
        direction: One of its directions.
        control: Receives the progress, and can stop the simulation.

    Raises:
        GraspRefineError: no such direction, or the trial cannot start, so that nothing can be seen.
        Stopped: the job was stopped.
    """
    if direction not in trial.directions:
        raise GraspRefineError(f"direction '{direction}': there are {', '.join(trial.directions)}")
    control.report(0.0, PREPARING)
    control.check()
    hand, protocol = grasp.scene.hand, trial.protocol
    world = make_world(grasp.scene, protocol)
    motion = grasp.motion(control.check)[0] if trial.motion is None else trial.motion
    pushing = "lifting the object" if protocol.tabletop else f"pushing along {direction}"
    observer = trial_observer(protocol, pushing, control)
    replay = record(world, motion, direction, name=grasp.scene.object.name, hand=hand.name, also=observer)
    if replay is None:
        raise GraspRefineError(f"nothing to watch: {trial.words(trial.results[0])}")
    return replay_recording(hand, world.hand, replay, world.model)


def trial_observer(protocol: Protocol, pushing: str, control: Control) -> StepCallback:
    """Return an observer of the steps of one trial, which reports progress, and checks `control` at each step.

    Args:
        protocol: That of the trial.
        pushing: Description after the hand has closed.
        control: Receives the progress; can end the trial.
    """
    move = protocol.moves * protocol.steps_per_move
    total = 2 * move + protocol.checks * protocol.steps_per_check
    # The start is observed before the first step.
    steps = -1

    def observe(batch: Batch) -> None:
        nonlocal steps
        control.check()
        steps += 1
        if steps % STEPS_PER_REPORT == 0:
            what = "closing the hand" if steps <= move else "squeezing" if steps <= 2 * move else pushing
            control.report(min(steps / total, 1.0), what)

    return observe
