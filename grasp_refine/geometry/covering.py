"""Convex pieces that cover a mesh and stand out of it by little more than a limit: its hull where that will do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry import cache as disk
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.holes import find_holes
from grasp_refine.geometry.mesh import FlatMeshError
from grasp_refine.geometry.nearest_triangle import Triangles
from grasp_refine.geometry.over_cover import PRECISION, over_cover
from grasp_refine.geometry.pieces import Piece, convex_pieces, hull

if TYPE_CHECKING:
    import trimesh

MOST = 16
"""Most pieces of a mesh; beyond that the smallest are joined with those near them."""

MOST_CUTS = 8
"""Most pieces that CoACD cuts one connected body into."""

SIMPLER = 0.05
"""How far what CoACD cuts may lie from the mesh, as a share of the limit; CoACD's time grows with the triangles."""

NOTICED = 2e-3
"""Pieces that stand out by less than this, in metres, or 1 % of the diagonal of the mesh, do so unnoticed."""

OUTSIDE = 1e-5
"""No vertex of the mesh is farther outside all pieces than this, in metres."""

_SCHEMA = 1
"""Of what is measured; a new one leaves all old cache entries unused."""


@dataclass(frozen=True, eq=False)
class Covering:
    """Convex pieces that cover a mesh, and how far they stand out of it."""

    pieces: tuple[Piece, ...]
    """The hull of the mesh, or several pieces that do better."""
    hull_stands_out: float
    """How far the hull of the whole mesh stands out of it, in metres; 0 where that is no more than `least`."""
    stands_out: float
    """How far the pieces do, likewise."""
    least: float
    """What was looked for, in metres; infinite: nothing was measured."""
    trouble: str = ""
    """Why a part of the mesh was not cut, if that was meant."""


def covering(
    mesh: trimesh.Trimesh,
    limit: float,
    *,
    cache: Path | None = None,
    progress: Callable[[str], None] | None = None,
    name: str = "mesh",
) -> Covering:
    """The hull of `mesh` if it stands out of it by no more than `limit` metres, else several pieces.

    These are the hulls of its connected bodies and, where such a hull stands out by more than the limit, what CoACD
    cuts the body into: at most `MOST_CUTS` pieces a body, `MOST` in all, even if they stand out by more. Pieces inside
    another one are dropped. Each vertex of the mesh is in a piece, and no piece goes beyond the hull, to within
    `OUTSIDE`. Where all this gains nothing that can be measured, the hull stays.

    Args:
        mesh: Closed or open, one body or several.
        limit: In metres; infinite: always the hull, and nothing is measured.
        cache: Folder of what was cut and measured before; None keeps nothing.
        progress: Gets a line before and one after CoACD cuts.
        name: For messages.

    Raises:
        MeshError: the mesh has no thickness, or the limit is not positive.
    """
    if not limit > 0:
        raise MeshError(f"the hull of a mesh can stand out of it by a limit above 0 m only, got {limit:g} m")
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    whole = hull(vertices[np.unique(mesh.faces)], name=name)
    if np.isinf(limit):
        return Covering((whole,), 0.0, 0.0, least=np.inf)
    # To look for 2 mm all over a long arm would take long.
    least = min(limit, max(NOTICED, 0.01 * float(np.linalg.norm(np.ptp(vertices, axis=0)))))
    mesh = _without_small_holes(mesh, least)
    triangles = Triangles(vertices[mesh.faces])
    before = _measured([whole], triangles, least, cache)
    if before <= limit:
        return Covering((whole,), before, before, least)
    found, troubles = _body_pieces(mesh, limit, cache, progress, name)
    pieces = _joined(_outermost(found)) or [whole]
    pieces = [_within(whole, piece) for piece in _reaching(pieces, vertices[np.unique(mesh.faces)])]
    after = _measured(pieces, triangles, least, cache)
    if after > (1 - 2 * PRECISION) * before:
        return Covering(
            (whole,),
            before,
            before,
            least,
            "; ".join(troubles) or f"{len(pieces)} piece{'s stand' if len(pieces) > 1 else ' stands'} out as far",
        )
    return Covering(tuple(pieces), before, after, least, "; ".join(troubles))


def _without_small_holes(mesh: trimesh.Trimesh, size: float) -> trimesh.Trimesh:
    """A mesh without missing triangles, and without holes of four edges no wider than `size` metres.

    What a small hole lets in is no place where the hull stands out. A wide hole of four edges may be meant.
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
    """The hulls of the connected bodies of a mesh, or what CoACD cuts them into, and what went wrong in that.

    Those whose hulls stand out the most are cut first, until there are `MOST` pieces: more would be joined again.
    """
    solid, flat, troubles = [], [], []
    for body in mesh.split(only_watertight=False, repair=False):
        try:
            solid.append((body, hull(body.vertices, name=name)))
        except FlatMeshError:
            flat.append(np.asarray(body.vertices, dtype=np.float64))
    measured = [
        _measured([whole], Triangles(np.asarray(body.vertices, dtype=np.float64)[body.faces]), limit, cache)
        for body, whole in solid
    ]
    pieces = _patches(flat)
    for index in np.argsort(-np.array(measured), kind="stable"):
        body, whole = solid[index]
        found = [whole]
        if measured[index] > 0 and len(pieces) < MOST:
            try:
                found = _cut(body, limit, cache, progress, name)
            except MeshError as error:
                troubles.append(str(error))
        pieces += found
    return pieces, troubles


def _cut(
    body: trimesh.Trimesh, limit: float, cache: Path | None, progress: Callable[[str], None] | None, name: str
) -> list[Piece]:
    """What CoACD cuts a connected mesh into.

    Raises:
        MeshError: CoACD fails.
    """
    # CoACD's threshold is about how far its pieces stand out, the mesh being 2 long.
    threshold = float(np.clip(limit / (np.ptp(body.vertices, axis=0).max() / 2), 0.01, 1.0))
    settings = Decomposition(threshold, MOST_CUTS, mcts_nodes=10, mcts_iterations=60, mcts_max_depth=2)
    return list(convex_pieces(_simplified(body, SIMPLER * limit), settings, cache=cache, progress=progress, name=name))


def _patches(flat: Sequence[np.ndarray]) -> list[Piece]:
    """The hulls of flat bodies, whose points these are; those whose boxes touch are the sides of one body."""
    groups: list[np.ndarray] = []
    for points in flat:
        near = [group for group in groups if _boxes_touch(group, points)]
        groups = [group for group in groups if not any(group is other for other in near)]
        groups.append(np.concatenate([*near, points]))
    return [piece for group in groups for piece in _sheet(group)]


def _boxes_touch(one: np.ndarray, other: np.ndarray) -> bool:
    gap = np.maximum(one.min(axis=0) - other.max(axis=0), other.min(axis=0) - one.max(axis=0))
    return bool(gap.max() <= OUTSIDE)


def _sheet(points: np.ndarray) -> list[Piece]:
    """The hull of some points; `OUTSIDE` thick on either side if they lie in a plane, nothing if on a line."""
    with suppress(MeshError):
        return [hull(points)]
    step = OUTSIDE * np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    with suppress(MeshError):
        return [hull(np.concatenate([points - step, points + step]))]
    return []


def _simplified(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh:
    """A mesh with fewer triangles, no farther from `mesh` than `tolerance`; itself if it is not a closed manifold."""
    import manifold3d
    import trimesh

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.uint64))
    )
    simpler = solid.simplify(tolerance).to_mesh64()
    if solid.status() != manifold3d.Error.NoError or len(simpler.tri_verts) < 4:
        return mesh
    return trimesh.Trimesh(simpler.vert_properties[:, :3], simpler.tri_verts.astype(np.int64), process=False)


def _measured(pieces: Sequence[Piece], mesh: Triangles, least: float, cache: Path | None) -> float:
    """How far pieces stand out of a mesh, 0 if by no more than `least`; looked up where it was measured before."""
    corners = np.concatenate([piece.vertices for piece in pieces])
    settings = f"over-cover {_SCHEMA} {least!r} {PRECISION} {[len(piece.vertices) for piece in pieces]}"
    faces = np.concatenate([piece.faces for piece in pieces])
    entry = cache and cache / disk.entry_name(np.concatenate([corners, mesh.corners.reshape(-1, 3)]), faces, settings)
    known = disk.load_arrays(entry, "over_cover") if entry else None
    if known and known[0].shape == () and known[0].dtype == np.float64:
        return float(known[0])
    found = over_cover(pieces, mesh, least=least)
    if entry:
        with suppress(OSError):  # it is measured again the next time
            disk.save_arrays(entry, over_cover=np.array(found))
    return found


def _outermost(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces that do not lie inside another one; of two that are the same, the first."""
    kept: list[Piece] = []
    for piece in sorted(pieces, key=lambda piece: -_box_volume([piece])):
        if not any((_beyond(piece.vertices, other) <= OUTSIDE).all() for other in kept):
            kept.append(piece)
    return kept


def _joined(pieces: Sequence[Piece]) -> list[Piece]:
    """At most `MOST` pieces: the smallest is joined with that one with which it fills the smallest box, and so on."""
    pieces = list(pieces)
    while len(pieces) > MOST:
        small = min(range(len(pieces)), key=lambda index: _box_volume([pieces[index]]))
        piece = pieces.pop(small)
        near = min(
            range(len(pieces)),
            key=lambda index: _box_volume([piece, pieces[index]]) - _box_volume([pieces[index]]),
        )
        pieces[near] = hull(np.concatenate([piece.vertices, pieces[near].vertices]))
    return _outermost(pieces)


def _reaching(pieces: Sequence[Piece], points: np.ndarray) -> list[Piece]:
    """The pieces, each grown to those `points` that are more than `OUTSIDE` out of all of them and nearest to it."""
    beyond = np.stack([_beyond(points, piece) for piece in pieces])
    nearest, lost = beyond.argmin(axis=0), beyond.min(axis=0) > OUTSIDE
    grown = []
    for index, piece in enumerate(pieces):
        own = points[lost & (nearest == index)]
        grown.append(hull(np.concatenate([piece.vertices, own])) if len(own) else piece)
    return grown


def _within(whole: Piece, piece: Piece) -> Piece:
    """The part of a piece that lies in the hull of the mesh: remeshing makes bodies thicker."""
    if (_beyond(piece.vertices, whole) <= OUTSIDE).all():
        return piece
    import manifold3d

    solids = [manifold3d.Manifold.hull_points(one.vertices) for one in (whole, piece)]
    return hull((solids[0] ^ solids[1]).to_mesh64().vert_properties[:, :3])


def _beyond(points: np.ndarray, piece: Piece) -> np.ndarray:
    """How far each of `points` (N, 3) is beyond the worst of the planes of a piece, in metres."""
    normals, offsets = piece.planes
    return (points @ normals.T - offsets).max(axis=1)


def _box_volume(pieces: Sequence[Piece]) -> float:
    """Volume of the box around some pieces."""
    bounds = np.stack([piece.bounds for piece in pieces])
    return float(np.prod(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
