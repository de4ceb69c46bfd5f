"""Rigid body: convex pieces, surface candidates and bounding spheres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind, describe_value
from grasp_refine.core.errors import MeshError
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.facets import Facets
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.geometry.sampling import Candidates, sample


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in its own frame; built once by `build_body`, never changed."""

    name: str
    """Name in messages and results."""
    pieces: tuple[Piece, ...]
    """Convex pieces whose union is the body."""
    candidates: Candidates
    """Samples of the exposed surface."""

    def __repr__(self) -> str:
        parts = (len(self.pieces), "convex piece"), (len(self.candidates.points), "surface point")
        return f"Body({self.name}: {', '.join(count_text(*part) for part in parts)})"

    @cached_property
    def centers(self) -> np.ndarray:
        """Centres (P, 3) of the bounding spheres of the pieces, in metres."""
        return np.stack([piece.bounds.mean(0) for piece in self.pieces])

    @cached_property
    def radii(self) -> np.ndarray:
        """Radii (P,) of the bounding spheres about `centers`, in metres; each holds its whole piece."""
        reach = [
            np.linalg.norm(piece.vertices - center, axis=1).max() + piece.radius
            for piece, center in zip(self.pieces, self.centers, strict=True)
        ]
        return np.array(reach)

    @cached_property
    def diagonal(self) -> float:
        """Diagonal in metres of the axis-aligned bounding box of all pieces."""
        bounds = np.stack([piece.bounds for piece in self.pieces])
        return float(np.linalg.norm(bounds[:, 1].max(0) - bounds[:, 0].min(0)))

    @cached_property
    def extent(self) -> float:
        """Diameter in metres of the sphere about the mean vertex that holds all pieces: the same in any frame.

        It is the diagonal of a box, and the length of a capsule.
        """
        middle = np.concatenate([piece.vertices for piece in self.pieces]).mean(axis=0)
        reach = [np.linalg.norm(piece.vertices - middle, axis=1).max() + piece.radius for piece in self.pieces]
        return 2.0 * float(max(reach))

    @cached_property
    def outline(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) with the radii (V, 1) about them, at least vertices that bounding boxes of the body touch."""
        vertices = np.concatenate([piece.vertices for piece in self.pieces])
        radius = np.concatenate([np.full((len(piece.vertices), 1), piece.radius) for piece in self.pieces])
        if radius.any():
            return vertices, radius
        outer = hull(vertices).vertices
        return outer, np.zeros((len(outer), 1))

    @cached_property
    def facets(self) -> Facets:
        """Flat faces; none where nothing is flat."""
        return Facets.of(self.pieces)

    @cached_property
    def area(self) -> float:
        """Exposed surface area in square metres."""
        return float(self.candidates.areas.sum())


def build_body(name: str, pieces: Sequence[Piece], *, candidates: int = 1024, seed: int = 0) -> Body:
    """Return the body made of `pieces`, with `candidates` seeded surface points.

    Raises:
        MeshError: there are no pieces, or none of their surface is exposed.
        GraspRefineError: an argument of another type.
    """
    check_kind("name", name, str)
    check_kind("candidates", candidates, int)
    check_kind("seed", seed, int)
    if not (isinstance(pieces, Sequence) and all(isinstance(piece, Piece) for piece in pieces)):
        raise MeshError(f"{name}: a body is made of a list of pieces, got {describe_value(pieces)}")
    for piece in pieces:
        if not np.isfinite(as_numbers(f"{name}: vertices of a piece", piece.vertices, "V", 3)).all():
            raise MeshError(f"{name}: vertices of a piece must be finite")
    if not pieces:
        raise MeshError(f"{name}: a body needs at least one convex piece")
    try:
        return Body(name, tuple(pieces), sample(pieces, candidates, seed))
    except MeshError as error:
        raise MeshError(f"{name}: {error}") from None
