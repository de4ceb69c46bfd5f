"""Recorded motion of one grasp in one direction: a record, and a file that can be read without MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.npz_files import NpzFile, load_npz, save_npz
from grasp_refine.core.se3 import distances, transform_from_pose

if TYPE_CHECKING:
    import mujoco

SCHEMA = 1
"""Version of the layout of replay files."""
OBJECT = "object"
"""Name of the object's body and of its free joint."""
POSE_AXES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of the seven values of a free joint; a ball joint has the last four."""
CONTACT_GAP_M = 5e-4
"""Gap in metres below which the object is shown in contact."""


class Stage(IntEnum):
    """Stage of the trial in a frame."""

    CLOSE = 0
    SQUEEZE = 1
    PUSH = 2
    LIFT = 3

    @property
    def label(self) -> str:
        """Name of the stage in pictures and key frames."""
        return self.name.lower()


@dataclass(frozen=True, eq=False)
class Replay:
    """T frames of a simulation: from the pregrasp over the grasp and the squeeze to the end of the push or lift.

    The first frame is the start, before anything moved.
    """

    name: str
    """Name of the grasp, for people, such as "core_bottle 17"."""
    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    direction: str
    """Direction of the push, such as "+x", or "lift"."""
    protocol: str
    """Name of the `Protocol`."""
    reason: str
    """Result of the trial: "held", or the reason of the failure."""
    force: Float[np.ndarray, " 3"]
    """Force of the push at the object's centre of mass (3,), newtons, world frame; it acts during `Stage.PUSH`."""
    qpos_names: tuple[str, ...]
    """Names of the values of `qpos`: joints; of a free joint followed by x, y, z, qw, qx, qy or qz."""
    time: Float[np.ndarray, " T"]
    """Seconds since the hand began to close (T,), never decreasing."""
    stage: Int[np.ndarray, " T"]
    """A `Stage` for each frame (T,)."""
    qpos: Float[np.ndarray, "T nq"]
    """Joint values of hand and object (T, nq), metres, radians, quaternions."""
    qvel: Float[np.ndarray, "T nv"]
    """Velocities of hand and object (T, nv), so that a simulation can continue from any frame."""
    ctrl: Float[np.ndarray, "T nu"]
    """Set points of the actuators (T, nu) that were active when the frame was reached."""
    mocap_pos: Float[np.ndarray, "T 3"]
    """Target position of the hand's root (T, 3), metres, world frame; likewise."""
    mocap_quat: Float[np.ndarray, "T 4"]
    """Target orientation of the hand's root (T, 4), quaternions (w, x, y, z)."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.time)

    def set_frame(self, data: mujoco.MjData, frame: int) -> None:
        """Set the joint values and the root's target of a frame; poses of bodies follow by MuJoCo's kinematics."""
        data.qpos[:] = self.qpos[frame]
        data.mocap_pos[:], data.mocap_quat[:] = self.mocap_pos[frame], self.mocap_quat[frame]

    @property
    def object_pose(self) -> Float[np.ndarray, "T 7"]:
        """Pose of the object (T, 7), xyz wxyz, in the world.

        Raises:
            GraspRefineError: The motion has no free joint of that name.
        """
        names = [f"{OBJECT} {axis}" for axis in POSE_AXES]
        if not set(names) <= set(self.qpos_names):
            raise GraspRefineError(f"replay {self.name}: no free joint '{OBJECT}' among {', '.join(self.qpos_names)}")
        return self.qpos[:, [self.qpos_names.index(name) for name in names]]

    def lifted(self) -> Float[np.ndarray, "T 3"]:
        """Return target displacements of the hand (T, 3) since the squeeze, metres, world frame; zero before."""
        lift = self.stage == Stage.LIFT
        squeezed = max(int(lift.argmax()) - 1, 0)
        return np.where(lift[:, None], self.mocap_pos - self.mocap_pos[squeezed], 0.0)

    def displacement(self) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"]]:
        """Return the displacement (T,) in metres and the rotation (T,) in radians of the object from its target pose.

        That is its pose in the first frame or, while it is lifted, that pose moved like the hand.
        """
        T = transform_from_pose(self.object_pose)
        wanted = np.repeat(T[:1], len(T), axis=0)
        wanted[:, :3, 3] += self.lifted()
        return distances(wanted, T)

    def since_stage(self) -> Float[np.ndarray, " T"]:
        """Return seconds (T,) since the stage of each frame began, which is when the previous one ended."""
        begins = np.concatenate([[0], np.flatnonzero(np.diff(self.stage)) + 1])
        # The first frame of a stage is the result of its first step.
        started = np.maximum(begins - 1, 0)
        return self.time - self.time[started[np.searchsorted(begins, np.arange(len(self)), side="right") - 1]]

    def subsample(self, count: int) -> Int[np.ndarray, " k"]:
        """Return at most `count` frames, in order evenly spread, among them the first and the last of each stage."""
        last = np.flatnonzero(np.diff(self.stage))
        marks = np.unique(np.concatenate([[0], last, [len(self) - 1]]))
        even = np.linspace(0, len(self) - 1, min(count, len(self))).round().astype(int)
        # An even frame is left out where it would stand beside a mark.
        near = np.abs(even[:, None] - marks[None, :]).min(axis=1)
        spare = even[np.argsort(-near, kind="stable")][: max(count - len(marks), 0)]
        return np.unique(np.concatenate([marks, spare]))


def qpos_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return names of the values of qpos in a model; joints without a name get their number."""
    names: list[str] = []
    ends = [*model.jnt_qposadr[1:], model.nq]
    for number, (start, end) in enumerate(zip(model.jnt_qposadr, ends, strict=True)):
        name = model.joint(number).name or f"joint {number}"
        # One value for a hinge or a slide, four for a ball, seven for a free joint.
        axes = POSE_AXES[-(end - start) :]
        names.extend([name] if end - start == 1 else [f"{name} {axis}" for axis in axes])
    return tuple(names)


def object_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "n 3"]:
    """Return the points (n, 3) in the world at which the object is within `CONTACT_GAP_M` of anything else."""
    contact = data.contact
    of_object = model.geom_bodyid[contact.geom] == model.body(OBJECT).id
    return contact.pos[(of_object.sum(axis=1) == 1) & (contact.dist < CONTACT_GAP_M)].copy()


def check_replay(model: mujoco.MjModel, replay: Replay) -> None:
    """Refuse a replay that is not of this model.

    Raises:
        GraspRefineError: It is not; names joints that only one of them has.
    """
    names = qpos_names(model)
    if names != replay.qpos_names or replay.qvel.shape[1] != model.nv or model.nmocap != 1:
        strange = sorted(set(names) ^ set(replay.qpos_names))[:4]
        raise GraspRefineError(
            f"replay {replay.name}: is of another model" + (f", {', '.join(strange)} is not in both" if strange else "")
        )


_TEXT = ("name", "hand", "object", "direction", "protocol", "reason")


def save_replay(path: str | Path, replay: Replay) -> None:
    """Write a replay as an `.npz` without pickle; the file appears whole or not at all.

    Raises:
        GraspFileError: The file cannot be written.
    """
    save_npz(path, {"schema": SCHEMA, **{field.name: getattr(replay, field.name) for field in fields(Replay)}})


def load_replay(path: str | Path) -> Replay:
    """Return the replay in a file that `save_replay` wrote.

    Raises:
        GraspFileError: The file is missing, damaged, or not a replay; names the invalid entry.
    """
    npz = load_npz(path)
    missing = [name for name in ("schema", *(field.name for field in fields(Replay))) if name not in npz.entries]
    if missing:
        raise npz.error(f"not a replay, {', '.join(missing)} missing")
    schema = npz.numbers("schema")
    if not np.array_equal(schema, SCHEMA):
        raise npz.error(f"replay schema {npz.entries['schema']} is not known; this version reads {SCHEMA}")
    names = npz.names("qpos_names")
    time = _numbers_of_shape(npz, "time", (None,))
    frames = len(time)
    if frames == 0:
        raise npz.error("the replay has no frames")
    if (np.diff(time) < 0).any():
        raise npz.error("time must not fall")
    stage = _numbers_of_shape(npz, "stage", (frames,))
    known = [stage.value for stage in Stage]
    if not np.isin(stage, known).all():
        raise npz.error(f"stage must be among {', '.join(f'{s.value} ({s.label})' for s in Stage)}")
    return Replay(
        **{name: npz.name(name) for name in _TEXT},
        force=_numbers_of_shape(npz, "force", (3,)),
        qpos_names=names,
        time=time,
        stage=stage.astype(int),
        qpos=_numbers_of_shape(npz, "qpos", (frames, len(names))),
        qvel=_numbers_of_shape(npz, "qvel", (frames, None)),
        ctrl=_numbers_of_shape(npz, "ctrl", (frames, None)),
        mocap_pos=_numbers_of_shape(npz, "mocap_pos", (frames, 3)),
        mocap_quat=_numbers_of_shape(npz, "mocap_quat", (frames, 4)),
    )


def _numbers_of_shape(npz: NpzFile, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    value = npz.numbers(key)
    if value.ndim != len(shape) or any(b is not None and a != b for a, b in zip(value.shape, shape, strict=True)):
        wanted = " x ".join("any" if size is None else str(size) for size in shape)
        raise npz.error(f"{key} must be {wanted} numbers; it has shape {value.shape}")
    return value
