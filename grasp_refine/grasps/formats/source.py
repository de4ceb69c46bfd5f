"""Contents of a grasp file of another program, with a named error for everything invalid in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_valid
from grasp_refine.grasps.poses import unit_poses, without_zero_quaternions

MESH_FOLDERS = ("mesh", "meshes", "urdf", "mjcf", "coacd")
"""Folders inside the folder of an object, whose names are not the object's."""
LARGEST_NUMBER = 1e100
"""Largest number that is computed with: squares of larger ones overflow."""
MAX_NUMBERS = 2**24
"""Most numbers of one array, which take 128 MiB as float64, whatever they take in the file."""
ROTATION_TOLERANCE = 1e-3
"""Greatest deviation of a rotation's product with its transpose from the identity: rounding to float32 passes."""
MAX_NAME_CHARACTERS = 200
"""Most characters of an object's name; the rest is cut off."""


@dataclass(frozen=True)
class Source:
    """One file; its accessors raise GraspFileError in one line that starts with the path."""

    path: Path
    """Path of the file."""
    content: Any
    """Its contents, as `load_content` returns them."""
    within: Path | None = None
    """Folder that files named by this one must be in; None: any folder above may hold them."""

    def error(self, message: str) -> GraspFileError:
        """Return the error with `message` about this file."""
        return GraspFileError(f"{self.path}: {message}")

    def finite(self, value: Any, what: str) -> np.ndarray:
        """Return finite numbers as float64."""
        array = self.numbers(value, what)
        if np.isnan(array).any():
            at = np.argwhere(np.isnan(array))[0].tolist()
            raise self.error(f"{what} must be finite; {what}{''.join(f'[{i}]' for i in at)} is not")
        return array

    def numbers(self, value: Any, what: str, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
        """Return numbers as float64, of the given shape if there is one; None in it is any length from 1.

        Infinite values become NaN, because one bad grasp should not affect the others.
        """
        try:
            array = np.asarray(value)
        except ValueError:
            raise self.error(f"{what} must be numbers of one shape; its rows differ in length") from None
        if array.dtype.kind not in "fiu":
            raise self.error(f"{what} must hold numbers; it holds {_kind(value)}")
        if array.size > MAX_NUMBERS:
            raise self.error(f"{what} holds {array.size} numbers, more than the {MAX_NUMBERS} that are read; split it")
        if shape is not None and not _fits(array.shape, shape):
            wanted = ", ".join("N" if length is None else str(length) for length in shape)
            raise self.error(f"{what} must have shape ({wanted}); it has {array.shape}")
        with np.errstate(all="ignore"):  # what overflows is not finite
            array = array.astype(float)
        return np.where(np.isfinite(array), array, np.nan)

    def moderate(self, value: Any, what: str, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
        """Return numbers as `numbers` does; NaN for those above `LARGEST_NUMBER`, to be computed with."""
        array = self.numbers(value, what, shape)
        return np.where(np.abs(array) <= LARGEST_NUMBER, array, np.nan)

    def scale(self, value: Any, what: str) -> float:
        """Return the factor that takes a mesh to metres; three equal ones are accepted."""
        factors = self.finite(value, what).ravel()
        if len(factors) not in (1, 3) or np.ptp(factors) > 1e-6 * abs(factors[0]):
            raise self.error(f"{what} must be one number, the same in all directions; it is {factors[:4].tolist()}")
        if factors[0] <= 0:
            raise self.error(f"{what} must be positive; it is {factors[0]:g}")
        return float(factors[0])

    def poses(self, value: Any, what: str, count: int | None = None) -> Float[np.ndarray, "N 7"]:
        """Return poses (N, 7), x y z qw qx qy qz, with unit quaternions; NaN where not finite, or the quaternion 0."""
        poses = without_zero_quaternions(self.numbers(value, what, (count, 7)))
        return unit_poses(poses, what, self.error)

    def transforms(self, value: Any, what: str, count: int | None = None) -> Float[np.ndarray, "N 4 4"]:
        """Return rigid transforms (N, 4, 4), rotations made exact; NaN where they are not finite."""
        T = self.numbers(value, what, (count, 4, 4))
        finite = np.isfinite(T).all(axis=(1, 2))
        T = np.where(finite[:, None, None], T, np.nan)
        R = np.where(finite[:, None, None], T[:, :3, :3], np.eye(3))
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
            error = np.where(np.linalg.det(R) > 0, error, np.inf)
        error = np.where(finite & (np.abs(T[:, 3] - [0, 0, 0, 1]).max(axis=1) > ROTATION_TOLERANCE), np.inf, error)
        wrong = np.flatnonzero(~(error <= ROTATION_TOLERANCE))
        if len(wrong):
            raise self.error(
                f"{what} row {wrong[0]} is no rigid transform: a rotation in the first three rows and columns, a "
                "position in the last column, and 0 0 0 1 below"
            )
        U, _, V = np.linalg.svd(R)
        T[finite, :3, :3] = (U @ V)[finite]
        T[finite, 3] = [0, 0, 0, 1]
        return T

    def text(self, value: Any, what: str) -> str:
        """Return a text; a list of one is accepted."""
        if isinstance(value, np.ndarray):
            value = value.ravel().tolist()
        if isinstance(value, list | tuple) and len(value) == 1:
            value = value[0]
        if isinstance(value, bytes):
            value = value.decode("utf-8", errors="replace")
        if not isinstance(value, str):
            raise self.error(f"{what} must be a text; it is {_kind(value)}")
        if not is_valid(value):
            raise self.error(f"{what} holds characters that no text may have, or that control a terminal")
        return value

    def names(self, value: Any, what: str) -> tuple[str, ...]:
        """Return a list of texts."""
        if not isinstance(value, np.ndarray | list | tuple):
            raise self.error(f"{what} must be a list of names; it is {_kind(value)}")
        return tuple(self.text(name, what) for name in (value.ravel() if isinstance(value, np.ndarray) else value))

    def joint_names(self, held: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the joint names in contents of the file; none where they have no `joint_names`."""
        return () if held.get("joint_names") is None else self.names(held["joint_names"], "joint_names")

    def object_name(self, value: Any, what: str) -> str:
        """Return the name of the object whose folder or mesh a path names."""
        path = PurePosixPath(self.text(value, what).replace("\\", "/"))
        parts = [part for part in path.parts if part not in ("/", "..", ".")]
        if len(parts) > 2 and _is_mesh(parts[-1]) and parts[-2] in MESH_FOLDERS:
            parts.pop()
        while len(parts) > 1 and parts[-1] in MESH_FOLDERS:
            parts.pop()
        if not parts:
            raise self.error(f"{what} names no object: {str(value)[:80]!r}")
        name = PurePosixPath(parts[-1])
        return (name.stem if _is_mesh(name.name) else name.name)[:MAX_NAME_CHARACTERS]


def missing_keys(content: Any, keys: tuple[str, ...]) -> str:
    """Reason why contents are not a dict with some keys; "" if they are."""
    if not isinstance(content, Mapping):
        return f"it is no dict but {_kind(content)}"
    lacking = [key for key in keys if key not in content]
    return f"it lacks {', '.join(lacking)}" if lacking else ""


def _fits(there: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    pairs = zip(there, wanted, strict=False)
    return len(there) == len(wanted) and all(have == want if want is not None else have > 0 for have, want in pairs)


def _kind(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    return f"{type(value).__name__} {str(value)[:40]!r}" if isinstance(value, str) else type(value).__name__


def _is_mesh(name: str) -> bool:
    return PurePosixPath(name).suffix.lower() in (".obj", ".stl", ".ply", ".off", ".glb", ".urdf", ".xml", ".mjcf")
