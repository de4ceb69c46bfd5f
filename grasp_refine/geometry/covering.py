"""Convex pieces that cover a mesh and protrude from it by little more than a limit: its hull where that suffices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.holes import find_holes
from grasp_refine.geometry.mesh import FlatMeshError
from grasp_refine.geometry.pieces import Cut, Piece, cut_meshes, hull
from grasp_refine.geometry.sampling import sample
from grasp_refine.geometry.simplification import simplify

if TYPE_CHECKING:
    import trimesh

MAX_PIECES = 16
"""Most pieces of a mesh; beyond that the smallest are merged with their neighbours."""

MAX_PIECES_PER_BODY = 8
"""Most pieces that CoACD cuts one connected body into."""

SIMPLIFICATION_RATIO = 0.05
"""Distance of the simplified input of CoACD from the mesh, as a fraction of the limit; CoACD's time grows with the
triangles."""

VOXELS_PER_LIMIT = 2.5
"""Voxels of CoACD's remeshing of an open body, per limit: 50 a side for a palm of 100 mm at a limit of 5 mm."""

MIN_PROTRUSION_M = 2e-3
"""Protrusions below this, in metres, or below 1 % of the diagonal of the mesh, are ignored."""

OUTSIDE_TOLERANCE_M = 1e-5
"""Largest distance of a vertex of the mesh outside all pieces, in metres."""

MAX_KEPT_RATIO = 0.9
"""Ratio of the protrusion of several pieces to the protrusion of the hull, above which they are no gain."""

_SURFACE_POINTS, _MESH_POINTS = 2**13, 2**16
"""Points on the exposed surface of pieces, and on the mesh, between which protrusion is measured: 0 to 5 % too small on
25 scanned and drawn objects."""
_NEAREST = 8
"""Points on the mesh, nearest to one on the pieces, to whose triangles its distance is measured. The points alone are
up to 2 % of a cube's edge away where it touches its hull; with 4 triangles it is 1 %, with 8 nothing."""


@dataclass(frozen=True, eq=False)
class Covering:
    """Convex pieces that cover a mesh, and the distances by which they protrude from it."""

    pieces: tuple[Piece, ...]
    """The hull of the mesh, or several pieces that fit better."""
    hull_stands_out: float
    """Largest distance from the mesh to the surface of its hull, in metres; 0 where it is at most `least`."""
    stands_out: float
    """Largest distance from the mesh to the exposed surface of the pieces, in metres; 0 where it is at most `least`."""
    least: float
    """Smallest distance that was measured, in metres; infinite: nothing was measured."""
    trouble: str = ""
    """Reason why a part of the mesh was not cut although it should be; empty: none."""


def covering(
    mesh: trimesh.Trimesh,
    limit: float,
    *,
    cache: Path | None = None,
    progress: Callable[[str], None] | None = None,
    name: str = "mesh",
) -> Covering:
    """Return the hull of `mesh` if it protrudes from it by at most `limit` metres, else several pieces.

    These are the hulls of its connected bodies and, where such a hull protrudes by more than the limit, the pieces that
    CoACD cuts the body into: at most `MAX_PIECES_PER_BODY` a body, `MAX_PIECES` in all, even if they protrude by more.
    Pieces inside another one are dropped. Each vertex of the mesh is in a piece, and no piece goes beyond the hull, to
    within `OUTSIDE_TOLERANCE_M`. Without a measurable gain the hull is kept.

    Args:
        mesh: Closed or open, one body or several.
        limit: Largest protrusion in metres; infinite: always the hull, and nothing is measured.
        cache: Folder of earlier cuts; None: no cache.
        progress: Called with a line before and one after CoACD cuts.
        name: Name in messages.

    Raises:
        MeshError: the mesh has no thickness, or the limit is not positive.
    """
    if not limit > 0:
        raise MeshError(f"the hull of a mesh can stand out of it by a limit above 0 m only, got {limit:g} m")
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    whole = hull(vertices[np.unique(mesh.faces)], name=name)
    if np.isinf(limit):
        return Covering((whole,), 0.0, 0.0, least=np.inf)
    # Searching a long arm for 2 mm would take long.
    least = min(limit, max(MIN_PROTRUSION_M, 0.01 * float(np.linalg.norm(np.ptp(vertices, axis=0)))))
    mesh = _without_small_holes(mesh, least)
    before = protrusion([whole], mesh, least)
    if before <= limit:
        return Covering((whole,), before, before, least)
    found, troubles = _body_pieces(mesh, limit, cache, progress, name)
    pieces = _merge_smallest(_outermost(found)) or [whole]
    pieces = [_clip_to_hull(whole, piece) for piece in _extend_to(pieces, vertices[np.unique(mesh.faces)])]
    after = protrusion(pieces, mesh, least)
    if after > MAX_KEPT_RATIO * before:
        return Covering(
            (whole,),
            before,
            before,
            least,
            "; ".join(troubles) or f"{len(pieces)} piece{'s stand' if len(pieces) > 1 else ' stands'} out as far",
        )
    return Covering(tuple(pieces), before, after, least, "; ".join(troubles))


def protrusion(pieces: Sequence[Piece], mesh: trimesh.Trimesh, least: float) -> float:
    """Protrusion of the union of `pieces` from `mesh`, in metres; 0 where it is at most `least`.

    That is the largest distance from points on the exposed surface of the pieces to the mesh: to the triangles of the
    `_NEAREST` points on it.
    """
    import trimesh
    from scipy.spatial import KDTree

    on_mesh, sampled = trimesh.sample.sample_surface(mesh, _MESH_POINTS, seed=0)
    # Vertices are points of one of their triangles: small ones may have no sampled point.
    triangle = np.zeros(len(mesh.vertices), dtype=np.int64)
    triangle[mesh.faces] = np.arange(len(mesh.faces))[:, None]
    # Built in half of the time, and asked once.
    tree = KDTree(np.concatenate([on_mesh, mesh.vertices]), balanced_tree=False, compact_nodes=False)
    exposed = sample(pieces, _SURFACE_POINTS, seed=0).points
    # Its triangle is no farther than a point on it.
    exposed = exposed[tree.query(exposed)[0] > least]
    if not len(exposed):
        return 0.0
    near = tree.query(exposed, k=_NEAREST)[1].ravel()
    # Tolerances of trimesh are for triangles about 1 large.
    corners = mesh.triangles[np.concatenate([sampled, triangle])[near]] / mesh.scale
    points = np.repeat(exposed, _NEAREST, axis=0) / mesh.scale
    distances = np.linalg.norm(trimesh.triangles.closest_point(corners, points) - points, axis=1)
    found = float(distances.reshape(-1, _NEAREST).min(axis=1).max() * mesh.scale)
    return found if found > least else 0.0


def _without_small_holes(mesh: trimesh.Trimesh, size: float) -> trimesh.Trimesh:
    """Mesh with filled holes of three edges, and of four edges no wider than `size` metres.

    The hull does not protrude over a small hole. A wide hole of four edges may be intended.
    """
    import trimesh

    if mesh.is_watertight:
        return mesh
    try:
        holes = find_holes(mesh)
    except MeshError:
        return mesh
    rims = [hole.rim for hole in holes if len(hole.rim) == 3 or (len(hole.rim) == 4 and hole.width <= size)]
    if not rims:
        return mesh
    caps = [[rim[0], *rim[at : at + 2]] for rim in rims for at in range(1, len(rim) - 1)]
    return trimesh.Trimesh(mesh.vertices, np.concatenate([mesh.faces, caps]), process=False)


def _body_pieces(
    mesh: trimesh.Trimesh, limit: float, cache: Path | None, progress: Callable[[str], None] | None, name: str
) -> tuple[list[Piece], list[str]]:
    """Hulls of the connected bodies of a mesh, or the pieces that CoACD cuts them into, and the errors of CoACD.

    Bodies whose hulls protrude the most are cut first, until there are `MAX_PIECES` pieces: more would be merged again.
    """
    solid, flat, troubles = [], [], []
    for body in mesh.split(only_watertight=False, repair=False):
        try:
            solid.append((body, hull(body.vertices, name=name)))
        except FlatMeshError:
            flat.append(np.asarray(body.vertices, dtype=np.float64))
    measured = [protrusion([whole], body, limit) for body, whole in solid]
    pieces = _flat_hulls(flat)
    for index in np.argsort(-np.array(measured), kind="stable"):
        body, whole = solid[index]
        found = [whole]
        if measured[index] > 0 and len(pieces) < MAX_PIECES:
            try:
                cut = _cut(body, limit, cache, progress, name)
                found = list(cut.pieces)
                troubles += [cut.shortfall] if cut.shortfall else []
            except MeshError as error:
                troubles.append(str(error))
        pieces += found
    return pieces, troubles


def _cut(
    body: trimesh.Trimesh, limit: float, cache: Path | None, progress: Callable[[str], None] | None, name: str
) -> Cut:
    """Cut a connected mesh with CoACD.

    Raises:
        MeshError: CoACD fails.
    """
    import trimesh

    # CoACD's threshold is about the protrusion of its pieces, the mesh being 2 long.
    threshold = float(np.clip(limit / (np.ptp(body.vertices, axis=0).max() / 2), 0.01, 1.0))
    settings = Decomposition(threshold, MAX_PIECES_PER_BODY, mcts_nodes=10, mcts_iterations=60, mcts_max_depth=2)
    simpler = trimesh.Trimesh(*simplify(body.vertices, body.faces, SIMPLIFICATION_RATIO * limit), process=False)
    if simpler.is_watertight and simpler.is_winding_consistent:
        return cut_meshes([(name, simpler)], settings, cache=cache, progress=progress)[0]
    # Remeshing turns 500 triangles of an open fingertip into 100,000 at 50 voxels a side, whatever the limit. So it is
    # the second attempt, with voxels that suit the limit.
    voxels = int(np.clip(VOXELS_PER_LIMIT * 2 / threshold, 20, settings.preprocess_resolution))
    best: tuple[float, Cut] | None = None
    for attempt in (replace(settings, preprocess="off"), replace(settings, preprocess_resolution=voxels)):
        with suppress(MeshError) if attempt.preprocess == "off" or best else nullcontext():
            (cut,) = cut_meshes([(name, simpler)], attempt, cache=cache, progress=progress)
            stands_out = protrusion(cut.pieces, body, limit)
            if best is None or stands_out < best[0]:
                best = stands_out, cut
            if stands_out <= limit:
                break
    assert best is not None  # or the second attempt raised
    return best[1]


def _flat_hulls(flat: Sequence[np.ndarray]) -> list[Piece]:
    """Hulls of flat bodies, given their points; bodies whose boxes touch are the sides of one body."""
    groups: list[np.ndarray] = []
    for points in flat:
        near = [group for group in groups if _boxes_touch(group, points)]
        groups = [group for group in groups if not any(group is other for other in near)]
        groups.append(np.concatenate([*near, points]))
    return [piece for group in groups for piece in _thin_hull(group)]


def _boxes_touch(one: np.ndarray, other: np.ndarray) -> bool:
    gap = np.maximum(one.min(axis=0) - other.max(axis=0), other.min(axis=0) - one.max(axis=0))
    return bool(gap.max() <= OUTSIDE_TOLERANCE_M)


def _thin_hull(points: np.ndarray) -> list[Piece]:
    """Hull of some points; `OUTSIDE_TOLERANCE_M` thick on either side if they lie in a plane, none if on a line."""
    with suppress(MeshError):
        return [hull(points)]
    step = OUTSIDE_TOLERANCE_M * np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    with suppress(MeshError):
        return [hull(np.concatenate([points - step, points + step]))]
    return []


def _outermost(pieces: Sequence[Piece]) -> list[Piece]:
    """Pieces that do not lie inside another piece; of two equal pieces, the first."""
    kept: list[Piece] = []
    for piece in sorted(pieces, key=lambda piece: -_box_volume([piece])):
        if not any((_plane_distance(piece.vertices, other) <= OUTSIDE_TOLERANCE_M).all() for other in kept):
            kept.append(piece)
    return kept


def _merge_smallest(pieces: Sequence[Piece]) -> list[Piece]:
    """Merge down to `MAX_PIECES` pieces: repeatedly the smallest, with the piece whose box it enlarges least."""
    pieces = list(pieces)
    while len(pieces) > MAX_PIECES:
        small = min(range(len(pieces)), key=lambda index: _box_volume([pieces[index]]))
        piece = pieces.pop(small)
        near = min(
            range(len(pieces)),
            key=lambda index: _box_volume([piece, pieces[index]]) - _box_volume([pieces[index]]),
        )
        pieces[near] = hull(np.concatenate([piece.vertices, pieces[near].vertices]))
    return _outermost(pieces)


def _extend_to(pieces: Sequence[Piece], points: np.ndarray) -> list[Piece]:
    """Extend each piece to the `points` nearest to it that are more than `OUTSIDE_TOLERANCE_M` outside all pieces."""
    beyond = np.stack([_plane_distance(points, piece) for piece in pieces])
    nearest, lost = beyond.argmin(axis=0), beyond.min(axis=0) > OUTSIDE_TOLERANCE_M
    grown = []
    for index, piece in enumerate(pieces):
        own = points[lost & (nearest == index)]
        grown.append(hull(np.concatenate([piece.vertices, own])) if len(own) else piece)
    return grown


def _clip_to_hull(whole: Piece, piece: Piece) -> Piece:
    """Part of a piece inside the hull of the mesh: remeshing makes bodies thicker."""
    if (_plane_distance(piece.vertices, whole) <= OUTSIDE_TOLERANCE_M).all():
        return piece
    import manifold3d

    solids = [manifold3d.Manifold.hull_points(one.vertices) for one in (whole, piece)]
    return hull((solids[0] ^ solids[1]).to_mesh64().vert_properties[:, :3])


def _plane_distance(points: np.ndarray, piece: Piece) -> np.ndarray:
    """Largest plane distance (N,) of `points` (N, 3) outside a piece, in metres; negative inside."""
    normals, offsets = piece.planes
    return (points @ normals.T - offsets).max(axis=1)


def _box_volume(pieces: Sequence[Piece]) -> float:
    """Volume of the box around some pieces."""
    bounds = np.stack([piece.bounds for piece in pieces])
    return float(np.prod(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
