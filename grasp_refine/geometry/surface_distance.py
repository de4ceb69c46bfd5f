"""Distance between the surfaces of a mesh and of its convex pieces, in either direction."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.cache import load_arrays
from grasp_refine.geometry.covering import protrusion
from grasp_refine.geometry.pieces import Piece

if TYPE_CHECKING:
    import trimesh

MIN_DISTANCE_RATIO = 1e-3
"""Smallest distance that is measured, as a fraction of the diagonal of the mesh."""

_POINTS = 2**14
"""Points on the mesh whose distances from the pieces are measured, beside its vertices."""


def surface_note(pieces: Sequence[Piece], mesh: trimesh.Trimesh, cache: Path | None = None) -> str | None:
    """Return a note for the user on the distance between polytopes and `mesh`; None where it is too small to measure.

    Args:
        pieces: Polytopes, in metres.
        mesh: Closed or open, in metres.
        cache: Folder of earlier measurements; None: no cache.
    """
    entry = None if cache is None else cache / _entry_name(pieces, mesh)
    known = None if entry is None else load_arrays(entry, "distance")
    distance = surface_distance(pieces, mesh) if known is None else float(known[0])
    if entry is not None and known is None:
        try:
            save_npz(entry, {"distance": distance})
        except GraspFileError:
            pass  # The distance is known.
    if not distance:
        return None
    verb = "is" if len(pieces) == 1 else "are"
    return f"{count_text(len(pieces), 'convex piece')} {verb} up to {distance * 1e3:.2f} mm from its surface"


def surface_distance(pieces: Sequence[Piece], mesh: trimesh.Trimesh) -> float:
    """Return the largest distance in metres between the surfaces of polytopes and `mesh`; 0 below `MIN_DISTANCE_RATIO`.

    Points on the exposed surface of the pieces are measured to the mesh, and points on the mesh outside of all pieces
    to their planes, which is too little beside edges.
    """
    import trimesh

    least = MIN_DISTANCE_RATIO * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    points = np.concatenate([trimesh.sample.sample_surface(mesh, _POINTS, seed=0)[0], mesh.vertices])
    outside = np.full(len(points), np.inf)
    for piece in pieces:
        normals, offsets = piece.planes
        outside = np.minimum(outside, (points @ normals.T - offsets).max(axis=1))
    gap = float(outside.max())
    return max(protrusion(pieces, mesh, least), gap if gap > least else 0.0)


def _entry_name(pieces: Sequence[Piece], mesh: trimesh.Trimesh) -> str:
    digest = hashlib.sha256(f"{_POINTS} {[len(piece.vertices) for piece in pieces]}".encode())
    for array in (*(piece.vertices for piece in pieces), mesh.vertices, np.asarray(mesh.faces, dtype=np.float64)):
        digest.update(np.asarray(array, dtype="<f8").tobytes())
    return f"{digest.hexdigest()}.npz"
