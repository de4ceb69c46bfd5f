"""Recordings of replays: poses of hand and object in each frame, as MuJoCo had them."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import fields
from math import degrees
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse, transform_from_pose
from grasp_refine.hands.files.mujoco_messages import unlogged
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.world import HAND, SCENE
from grasp_refine.validation.replay.replay import POSE_AXES, Replay, Stage, check_replay, object_contacts
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.model.recording import Recording

FRAME_RATE_HZ = 50
"""Maximum frame rate in hertz."""

MAX_DISPLACEMENT_M = 0.3
"""Displacement of the object in metres at which a motion ends: a lost one flies for many more."""


def replay_recording(
    hand: Hand, hand_model: HandModel, replay: Replay, model: mujoco.MjModel | None = None
) -> Recording:
    """Return a replay as a recording of at most `FRAME_RATE_HZ` frames per second.

    Joint values in MuJoCo are matrix q + offset, and values of joints that mimic others may differ a little from that:
    q is the least-squares solution.

    Args:
        hand: The hand.
        hand_model: Its MuJoCo model, made from the file that was simulated.
        replay: The recording.
        model: The world of the recording, for contacts; None: contacts are not known.

    Raises:
        GraspRefineError: the replay is of another hand, or of another model.
    """
    if model is not None:
        check_replay(model, replay)
    frames = _shown_frames(replay)
    T_world_object = transform_from_pose(replay.object_pose)
    T_start_world = inverse(T_world_object[0])
    displacement, angle = replay.displacement()
    stage, held = replay.stage[frames], replay.reason == Reason.HELD.label
    # A trial is judged at its checks; in between the object may swing farther, and come back.
    beyond = (displacement[frames] >= Protocol.farthest) | (angle[frames] >= Protocol.steepest)
    lost = np.logical_or.accumulate(beyond & (not held))
    stages = {
        Stage.CLOSE: "the hand closes",
        Stage.SQUEEZE: "the hand squeezes",
        Stage.PUSH: f"pushed along {replay.direction}",
        Stage.LIFT: "lifted off the table",
    }
    since = replay.since_stage()
    texts = (
        f"{stages[Stage(replay.stage[k])]}, {since[k]:.2f} s: the object has moved {1e3 * displacement[k]:.1f} mm and "
        f"turned {degrees(angle[k]):.1f}°{'; it is lost' if is_lost else ''}"
        for k, is_lost in zip(frames, lost, strict=True)
    )
    return Recording(
        title=f"simulation, {replay.direction}, {replay.reason}",
        T_root=T_start_world @ _roots(hand_model, replay)[frames],
        q=_joint_values(hand, hand_model, replay)[frames],
        time=replay.time[frames],
        texts=tuple(texts),
        T_object=T_start_world @ T_world_object[frames],
        T_bodies={name: T_start_world @ T[frames] for name, T in _body_poses(replay)},
        lost=lost,
        pushed=(stage == Stage.PUSH) & bool(np.any(replay.force)),
        force=T_start_world[:3, :3] @ replay.force,
        contacts=() if model is None else _contacts(model, replay, frames, T_start_world),
        succeeds=held,
        travels=replay.direction in LIFT,
    )


def is_replay(path: Path) -> bool:
    """Return whether a file is a replay of `refine-grasp validate --replays`; only its list of entries is read."""
    if path.suffix != ".npz":
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile):
        return False
    return {field.name for field in fields(Replay)} <= entries


def _shown_frames(replay: Replay) -> Int[np.ndarray, " k"]:
    """Indices of the shown frames: at most `FRAME_RATE_HZ` per second, and none after the object is far away."""
    displacement, _ = replay.displacement()
    far = displacement > MAX_DISPLACEMENT_M
    end = int(far.argmax()) + 1 if far.any() else len(replay)
    kept, last = [], -np.inf
    for frame, time in enumerate(replay.time[:end]):
        if time >= last + 1 / FRAME_RATE_HZ - 1e-6:
            kept.append(frame)
            last = time
    # The last frame is always shown.
    return np.unique([*kept, end - 1])


def _column(replay: Replay, name: str) -> Float[np.ndarray, " T"]:
    """Values (T,) of the joint or coordinate `name`.

    Raises:
        GraspRefineError: there are none.
    """
    if name not in replay.qpos_names:
        joints = [other.removeprefix(f"{HAND}/") for other in replay.qpos_names if other.startswith(f"{HAND}/")]
        raise GraspRefineError(
            f"the replay is of hand '{replay.hand}', and of another one than this: it has no "
            f"'{name.removeprefix(f'{HAND}/')}'; its joints are {', '.join(joints) or 'none'}"
        )
    return replay.qpos[:, replay.qpos_names.index(name)]


def _roots(hand_model: HandModel, replay: Replay) -> Float[np.ndarray, "T 4 4"]:
    """Poses of the hand's base link (T, 4, 4) in the world."""
    pose = np.stack([_column(replay, f"{HAND} {axis}") for axis in POSE_AXES], axis=1)
    return transform_from_pose(pose) @ inverse(hand_model.T_base_root)


def _body_poses(replay: Replay) -> Iterator[tuple[str, Float[np.ndarray, "T 4 4"]]]:
    """Yield the movable bodies around the object: name, and poses (T, 4, 4) in the world."""
    last = f" {POSE_AXES[-1]}"
    for name in replay.qpos_names:
        if name.startswith(SCENE) and name.endswith(last):
            body = name.removesuffix(last)
            pose = np.stack([_column(replay, f"{body} {axis}") for axis in POSE_AXES], axis=1)
            yield body.removeprefix(SCENE), transform_from_pose(pose)


def _joint_values(hand: Hand, hand_model: HandModel, replay: Replay) -> Float[np.ndarray, "T n"]:
    """Joint values (T, n) of the hand that are nearest to MuJoCo's."""
    values = np.stack([_column(replay, f"{HAND}/{joint}") for joint in hand_model.joints], axis=1)
    # Joints that follow on a curve say nothing that the joints they follow do not.
    curves = hand_model.curves
    straight = np.ones(len(hand_model.joints), dtype=bool) if curves is None else ~curves.curved
    q = (values - hand_model.offset)[:, straight] @ np.linalg.pinv(hand_model.matrix[straight]).T
    # A joint with equal limits is fixed in MuJoCo.
    still = ~(hand_model.matrix != 0).any(axis=0)
    q[:, still] = hand.lower[still]
    return q


def _contacts(
    model: mujoco.MjModel, replay: Replay, frames: Int[np.ndarray, " k"], T_start_world: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "_ 3"], ...]:
    """Contact points of the object in each frame, (c, 3)."""
    data = mujoco.MjData(model)
    found = []
    for frame in frames:
        replay.set_frame(data, frame)
        with unlogged():
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
        found.append(object_contacts(model, data) @ T_start_world[:3, :3].T + T_start_world[:3, 3])
    return tuple(found)
