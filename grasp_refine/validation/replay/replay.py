"""The recorded motion of one grasp, tried in one direction: a value, and a file that needs no MuJoCo to be read."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.npz_files import NpzFile, load_npz, save_npz
from grasp_refine.core.se3 import distances, transform_from_pose

if TYPE_CHECKING:
    import mujoco

SCHEMA = 1
"""Version of the layout of replay files."""
OBJECT = "object"
"""Name of the object's body and of its free joint, wherever a hand holds one."""
POSE_AXES = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""What the seven numbers of a free joint are called; a ball joint has the last four."""


class Stage(IntEnum):
    """What was being done to the hand or the object in a frame."""

    CLOSE = 0
    SQUEEZE = 1
    PUSH = 2
    LIFT = 3

    @property
    def label(self) -> str:
        """As pictures and key frames say it."""
        return self.name.lower()


@dataclass(frozen=True, eq=False)
class Replay:
    """T frames of a simulation: from the pregrasp over the grasp and the squeeze to the end of the push or lift.

    The first frame is the start, before anything moved.
    """

    name: str
    """What it shows, as a person would say it, such as "core_bottle 17"."""
    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    direction: str
    """In which direction the object was pushed, such as "+x", or "lift"."""
    setting: str
    """Name of the `Protocol`."""
    reason: str
    """How the trial ended: "held", or why it failed."""
    force: Float[np.ndarray, " 3"]
    """The push at the object's centre of mass, in newtons, world frame; it acts during `Stage.PUSH`."""
    qpos_names: tuple[str, ...]
    """What the values of `qpos` are: names of joints, those of a free joint followed by x, y, z, qw, qx, qy or qz."""
    time: Float[np.ndarray, " T"]
    """Seconds since the hand began to close (T,), never falling."""
    stage: Int[np.ndarray, " T"]
    """A `Stage` for each frame (T,)."""
    qpos: Float[np.ndarray, "T nq"]
    """Joint values of hand and object (T, nq), metres, radians, quaternions."""
    qvel: Float[np.ndarray, "T nv"]
    """Their velocities (T, nv), so that a simulation can go on from any frame."""
    ctrl: Float[np.ndarray, "T nu"]
    """Set points of the actuators (T, nu) that were in force when the frame was reached."""
    mocap_pos: Float[np.ndarray, "T 3"]
    """Where the root of the hand was to be (T, 3), metres, world frame; likewise."""
    mocap_quat: Float[np.ndarray, "T 4"]
    """How it was to be turned (T, 4)."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.time)

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
        """How far the hand was to be moved (T, 3) since the squeeze, metres, world frame; zero before the lift."""
        lift = self.stage == Stage.LIFT
        squeezed = max(int(lift.argmax()) - 1, 0)
        return np.where(lift[:, None], self.mocap_pos - self.mocap_pos[squeezed], 0.0)

    def displacement(self) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"]]:
        """How far the object is (T,) in metres from where it should be, and how far turned (T,) in radians.

        It should be where it lay in the first frame or, while it is lifted, as far from there as the hand was moved.
        """
        T = transform_from_pose(self.object_pose)
        wanted = np.repeat(T[:1], len(T), axis=0)
        wanted[:, :3, 3] += self.lifted()
        return distances(wanted, T)

    def since_stage(self) -> Float[np.ndarray, " T"]:
        """Seconds (T,) since the stage of each frame began, which is when the one before it ended."""
        begins = np.concatenate([[0], np.flatnonzero(np.diff(self.stage)) + 1])
        # The first frame of a stage is what its first step led to.
        started = np.maximum(begins - 1, 0)
        return self.time - self.time[started[np.searchsorted(begins, np.arange(len(self)), side="right") - 1]]

    def thinned(self, count: int) -> Int[np.ndarray, " k"]:
        """At most `count` frames, in order and evenly spread; the first and the last of all stages are among them."""
        last = np.flatnonzero(np.diff(self.stage))
        marks = np.unique(np.concatenate([[0], last, [len(self) - 1]]))
        even = np.linspace(0, len(self) - 1, min(count, len(self))).round().astype(int)
        # An even frame is left out where it would stand beside a mark.
        near = np.abs(even[:, None] - marks[None, :]).min(axis=1)
        spare = even[np.argsort(-near, kind="stable")][: max(count - len(marks), 0)]
        return np.unique(np.concatenate([marks, spare]))


def qpos_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """What the values of qpos are in a model; joints without a name are called by their number."""
    names: list[str] = []
    ends = [*model.jnt_qposadr[1:], model.nq]
    for number, (start, end) in enumerate(zip(model.jnt_qposadr, ends, strict=True)):
        name = model.joint(number).name or f"joint {number}"
        # One value for a hinge or a slide, four for a ball, seven for a free joint.
        axes = POSE_AXES[-(end - start) :]
        names.extend([name] if end - start == 1 else [f"{name} {axis}" for axis in axes])
    return tuple(names)


def check_replay(model: mujoco.MjModel, replay: Replay) -> None:
    """Nothing, when the replay can be of this model.

    Raises:
        GraspRefineError: It is not; names joints that only one of them has.
    """
    names = qpos_names(model)
    if names != replay.qpos_names or replay.qvel.shape[1] != model.nv or model.nmocap != 1:
        strange = sorted(set(names) ^ set(replay.qpos_names))[:4]
        raise GraspRefineError(
            f"replay {replay.name}: is of another model" + (f", {', '.join(strange)} is not in both" if strange else "")
        )


_TEXT = ("name", "hand", "object", "direction", "setting", "reason")


def save_replay(path: str | Path, replay: Replay) -> None:
    """Write a replay as an `.npz` without pickle; the file appears whole or not at all.

    Raises:
        GraspFileError: The file cannot be written.
    """
    save_npz(path, {"schema": SCHEMA, **{field.name: getattr(replay, field.name) for field in fields(Replay)}})


def load_replay(path: str | Path) -> Replay:
    """Return the replay in a file that `save_replay` wrote.

    Raises:
        GraspFileError: The file is missing, damaged, or not a replay; says which entry is at fault.
    """
    npz = load_npz(path)
    missing = [name for name in ("schema", *(field.name for field in fields(Replay))) if name not in npz.entries]
    if missing:
        raise npz.error(f"not a replay, {', '.join(missing)} missing")
    schema = npz.numbers("schema")
    if not np.array_equal(schema, SCHEMA):
        raise npz.error(f"replay schema {npz.entries['schema']} is not known; this version reads {SCHEMA}")
    names = npz.names("qpos_names")
    time = _shaped(npz, "time", (None,))
    frames = len(time)
    if frames == 0:
        raise npz.error("the replay has no frames")
    if (np.diff(time) < 0).any():
        raise npz.error("time must not fall")
    stage = _shaped(npz, "stage", (frames,))
    known = [stage.value for stage in Stage]
    if not np.isin(stage, known).all():
        raise npz.error(f"stage must be among {', '.join(f'{s.value} ({s.label})' for s in Stage)}")
    return Replay(
        **{name: npz.name(name) for name in _TEXT},
        force=_shaped(npz, "force", (3,)),
        qpos_names=names,
        time=time,
        stage=stage.astype(int),
        qpos=_shaped(npz, "qpos", (frames, len(names))),
        qvel=_shaped(npz, "qvel", (frames, None)),
        ctrl=_shaped(npz, "ctrl", (frames, None)),
        mocap_pos=_shaped(npz, "mocap_pos", (frames, 3)),
        mocap_quat=_shaped(npz, "mocap_quat", (frames, 4)),
    )


def _shaped(npz: NpzFile, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
    value = npz.numbers(key)
    if value.ndim != len(shape) or any(b is not None and a != b for a, b in zip(value.shape, shape, strict=True)):
        wanted = " x ".join("any" if size is None else str(size) for size in shape)
        raise npz.error(f"{key} must be {wanted} numbers; it has shape {value.shape}")
    return value
