"""Holes in the surface of a mesh: detection, and flat caps for flat holes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import MeshError

if TYPE_CHECKING:
    import trimesh

FLATNESS_RATIO = 0.02
"""Largest distance of a flat hole's rim from its plane, as a fraction of the rim's diagonal."""

COPLANARITY_RATIO = 1e-3
"""Largest distance between the planes of two rims of one cap, as a fraction of the mesh's diagonal."""


@dataclass(frozen=True, eq=False)
class Hole:
    """A hole, seen from outside the mesh."""

    rim: np.ndarray
    """Vertices (V,) in the order of a face that closes the hole."""
    center: np.ndarray
    """Mean (3,) of the rim, in metres."""
    normal: np.ndarray
    """Unit normal (3,) of the plane that fits the rim best, out of the mesh."""
    bounds: np.ndarray
    """Lower and upper corner (2, 3) of the rim's bounding box, in metres."""
    flat: bool
    """Whether the rim lies in that plane up to `FLATNESS_RATIO`."""

    @property
    def width(self) -> float:
        """Diagonal of the bounding box in metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))


def find_holes(mesh: trimesh.Trimesh) -> tuple[Hole, ...]:
    """Return the holes of `mesh`, whose faces are oriented consistently, the widest first.

    Raises:
        MeshError: rims meet in a vertex, or more than two faces in an edge, which leaves the holes ambiguous.
    """
    count = len(mesh.vertices)
    a, b = np.asarray(mesh.edges).T
    forth, back = a * count + b, b * count + a
    codes, amounts = np.unique(forth, return_counts=True)
    open_edges = ~np.isin(forth, back)
    if (amounts > 1).any() or len(np.unique(a[open_edges])) < open_edges.sum():
        raise MeshError("its open edges do not form simple rims")
    # A cap runs along each open edge the other way.
    following = dict(zip(b[open_edges].tolist(), a[open_edges].tolist(), strict=True))
    holes = []
    while following:
        rim = [next(iter(following))]
        while (vertex := following.pop(rim[-1])) != rim[0]:
            rim.append(vertex)
        holes.append(_hole(mesh.vertices, np.array(rim)))
    return tuple(sorted(holes, key=lambda hole: -hole.width))


def cap_holes(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, str]:
    """Close the holes of `mesh` with flat faces between the vertices of their rims; also returns a note in words.

    Two rims around each other in one plane are closed with a ring.

    Raises:
        MeshError: a hole is not flat, or the rims cross each other.
    """
    import trimesh

    holes = find_holes(mesh)
    for hole in holes:
        if not hole.flat:
            raise MeshError(f"a hole of {len(hole.rim)} edges, {hole.width * 1e3:.3g} mm across, is not flat")
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    caps, waiting = [], list(holes)
    while waiting:
        first = waiting[0]
        together = [hole for hole in waiting if _is_within(hole, first, COPLANARITY_RATIO * diagonal)]
        waiting = [hole for hole in waiting if not any(hole is other for other in together)]
        caps.append(_cap(mesh.vertices, together))
    closed = trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, *caps]), process=False)
    what = "a flat hole" if len(holes) == 1 else f"{len(holes)} flat holes"
    return closed, f"{what}, up to {holes[0].width * 1e3:.3g} mm across, closed with flat caps"


def _hole(vertices: np.ndarray, rim: np.ndarray) -> Hole:
    points = vertices[rim]
    center = points.mean(axis=0)
    # Newell: twice the area vector of the polygon, however it is bent.
    vector = np.cross(points - center, np.roll(points, -1, axis=0) - center).sum(axis=0)
    length = float(np.linalg.norm(vector))
    normal = vector / length if length > 0 else np.zeros(3)
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    bent = np.abs((points - center) @ normal).max()
    return Hole(
        rim,
        center,
        normal,
        bounds,
        bool(length > 0 and bent <= FLATNESS_RATIO * np.linalg.norm(np.ptp(bounds, axis=0))),
    )


def _is_within(inner: Hole, outer: Hole, distance: float) -> bool:
    """Return whether a flat hole lies in the plane of another and, by its box, inside it; a hole lies in itself."""
    parallel = abs(inner.normal @ outer.normal) > 1 - FLATNESS_RATIO**2
    coplanar = abs((inner.center - outer.center) @ outer.normal) <= distance
    low, high = outer.bounds
    inside = (inner.bounds[0] >= low - distance).all() and (inner.bounds[1] <= high + distance).all()
    return bool(parallel and coplanar and inside)


def _cap(vertices: np.ndarray, holes: list[Hole]) -> np.ndarray:
    """Triangles (F, 3) between the rims of coplanar `holes`, the widest first."""
    import manifold3d

    normal = holes[0].normal
    x = np.linalg.svd(normal[None])[2][1]
    plane = np.stack([x, np.cross(normal, x)], axis=1)
    rims = [vertices[hole.rim] @ plane for hole in holes]
    triangles = np.asarray(manifold3d.triangulate(rims), dtype=np.int64).reshape(-1, 3)
    corners = np.concatenate(rims)[triangles]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    if areas.min(initial=0.0) < -1e-9 * np.abs(areas).sum():
        raise MeshError("the rims of its holes cross each other")
    return np.concatenate([hole.rim for hole in holes])[triangles]
