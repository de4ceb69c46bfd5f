"""Depth of one surface in another body, as coloured patches where they overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Float32, Int, UInt8
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.viewer.drawing.colors import distance_colors
from grasp_refine_apps.viewer.drawing.shapes import Shape

EDGE_M = 0.0015
"""Longest edge of a patch's triangles in metres."""

CUT_M = 2e-4
"""Distance in front of a face, metres, at which it is looked for another piece."""

MAX_FACES = 30_000
"""Number of triangles from which on they are not made smaller."""


@dataclass(frozen=True, eq=False)
class DepthPatch:
    """Part of a surface that lies in another body."""

    vertices: Float32[np.ndarray, "V 3"]
    """Vertices (V, 3) in the frame of the surface, metres."""
    faces: Int[np.ndarray, "F 3"]
    """Triangles (F, 3)."""
    depth: Float[np.ndarray, " V"]
    """Depth (V,) in metres, 0 on the rim."""

    @property
    def colors(self) -> UInt8[np.ndarray, "V 3"]:
        """Colours (V, 3) of the vertices, by the scale of distances."""
        return distance_colors(-self.depth)


@dataclass(frozen=True, eq=False)
class DepthField:
    """Depth of points in a body; built once for a body."""

    body: Body
    """The body."""
    exposed: tuple[Bool[np.ndarray, " _P"], ...]
    """Of each piece, which planes are surface of the body, and not a cut that faces another piece."""

    @staticmethod
    def of(body: Body) -> DepthField:
        """Build the field of a body."""
        found = []
        for piece in body.pieces:
            normals, _ = piece.planes
            solid = piece.normals.any(axis=1)
            middle = piece.vertices[piece.faces[solid]].mean(axis=1) if len(normals) else np.zeros((0, 3))
            outside = middle + (piece.radius + CUT_M) * normals
            others = [_depth_in_piece(other, outside) for other in body.pieces if other is not piece]
            found.append(np.max(others, axis=0) < 0.0 if others else np.ones(len(outside), dtype=bool))
        return DepthField(body, tuple(found))

    def __call__(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """Return the depth (N,) of points in the body's frame, metres; negative outside.

        Inside it is the distance to the nearest plane of the piece in which the point is deepest, without cuts between
        pieces: exact for convex bodies. Outside it is at most the distance to the body, negated, and changes by no more
        than a point moves.
        """
        parts = zip(self.body.pieces, self.exposed, strict=True)
        return np.max([_depth_in_piece(piece, points, exposed) for piece, exposed in parts], axis=0)


def _depth_in_piece(
    piece: Piece, points: Float[np.ndarray, "N 3"], exposed: Bool[np.ndarray, " P"] | None = None
) -> Float[np.ndarray, " N"]:
    """Depth (N,) in a convex piece, negative outside; inside by its `exposed` planes only, if there are any."""
    if piece.radius > 0 and len(piece.vertices) <= 2:
        a, b = piece.vertices[0], piece.vertices[-1]
        axis = b - a
        along = np.clip((points - a) @ axis / max(float(axis @ axis), np.finfo(np.float64).tiny), 0.0, 1.0)
        return piece.radius - np.linalg.norm(points - a - along[:, None] * axis, axis=1)
    normals, offsets = piece.planes
    gaps = piece.radius + offsets - points @ normals.T
    depth = gaps.min(axis=1)
    if exposed is None or not exposed.any():
        return depth
    return np.where(depth >= 0.0, gaps[:, exposed].min(axis=1), depth)


def depth_patch(shape: Shape, T_body_shape: Float[np.ndarray, "4 4"], field: DepthField) -> DepthPatch | None:
    """Return the part of a shape that lies in a body; None: none does.

    Triangles are halved until their edges are short.
    """
    fine = near_triangles(shape, T_body_shape, field, 0.0, EDGE_M)
    return None if fine is None else clipped(*fine)


def near_triangles(
    shape: Shape, T_body_shape: Float[np.ndarray, "4 4"], field: DepthField, reach: float, edge_m: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], Float[np.ndarray, " V"]] | None:
    """Return small triangles of a shape that are in a body or may be near it; None: there are none.

    Triangles are halved until their edges are short. Triangles that cannot come near the body are left out first: depth
    changes by no more than a point moves.

    Args:
        shape: The shape.
        T_body_shape: Its pose in the frame of the body.
        field: Depth in the body.
        reach: Distance from the body in metres up to which triangles count.
        edge_m: Longest edge in metres of the returned triangles.

    Returns:
        Vertices (V, 3) in the frame of the shape, triangles (F, 3), and the depths (V,) of the vertices in metres.
    """
    import trimesh

    vertices, faces = np.asarray(shape.vertices, dtype=float), np.asarray(shape.faces, dtype=np.int64)
    while True:
        depth = field(transform_points(T_body_shape, vertices))
        corners = vertices[faces]
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        # Where all edges are short, only near triangles are left.
        fine = not len(edge) or edge.max() <= edge_m or len(faces) > MAX_FACES
        near = depth[faces].max(axis=1) > (-reach if fine else -reach - edge)
        long = edge[near] > edge_m
        used, renumbered = np.unique(faces[near], return_inverse=True)
        if not len(used):
            return None
        vertices, faces = vertices[used], renumbered.reshape(-1, 3)
        if fine:
            return vertices, faces, depth[used]
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, face_index=np.flatnonzero(long))


def clipped(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], depth: Float[np.ndarray, " V"]
) -> DepthPatch:
    """Return the patch whose outer vertices are moved to where the depth is 0, along their edges inwards.

    Args:
        vertices: Vertices (V, 3) of a surface.
        faces: Its triangles.
        depth: Depths (V,), negative outside.
    """
    ends = np.concatenate([faces[:, [a, b]] for a in range(3) for b in range(3) if a != b])
    out, into = np.unique(ends[(depth[ends[:, 0]] < 0) & (depth[ends[:, 1]] > 0)], axis=0).T
    share = depth[out] / (depth[out] - depth[into])
    crossing = vertices[out] + share[:, None] * (vertices[into] - vertices[out])
    count = np.bincount(out, minlength=len(vertices))
    moved, place = count > 0, vertices.copy()
    place[moved] = np.stack([np.bincount(out, crossing[:, k], len(vertices)) for k in range(3)], axis=1)[moved]
    place[moved] /= count[moved, None]
    return DepthPatch(place.astype(np.float32), faces, np.where(moved, 0.0, depth))


def overlap_patches(
    link: Shape, in_link: DepthField, obj: Shape, in_object: DepthField, T_object_link: Float[np.ndarray, "4 4"]
) -> tuple[DepthPatch | None, DepthPatch | None]:
    """Return the part of a link that lies in the object, link frame, and that of the object in the link, its frame."""
    return depth_patch(link, T_object_link, in_object), depth_patch(obj, inverse(T_object_link), in_link)
