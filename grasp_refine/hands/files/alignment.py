"""Alignment of an MJCF with a hand: base pose and signs of the joints, from joint anchors and axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import inverse, transform
from grasp_refine.hands.files.mimics import curves, mimic_map
from grasp_refine.hands.files.tree import Joint, Tree
from grasp_refine.hands.files.tree_poses import tree_poses

MAX_ANCHOR_DISTANCE_M = 2e-3
"""Largest distance in metres between joint anchors of the same hand."""

MAX_AXIS_ANGLE_RAD = np.radians(2.0)
"""Largest angle in radians between joint axes of the same hand."""

NOTED_DISTANCE_M = 1e-4
"""Distance in metres between joint anchors above which a note is returned."""

NUM_CONFIGURATIONS = 20
"""Number of random joint values at which MJCF and URDF are compared."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Alignment of the world and the joints of an MJCF with a hand."""

    T_base_world: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of that world in the frame of the hand's base link."""
    sign: Float[np.ndarray, " m"]
    """1, or -1 for joints that turn the other way."""
    distance: float
    """Largest distance between two anchors of the same joint, in metres."""
    angle: float
    """Largest angle between two axes of the same joint, in radians."""
    notes: tuple[str, ...]
    """Notes for the user on the alignment."""


@dataclass(frozen=True, eq=False)
class Mechanism:
    """The joints of a hand, as an MJCF is compared with them."""

    name: str
    """Name of the hand, for messages."""
    path: Path
    """File that the joints come from."""
    base_link: str
    """Link whose pose is the hand's pose."""
    joints: Sequence[Joint]
    """All joints, fixed ones too, parents before children."""
    independent: Sequence[str]
    """The independent ones, in the order of `Hand.joint_names`."""

    @staticmethod
    def of(name: str, base_link: str, tree: Tree, joints: Sequence[Joint]) -> Mechanism:
        """Return the mechanism of the joints of a hand, which are below `base_link` in the tree of its file."""
        moving = {joint.name for joint in joints if joint.movable and joint.mimic is None}
        return Mechanism(name, tree.path, base_link, joints, [joint for joint in tree.joints if joint in moving])


def align(mechanism: Mechanism, matched: Mapping[str, str], model: mujoco.MjModel, path: Path) -> Alignment:
    """Align `model` with a hand by anchors and axes of the joints that are `matched`.

    The base pose is the least-squares fit of the anchors (and of axes, where these are on one line) with all joints at
    0, the axes give the signs. Both are checked at random joint values within the hand's limits. The file
    that the hand comes from is aligned as it is.

    Args:
        mechanism: Joints of the hand.
        matched: Joint of the hand -> its name in `model`.
        model: The MJCF, compiled.
        path: Its file, for messages.

    Raises:
        HandError: the joints do not move alike, or anchors and axes do not determine the pose.
    """
    if path.samefile(mechanism.path):
        return Alignment(inverse(body_pose(model, mechanism.base_link)), np.ones(len(matched)), 0.0, 0.0, ())
    joints, named = list(matched), list(matched.values())
    matrix, offset, movable = mimic_map(mechanism.joints, mechanism.independent)
    rows = [movable.index(name) for name in joints]
    limits = {joint.name: (joint.lower, joint.upper) for joint in mechanism.joints}
    lower, upper = np.array([limits[name] for name in mechanism.independent]).reshape(-1, 2).T
    lower, upper = np.where(np.isinf(lower), -np.pi, lower), np.where(np.isinf(upper), np.pi, upper)
    q = np.random.default_rng(0).uniform(lower, upper, (NUM_CONFIGURATIONS, len(lower)))
    moved = q @ matrix.T + offset + curves(mechanism.joints, mechanism.independent)(q)
    values = np.concatenate([np.zeros((1, len(movable))), moved])
    anchors, axes = _hand_joints(mechanism, dict(zip(movable, values.T, strict=True)), joints)
    still = _model_joints(model, named, np.zeros((1, len(named))))
    best = None
    for turn in _rotations(anchors[0], axes[0], still[0][0], still[1][0], path):
        sign = np.where(np.einsum("ji,ji->j", axes[0], still[1][0] @ turn.T) < 0, -1.0, 1.0)
        shift = anchors[0].mean(axis=0) - turn @ still[0][0].mean(axis=0)
        there, along = _model_joints(model, named, sign * values[:, rows])
        distance = np.linalg.norm(there @ turn.T + shift - anchors, axis=-1)
        turned = sign[:, None] * along @ turn.T
        angle = np.arctan2(np.linalg.norm(np.cross(turned, axes), axis=-1), (turned * axes).sum(axis=-1))
        # Where a hand is its own mirror image, several poses fit; choose the one with the fewest reversed joints.
        rank = (round(distance.max() / NOTED_DISTANCE_M) + round(angle.max() / MAX_AXIS_ANGLE_RAD), (sign < 0).sum())
        if best is None or rank < best[0]:
            best = rank, turn, shift, sign, distance.max(axis=0), angle.max(axis=0)
    assert best is not None  # there is always a rotation to try
    _, turn, shift, sign, distance, angle = best
    if distance.max() > MAX_ANCHOR_DISTANCE_M or angle.max() > MAX_AXIS_ANGLE_RAD:
        far, steep = int(distance.argmax()), int(angle.argmax())
        raise HandError(
            f"{path}: moves unlike hand '{mechanism.name}': joint '{joints[far]}' is up to "
            f"{distance[far] * 1e3:.2f} mm off (at most {MAX_ANCHOR_DISTANCE_M * 1e3:g}), the axis of "
            f"'{joints[steep]}' {np.degrees(angle[steep]):.2f} degrees (at most {np.degrees(MAX_AXIS_ANGLE_RAD):g}); "
            "the MJCF is of another hand or has another zero"
        )
    notes = []
    if distance.max() > NOTED_DISTANCE_M:
        notes.append(f"joints of {path.name} are up to {distance.max() * 1e3:.2f} mm from the joints of the URDF")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, shift
    return Alignment(T, sign, float(distance.max()), float(angle.max()), tuple(notes))


def body_pose(model: mujoco.MjModel, body: str) -> Float[np.ndarray, "4 4"]:
    """Return the pose (4, 4) of a body in the world at the reference positions of all joints."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return transform(data.body(body).xmat.reshape(3, 3).copy(), data.body(body).xpos.copy())


def _hand_joints(
    mechanism: Mechanism, values: Mapping[str, np.ndarray], joints: Sequence[str]
) -> tuple[Float[np.ndarray, "batch m 3"], Float[np.ndarray, "batch m 3"]]:
    """Return anchors and axes of `joints` (batch, m, 3) in the base link's frame, before each joint itself has moved.

    `values` are of all movable joints, each (batch,).
    """
    T = tree_poses(mechanism.base_link, mechanism.joints, values)
    still = {joint.name: T[joint.parent] @ joint.T_parent_child for joint in mechanism.joints if joint.name in joints}
    anchors = {name: at[:, :3, 3] for name, at in still.items()}
    axes = {joint.name: still[joint.name][:, :3, :3] @ joint.axis for joint in mechanism.joints if joint.name in still}
    return np.stack([anchors[name] for name in joints], axis=1), np.stack([axes[name] for name in joints], axis=1)


def _model_joints(
    model: mujoco.MjModel, named: Sequence[str], values: Float[np.ndarray, "batch m"]
) -> tuple[Float[np.ndarray, "batch m 3"], Float[np.ndarray, "batch m 3"]]:
    """Return anchors and axes of the joints `named` (batch, m, 3) in the world of `model`."""
    data = mujoco.MjData(model)
    rows = [model.joint(name).id for name in named]
    slides = model.jnt_type[rows] == mujoco.mjtJoint.mjJNT_SLIDE
    anchors, axes = np.empty((2, *values.shape, 3))
    for number, value in enumerate(values):
        data.qpos[model.jnt_qposadr[rows]] = value
        mujoco.mj_kinematics(model, data)
        anchors[number], axes[number] = data.xanchor[rows], data.xaxis[rows]
        # MuJoCo has the anchor of a slide where it is at its reference, not at 0.
        anchors[number] -= (slides * model.qpos0[model.jnt_qposadr[rows]])[:, None] * data.xaxis[rows]
    return anchors, axes


def _rotations(
    anchors: Float[np.ndarray, "m 3"],
    axes: Float[np.ndarray, "m 3"],
    anchors_model: Float[np.ndarray, "m 3"],
    axes_model: Float[np.ndarray, "m 3"],
    path: Path,
) -> list[Float[np.ndarray, "3 3"]]:
    """Return the rotations that can take the model's anchors and axes to the hand's, axes up to sign."""
    here, there = anchors - anchors.mean(axis=0), anchors_model - anchors_model.mean(axis=0)
    spread = np.linalg.svd(there, compute_uv=False) / np.sqrt(len(there))
    if len(spread) > 1 and spread[1] > MAX_ANCHOR_DISTANCE_M:
        return [_fit(here, there)]
    pairs = []
    if spread[0] > MAX_ANCHOR_DISTANCE_M:
        # The ends of the line on which the anchors are.
        end = int(np.linalg.norm(there, axis=1).argmax())
        pairs.append((_unit(here[end]), _unit(there[end])))
    free: list[tuple[np.ndarray, np.ndarray]] = []
    for axis in zip(axes, axes_model, strict=True):
        if len(pairs) + len(free) < 2 and all(np.linalg.norm(np.cross(axis[1], b)) > 0.1 for _, b in pairs + free):
            free.append(axis)
    if len(pairs) + len(free) < 2:
        raise HandError(
            f"{path}: its joints are on one line and parallel to it, so the pose of the hand is not determined"
        )
    found = []
    for signs in product((1.0, -1.0), repeat=len(free)):
        signed = [(a, sign * b) for sign, (a, b) in zip(signs, free, strict=True)]
        found.append(_fit(*(np.array(vectors) for vectors in zip(*pairs, *signed, strict=True))))
    return found


def _fit(here: Float[np.ndarray, "m 3"], there: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that takes `there` nearest to `here`: W. Kabsch, Acta Cryst. A32 (1976) 922."""
    u, _, vt = np.linalg.svd(here.T @ there)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
