"""Files of one alignment task: two bodies, targets, and the trajectory of each method."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from grasp_refine.core.npz_files import NpzFile, load_npz, save_npz
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.geometry.pieces import Piece
from grasp_refine.grasps.poses import unit_poses

if TYPE_CHECKING:
    import trimesh

SCHEMA = 1
"""Version of the layout of these files."""
MARK = "alignment_schema"
"""The entry that identifies such a file."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A rigid body in its own frame, as far as is needed to draw it."""

    name: str
    """Name of the mesh."""
    pieces: tuple[Piece, ...]
    """Convex pieces whose union is the body."""

    def mesh(self) -> trimesh.Trimesh:
        """Surface of the body; where the pieces cannot be united, the surfaces of all of them."""
        import trimesh

        meshes = [piece.mesh() for piece in self.pieces]
        if len(meshes) == 1:
            return meshes[0]
        try:
            return trimesh.boolean.union(meshes)
        except ValueError:  # one of them is not closed
            whole = trimesh.util.concatenate(meshes)
            assert isinstance(whole, trimesh.Trimesh)
            return whole


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Trajectory of one method on the task: K iterates, the first of which is the start."""

    label: str
    """Name of the method, with its distinguishing settings."""
    margin: float
    """Desired gap between the bodies, metres."""
    result: int
    """Index of the returned iterate among the K: the best by the method's own criterion."""
    iteration: Int[np.ndarray, " K"]
    """Number of each iterate, rising from 0; long trajectories are thinned."""
    poses: Float[np.ndarray, "K 2 4 4"]
    """Poses of both bodies in the world."""
    witness: Float[np.ndarray, "K 2 3"]
    """Closest points of both bodies, by a plain query of these poses; world frame, NaN where the query failed."""
    distance: Float[np.ndarray, " K"]
    """Signed distance of the bodies in metres."""
    error: Float[np.ndarray, " K"]
    """|x_a - t_a|^2 + |x_b - t_b|^2 + (d - margin)^2 in square metres; NaN where there are no witness points."""
    cpu_s: Float[np.ndarray, " K"]
    """CPU seconds from the start to each iterate, of a run of this task alone."""

    def __len__(self) -> int:
        return len(self.iteration)


@dataclass(frozen=True, eq=False)
class AlignmentTask:
    """Two bodies, a target point on each, and the trajectories of the methods that align them."""

    kind: str
    """Kind of the bodies: "convex" or "concave"."""
    target_class: str
    """Features that the targets lie on, such as "face-vertex"."""
    bodies: tuple[Solid, Solid]
    """The fixed body and the moving one."""
    targets: Float[np.ndarray, "2 3"]
    """Target point on each body, metres, body frames."""
    start: Float[np.ndarray, "2 4 4"]
    """Initial poses of both bodies in the world."""
    trajectories: tuple[Trajectory, ...]
    """One trajectory for each method."""


def save_task(path: Path, task: AlignmentTask) -> None:
    """Write a task atomically; missing folders are created.

    Raises:
        GraspRefineError: it cannot be written.
    """
    pieces = [(side, piece) for side, body in enumerate(task.bodies) for piece in body.pieces]
    runs = task.trajectories

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(run, name) for run in runs])

    save_npz(
        path,
        {
            MARK: SCHEMA,
            "kind": task.kind,
            "target_class": task.target_class,
            "body": [body.name for body in task.bodies],
            "target": task.targets,
            "pose": pose_from_transform(task.start),
            "piece_body": [side for side, _ in pieces],
            "piece_radius": [piece.radius for _, piece in pieces],
            "piece_vertices": [len(piece.vertices) for _, piece in pieces],
            "piece_faces": [len(piece.faces) for _, piece in pieces],
            "vertices": np.concatenate([piece.vertices for _, piece in pieces]),
            "faces": np.concatenate([piece.faces for _, piece in pieces]),
            "method": [run.label for run in runs],
            "method_margin": [run.margin for run in runs],
            "method_result": [run.result for run in runs],
            "method_iterates": [len(run) for run in runs],
            "iterate_number": joined("iteration"),
            "iterate_pose": pose_from_transform(joined("poses")),
            "iterate_witness": joined("witness"),
            "iterate_distance": joined("distance"),
            "iterate_error": joined("error"),
            "iterate_cpu_s": joined("cpu_s"),
        },
    )


def is_task(path: Path) -> bool:
    """Return True where a file is marked as an alignment task; nothing is unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            return f"{MARK}.npy" in archive.namelist()
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


def load_task(path: Path) -> AlignmentTask:
    """Read a file of `save_task`.

    Raises:
        GraspFileError: the file is missing, damaged, or no alignment task; the message starts with its path.
    """
    return _Reader(load_npz(path)).task()


@dataclass(frozen=True)
class _Reader:
    """Validated entries of a file."""

    file: NpzFile

    def task(self) -> AlignmentTask:
        """Read the whole task."""
        self._check_schema()
        a, b = self._bodies()
        return AlignmentTask(
            self._name("kind"),
            self._name("target_class"),
            (a, b),
            self._numbers("target", (2, 3)),
            self._poses("pose", (2, 7)),
            self._trajectories(),
        )

    def _check_schema(self) -> None:
        if MARK not in self.file.entries:
            raise self.file.error(f"not an alignment task, no {MARK}; `refine-grasp bench align --save` writes one")
        schema = self._counts(MARK, None)
        if schema.shape != () or schema < 1:
            raise self.file.error(f"{MARK} must be one integer from 1 to {SCHEMA}")
        if schema > SCHEMA:
            raise self.file.error(f"{MARK} {schema} is newer than this version reads ({SCHEMA}): update grasp-refine")

    def _bodies(self) -> list[Solid]:
        """Read both bodies."""
        names = self._texts("body")
        owner = self._counts("piece_body", None)
        if len(names) != 2 or owner.ndim != 1 or set(owner.tolist()) != {0, 1}:
            raise self.file.error("body must name two bodies, and piece_body must give the body of each piece: 0 or 1")
        P = len(owner)
        radius = self._numbers("piece_radius", (P,))
        corners, sizes = (self._counts(f"piece_{name}", P) for name in ("vertices", "faces"))
        vertices = self._numbers("vertices", (corners.sum(), 3))
        faces = self._counts("faces", None)
        if faces.shape != (sizes.sum(), 3):
            raise self.file.error(f"faces must have shape ({sizes.sum()}, 3) by piece_faces; it has {faces.shape}")
        found: list[list[Piece]] = [[], []]
        for side, r, v, f in zip(
            owner, radius, np.split(vertices, corners.cumsum()[:-1]), np.split(faces, sizes.cumsum()[:-1]), strict=True
        ):
            round_ = len(v) in (1, 2) and r > 0 and not len(f)
            if not (round_ or (len(v) >= 4 and len(f) >= 4)) or r < 0 or f.max(initial=0) >= len(v):
                raise self.file.error(
                    f"piece {sum(map(len, found))} is not a convex piece: a sphere (1 vertex, a radius), a capsule (2 "
                    "and a radius), or at least 4 vertices and triangles between them"
                )
            found[side].append(Piece(v, f, float(r)))
        return [Solid(name, tuple(pieces)) for name, pieces in zip(names, found, strict=True)]

    def _trajectories(self) -> tuple[Trajectory, ...]:
        labels = self._texts("method")
        M = len(labels)
        if not M:
            raise self.file.error("method must name at least one method")
        margin = self._numbers("method_margin", (M,))
        lengths, result = self._counts("method_iterates", M), self._counts("method_result", M)
        if (result >= lengths).any():
            row = int(np.flatnonzero(result >= lengths)[0])
            raise self.file.error(
                f"method_result of {labels[row]} must be one of its {lengths[row]} iterates, counted from 0; it is "
                f"{result[row]}"
            )
        K = int(lengths.sum())
        columns = (
            self._counts("iterate_number", K),
            self._poses("iterate_pose", (K, 2, 7)),
            self._numbers("iterate_witness", (K, 2, 3), nan=True),
            self._numbers("iterate_distance", (K,), nan=True),
            self._numbers("iterate_error", (K,), nan=True),
            self._numbers("iterate_cpu_s", (K,)),
        )
        parts = [np.split(column, lengths.cumsum()[:-1]) for column in columns]
        for label, number in zip(labels, parts[0], strict=True):
            if number[0] != 0 or (np.diff(number) <= 0).any():
                raise self.file.error(f"iterate_number of {label} must rise from 0")
        runs = zip(labels, margin.tolist(), result.tolist(), *parts, strict=True)
        return tuple(Trajectory(*run) for run in runs)

    def _need(self, key: str) -> None:
        if key not in self.file.entries:
            raise self.file.error(f"the entry {key} of an alignment task is missing")

    def _name(self, key: str) -> str:
        self._need(key)
        return self.file.name(key)

    def _texts(self, key: str) -> tuple[str, ...]:
        self._need(key)
        return self.file.names(key)

    def _numbers(self, key: str, shape: Sequence[int], *, nan: bool = False) -> np.ndarray:
        """Read numbers of a shape."""
        self._need(key)
        found = self.file.numbers(key, allowed="nan" if nan else "finite")
        shape = tuple(map(int, shape))
        if found.shape != shape:
            raise self.file.error(f"{key} must have shape {shape}; it has {found.shape}")
        return found

    def _counts(self, key: str, count: int | None) -> np.ndarray:
        """Read `count` non-negative integers; None: of any shape."""
        self._need(key)
        found = self.file.entries[key]
        if found.dtype.kind not in "iu" or (found < 0).any() or (found > 2**31).any():
            raise self.file.error(f"{key} must hold integers of at least 0")
        if count is not None and found.shape != (count,):
            raise self.file.error(f"{key} must have shape ({count},); it has {found.shape}")
        return found.astype(np.int64)

    def _poses(self, key: str, shape: Sequence[int]) -> np.ndarray:
        """Read transforms (..., 4, 4) from poses x y z qw qx qy qz."""
        poses = unit_poses(self._numbers(key, shape).reshape(-1, 7), key, self.file.error)
        return transform_from_pose(poses).reshape(*shape[:-1], 4, 4)
