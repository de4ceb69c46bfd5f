"""Nearest points of an object's surface."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.objects.object import Object

POINT_M = 1e-6
"""Radius in metres of the spheres that represent points."""


def nearest_surface(
    obj: Object, points: Float[np.ndarray, "P 3"]
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "P 3"], Float[np.ndarray, " P"]]:
    """Return the nearest points (P, 3) of an object's surface, its outward normals there, and signed distances (P,).

    Distances are in metres, negative inside; infinite where a query failed.
    """
    dot = build_body("point", (sphere(POINT_M),), candidates=1)
    T = np.tile(np.eye(4), (len(points), 1, 1, 1))
    T[:, 0, :3, 3] = points
    witness = query(Pairs.against((dot,), obj.body), T, np.broadcast_to(np.eye(4), T.shape))
    distance = np.where(witness.valid, witness.distance + POINT_M, np.inf)
    return witness.point_b[:, 0], -witness.normal[:, 0], distance[:, 0]
