"""Grasps of human hands by key points or vertices of MANO, without any model of the hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.arguments import as_numbers
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.short_repr import brief
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.objects.object import Object
from grasp_refine.transfers.nearest_surface import nearest_surface
from grasp_refine.transfers.source_grasps import SourceGrasps

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MANO = "mano"
"""Name of the human hand as a source of grasps."""

FINGERS = ("thumb", "index", "middle", "ring", "little")
"""Fingers, the thumb first."""

OPENPOSE = tuple(range(21))
"""Order of OpenPose: the wrist, then each finger of `FINGERS` from its base to its tip."""

MANO_ORDER = (0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20)
"""Indices in the order of OpenPose of points in MANO's: the wrist, index, middle, little and ring finger and thumb with
three joints each, then the tips of thumb, index, middle, ring and little finger."""

TIP_VERTICES = (744, 320, 443, 554, 671)
"""Vertices of MANO's mesh at the fingertips of `FINGERS`, as the file vertex_ids of the package smplx has them."""

NUM_VERTICES = 778
"""Vertices of MANO's mesh."""

TOUCH_M = 0.01
"""Distance in metres between a fingertip and the object up to which it touches."""

KEYS = ("key_points", "keypoints", "joints", "vertices", "verts")
"""Entries of an .npz, the first of which is read."""


POINTS = tuple(f"{finger}_tip" for finger in FINGERS) + ("palm", "index_row", "little_row")
"""Points that are kept: the fingertips, the middle of the palm, and the ends of the row of fingers."""

COLUMNS = tuple(f"{point}_{axis}" for point in POINTS for axis in "xyz")
"""Names of their coordinates, which take the place of joint values in a grasp set."""


@dataclass(frozen=True, eq=False, init=False)
class KeyPoints:
    """N grasps of a human hand, in the object's frame."""

    points: Float[np.ndarray, "N 8 3"]
    """`POINTS` (N, 8, 3), metres; the row of fingers ends at the knuckles or, of vertices, at the tips."""

    __repr__ = brief

    def __init__(self, points: ArrayLike) -> None:
        """Take 21 key points (N, 21, 3) in the order of OpenPose or MANO, or vertices (N, 778, 3); one needs no N.

        The order is the one in which the bones are shorter. Points that are kept already (N, 8, 3) are taken, too.

        Raises:
            GraspRefineError: an array of another shape.
        """
        given = as_numbers("points", points)
        given = given[None] if given.ndim == 2 else given
        shapes = ((21, 3), (NUM_VERTICES, 3), (len(POINTS), 3))
        if given.ndim != 3 or given.shape[1:] not in shapes:
            raise GraspRefineError(
                f"points must be key points (N, 21, 3) or MANO's vertices (N, {NUM_VERTICES}, 3), metres, in the "
                f"object's frame; got an array of shape {given.shape}"
            )
        if given.shape[1] == NUM_VERTICES:
            tips = given[:, TIP_VERTICES]
            given = np.concatenate([tips, given.mean(axis=1, keepdims=True), tips[:, [1, 4]]], axis=1)
        elif given.shape[1] == 21:
            ordered = min((given[:, order] for order in (OPENPOSE, MANO_ORDER)), key=_bones)
            fingers = ordered[:, 1:].reshape(-1, 5, 4, 3)
            knuckles = fingers[:, 1:, 0]
            palm = np.concatenate([ordered[:, :1], knuckles], axis=1).mean(axis=1, keepdims=True)
            given = np.concatenate([fingers[:, :, 3], palm, knuckles[:, [0, 3]]], axis=1)
        object.__setattr__(self, "points", given)

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.points)

    def source_grasps(self, obj: Object) -> SourceGrasps:
        """Return the grasps on an object as grasps to transfer: fingertips within `TOUCH_M` of it touch it."""
        tips, palm, row = self.points[:, :5], self.points[:, 5], self.points[:, 7] - self.points[:, 6]
        point, normal, distance = nearest_surface(obj, tips.reshape(-1, 3))
        touches = (np.abs(distance) <= TOUCH_M).reshape(-1, 5, 1)
        others = tips[:, 1:].mean(axis=1)
        center = 0.5 * (tips[:, 0] + others)
        approach = _unit(center - palm)
        along = _perpendicular(row, approach)
        across = _perpendicular(_perpendicular(others - tips[:, 0], approach), along)
        return SourceGrasps(
            fingers=FINGERS,
            thumb="side",
            point=np.where(touches, point.reshape(-1, 5, 3), np.nan),
            normal=np.where(touches, normal.reshape(-1, 5, 3), np.nan),
            weight=touches[..., 0].astype(float),
            center=center,
            axes=np.stack([across, along, approach], axis=-1),
        )


def load_key_points(path: Path) -> GraspSet:
    """Return the grasps of a file of key points or vertices: coordinates `COLUMNS` in place of joint values.

    An .npy holds the array; an .npz one of `KEYS`, and perhaps `object` and `scale`, each of one or of N.

    Raises:
        GraspFileError: it cannot be read, or lacks the points.
    """
    name: np.ndarray = np.array("object")
    scale: np.ndarray = np.array(1.0)
    if path.suffix == ".npz":
        file = load_npz(path)
        found = [key for key in KEYS if key in file.entries]
        if not found:
            raise GraspFileError(f"{path}: holds no points of a hand: one of {', '.join(KEYS)}")
        points = file.entries[found[0]]
        name = file.text("object") if "object" in file.entries else name
        scale = file.numbers("scale") if "scale" in file.entries else scale
    else:
        try:
            points = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise GraspFileError(f"{path}: cannot be read as an array of points ({error})") from None
    try:
        kept = KeyPoints(points).points
    except GraspRefineError as error:
        raise GraspFileError(f"{path}: {error}") from None
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(kept), 1))
    return GraspSet(MANO, "palm", COLUMNS, name, scale, pose, kept.reshape(len(kept), -1))


def _bones(points: Float[np.ndarray, "N 21 3"]) -> float:
    """Return the sum of the lengths of all bones, in the order of OpenPose, metres."""
    fingers = points[:, 1:].reshape(-1, 5, 4, 3)
    from_wrist = fingers[:, :, 0] - points[:, :1]
    return float(np.linalg.norm(from_wrist, axis=-1).sum() + np.linalg.norm(np.diff(fingers, axis=2), axis=-1).sum())


def _unit(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _perpendicular(vectors: Float[np.ndarray, "N 3"], axis: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Return the unit vectors (N, 3) at right angles to unit axes (N, 3) that are nearest to others."""
    return _unit(vectors - (vectors * axis).sum(axis=-1, keepdims=True) * axis)
