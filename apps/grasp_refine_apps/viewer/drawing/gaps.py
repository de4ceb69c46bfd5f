"""Signed distance of a link's surface from an object, as a coloured patch over near surface."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import transform, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.scene.hand_object import POINT
from grasp_refine_apps.viewer.drawing.depth import DepthField, DepthPatch, clipped, near_triangles
from grasp_refine_apps.viewer.drawing.shapes import Shape, raised

REACH_M = 0.003
"""Distance in metres up to which a surface is coloured."""

EDGE_M = 0.0012
"""Longest edge of the triangles in metres."""


class GapField:
    """Signed distance of points from a body; built once for a body."""

    def __init__(self, field: DepthField) -> None:
        """Build it; `field` gives the depth of points in the body."""
        self.field = field
        point = build_body("point", [sphere(POINT)], candidates=16)
        self._pairs = Pairs((field.body,), (point,))

    def __call__(
        self, points: Float[np.ndarray, "N 3"], depth: Float[np.ndarray, " N"], reach: float
    ) -> Float[np.ndarray, " N"]:
        """Return the signed distance (N,) of points in the body's frame, metres, negative inside.

        Outside it is exact up to `reach`, and at most that; inside it is that of the depth field.

        Args:
            points: The points.
            depth: Their depth by the field; outside, at least the negated distance.
            reach: Distance in metres.
        """
        distance = np.where(depth > 0.0, -depth, reach)
        near = np.flatnonzero((depth <= 0.0) & (depth > -reach))
        if len(near):
            T = transform(np.broadcast_to(np.eye(3), (len(near), 3, 3)), points[near])[:, None]
            found = query(self._pairs, np.broadcast_to(np.eye(4), T.shape), T, cutoff=reach)
            distance[near] = np.where(found.valid[:, 0], np.minimum(found.distance[:, 0] + POINT, reach), reach)
        return distance


def gap_patch(shape: Shape, T_object_link: Float[np.ndarray, "4 4"], gaps: GapField) -> DepthPatch | None:
    """Return the part of a link's surface within `REACH_M` of an object, link frame; None: none is.

    Args:
        shape: The surface of the link.
        T_object_link: Pose of the link.
        gaps: Distance from the object.
    """
    found = near_triangles(shape, T_object_link, gaps.field, REACH_M + EDGE_M, EDGE_M)
    if found is None:
        return None
    vertices, faces, depth = found
    distance = gaps(transform_points(T_object_link, vertices), depth, REACH_M + EDGE_M)
    if distance.min() >= REACH_M:
        return None
    near = faces[(distance[faces] < REACH_M).any(axis=1)]
    rim = clipped(raised(vertices, faces), near, REACH_M - distance)
    return DepthPatch(rim.vertices, near, rim.depth - REACH_M)
