"""Recording of one grasp in one direction, simulated exactly as all grasps are."""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch

from grasp_refine.closing.motion import Motion
from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.validation.engines.mujoco.stepping import Conditions, StepCallback
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.replay.replay import Replay, Stage, qpos_names
from grasp_refine.validation.simulation import LIFT, close, push
from grasp_refine.validation.trials import Reason

STEPS_PER_FRAME = 5
"""Simulation steps per recorded frame: 50 frames in a second."""


def record(
    world: World,
    motion: Motion,
    direction: str,
    *,
    name: str,
    hand: str,
    conditions: Conditions | None = None,
    also: StepCallback = lambda batch: None,
) -> Replay | None:
    """Record one grasp from the pregrasp to the end of its trial, also when it fails; None if it cannot start.

    Args:
        world: Hand, object and protocol.
        motion: One grasp.
        direction: One of the protocol's directions, or "lift".
        name: Name of the grasp, for people.
        hand: Name of the hand.
        conditions: Pose of the object, and friction; by default from the grasp and the protocol.
        also: Called after every simulation step too; an exception that it raises ends the recording.
    """
    protocol = world.protocol
    frames: list[tuple[np.ndarray, ...]] = []
    stages: list[Stage] = []
    # The callback is called once before the first step.
    steps = -1

    def on_step(batch: Batch) -> None:
        nonlocal steps
        also(batch)
        steps += 1
        if steps == 0:
            # The set points of the first step are not set yet: these keep the hand at the pregrasp.
            batch.ctrl[0] = world.control @ batch.qpos[0, world.joints_at]
            if world.root_at is not None:
                root = batch.qpos[0, world.root_at : world.root_at + 7]
                batch.mocap_pos[0, 0], batch.mocap_quat[0, 0] = root[:3], root[3:]
        # A simulation that diverged has no valid frames from there on.
        if steps % STEPS_PER_FRAME == 0 and np.isfinite(batch.qpos).all() and np.isfinite(batch.qvel).all():
            closing = protocol.moves * protocol.steps_per_move
            after = Stage.LIFT if direction == LIFT[0] else Stage.PUSH
            stages.append(Stage.CLOSE if steps <= closing else Stage.SQUEEZE if steps <= 2 * closing else after)
            fields = (batch.time, batch.qpos, batch.qvel, batch.ctrl, batch.mocap_pos[:, 0], batch.mocap_quat[:, 0])
            frames.append(tuple(np.array(field[0]) for field in fields))

    conditions = Conditions.nominal(world, 1) if conditions is None else conditions
    closed = close(world, motion, conditions, threads=1, on_step=on_step)
    trials = push(world, closed, directions=(direction,), threads=1, to_the_end=True, on_step=on_step)
    if not frames:
        return None
    time, qpos, qvel, ctrl, mocap_pos, mocap_quat = (np.stack(column) for column in zip(*frames, strict=True))
    force = np.zeros(3)
    if direction in AXES:
        force = world.mass * protocol.acceleration * np.array(AXES[direction])
    return Replay(
        name=name,
        hand=hand,
        object=world.object,
        direction=direction,
        protocol=protocol.name,
        reason=Reason(trials.reason[0, 0]).label,
        force=force,
        qpos_names=qpos_names(world.model),
        time=time,
        stage=np.array(stages, dtype=int),
        qpos=qpos,
        qvel=qvel,
        ctrl=ctrl,
        mocap_pos=mocap_pos,
        mocap_quat=mocap_quat,
    )
