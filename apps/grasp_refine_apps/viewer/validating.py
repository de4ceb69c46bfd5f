"""Whether one grasp holds: simulated as `refine-grasp validate` does, told in words, and stopped when asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache

from mujoco.batch import Batch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.hand_model import HandModel
from grasp_refine.validation.motion import Motion, closing, motion_of
from grasp_refine.validation.protocol import SETTINGS, Protocol
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.simulation import close, push
from grasp_refine.validation.stepping import Conditions, Watch
from grasp_refine.validation.validate import model_of
from grasp_refine.validation.world import World, build_world
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.shown_motion import ShownMotion, shown_motion
from grasp_refine_apps.viewer.validated import TrialResult

HANDS, WORLDS = 2, 6
"""How many hands, and worlds of a hand, an object and a protocol, are kept ready."""

MOST_FRICTION = 10.0
"""Largest coefficient of friction; rubber on rubber has less than 2."""

TOLD = 20
"""Simulation steps between two words about progress."""

Tell = Callable[[float, str], None]
"""Is told which share is done, 0 to 1, and what is being done."""

Check = Callable[[], None]
"""Raises when the work is to end here; is called every few milliseconds."""


def protocol_of(setting: str, friction: float | None = None) -> Protocol:
    """The protocol of that name; with another coefficient of sliding friction, if one is given.

    Raises:
        GraspRefineError: there is none of that name, or friction cannot be so much.
    """
    if setting not in SETTINGS:
        raise GraspRefineError(f"setting '{setting}': there are {', '.join(SETTINGS)}")
    if friction is not None and not 0 < friction <= MOST_FRICTION:
        raise GraspRefineError(f"friction must be above 0 and at most {MOST_FRICTION:g}, got {friction:g}")
    return SETTINGS[setting].slippery(friction)


class Validator:
    """Hands and worlds as MuJoCo takes them, made when they are first asked for and kept for the next grasp."""

    def __init__(self) -> None:
        """Nothing is made yet."""
        self._model = lru_cache(HANDS)(model_of)
        self._world = lru_cache(WORLDS)(self._built)

    def model(self, hand: Hand) -> HandModel:
        """The hand.

        Raises:
            HandError: its MJCF cannot be used.
        """
        return self._model(hand)

    def world(self, scene: Scene, protocol: Protocol) -> World:
        """The world in which grasps of a scene are simulated.

        Raises:
            GraspRefineError: MuJoCo cannot make the hand or the world.
        """
        return self._world(scene.hand, scene.object, protocol, scene.table if protocol.tabletop else None)

    def _built(self, hand: Hand, obj: Object, protocol: Protocol, table: Plane | None) -> World:
        return build_world(self._model(hand), obj, protocol, table)


def run_trial(
    validator: Validator,
    scene: Scene,
    pose: Pose,
    protocol: Protocol,
    *,
    came: GraspSet | None = None,
    prepared: HandObject | None = None,
    tell: Tell = lambda share, what: None,
    check: Check = lambda: None,
) -> TrialResult:
    """What simulation says of one pose of the hand.

    Args:
        validator: Keeps what was compiled.
        scene: Hand, object and table, and the one grasp as it came.
        pose: Where the hand is.
        protocol: How it is simulated.
        came: As for `stages`.
        prepared: Of this hand and object; None: built here.
        tell: Is told how far it is.
        check: Its exceptions end the work.

    Raises:
        GraspRefineError: MuJoCo cannot make the hand or the world.
    """
    tell(0.0, "preparing the simulation")
    check()
    world = validator.world(scene, protocol)
    check()
    motion, owners = stages(scene, pose, came=came, prepared=prepared, check=check)
    pushing = "lifting the object" if protocol.tabletop else f"pushing in {len(protocol.directions)} directions"
    seen = watcher(protocol, pushing, tell, check)
    closed = close(world, motion, Conditions.nominal(world, 1), watch=seen)
    trials = push(world, closed, watch=seen)
    tell(1.0, "done")
    return TrialResult.of(trials, 0, protocol, owners, motion)


def watch(
    validator: Validator,
    scene: Scene,
    pose: Pose,
    proved: TrialResult,
    direction: str,
    *,
    came: GraspSet | None = None,
    prepared: HandObject | None = None,
    tell: Tell = lambda share, what: None,
    check: Check = lambda: None,
) -> ShownMotion:
    """The simulation of one direction again, this time recorded.

    Args:
        validator: Keeps what was compiled.
        scene: As for `run_trial`.
        pose: As for `run_trial`; only needed where the proof does not say how the hand closed.
        proved: What simulation said.
        direction: One of its directions.
        came: As for `stages`.
        prepared: Of this hand and object; None: built here.
        tell: Is told how far it is.
        check: Its exceptions end the work.

    Raises:
        GraspRefineError: no such direction, or the trial cannot start, so that nothing can be seen.
    """
    if direction not in proved.directions:
        raise GraspRefineError(f"direction '{direction}': there are {', '.join(proved.directions)}")
    tell(0.0, "preparing the simulation")
    check()
    world = validator.world(scene, proved.protocol)
    motion = proved.motion
    if motion is None:
        motion, _ = stages(scene, pose, came=came, prepared=prepared, check=check)
    pushing = "lifting the object" if proved.protocol.tabletop else f"pushing along {direction}"
    replay = record(
        world,
        motion,
        direction,
        name=scene.object.name,
        hand=scene.hand.name,
        also=watcher(proved.protocol, pushing, tell, check),
    )
    if replay is None:
        raise GraspRefineError(f"nothing to watch: {proved.words(proved.tried[0])}")
    return shown_motion(scene.hand, validator.model(scene.hand), replay, world.model)


def stages(
    scene: Scene,
    pose: Pose,
    *,
    came: GraspSet | None = None,
    prepared: HandObject | None = None,
    check: Check = lambda: None,
) -> tuple[Motion, Mapping[str, str]]:
    """How the hand closes to a pose, and whose pregrasp and squeeze these are: stage -> "file" or "own".

    Args:
        scene: Hand, object and table, and the one grasp as it came.
        pose: Where the hand is.
        came: The one grasp as its file has it. Pregrasp and squeeze are those of the file if the pose is the one that
            came, and the file has them; otherwise they are our own.
        prepared: Of this hand and object; None: built here.
        check: Its exceptions end the work.
    """
    as_it_came = pose.same(Pose(scene.T_world_root[0], scene.q[0]))
    owners = {
        name: "file" if as_it_came and came is not None and getattr(came, name) is not None else "own"
        for name in OTHER_STAGES
    }
    own = None
    if "own" in owners.values():
        posed = replace(scene, T_world_root=pose.T_object_root[None], q=pose.q[None])
        own = closing(posed, prepared, lambda finished, iteration, loss: check())
    if own is not None and "file" not in owners.values():
        return own, owners
    assert came is not None  # some stages are of its file
    return motion_of(came, scene.hand, own), owners


def watcher(protocol: Protocol, pushing: str, tell: Tell, check: Check) -> Watch:
    """What sees the steps of one trial: tells how far it is, and calls `check` at each of them.

    Args:
        protocol: That of the trial.
        pushing: What is said after the hand has closed.
        tell: Is told how far it is.
        check: Its exceptions end the trial.
    """
    move = protocol.moves * protocol.steps_per_move
    total = 2 * move + protocol.checks * protocol.steps_per_check
    # The start is seen before the first step.
    steps = -1

    def see(batch: Batch) -> None:
        nonlocal steps
        check()
        steps += 1
        if steps % TOLD == 0:
            what = "closing the hand" if steps <= move else "squeezing" if steps <= 2 * move else pushing
            tell(min(steps / total, 1.0), what)

    return see
