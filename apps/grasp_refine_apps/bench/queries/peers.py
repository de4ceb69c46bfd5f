"""Peers: a loop of distance queries over all piece pairs of two bodies, for each pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Literal

import coal
import mujoco
import numpy as np

from grasp_refine.collision.certified_distance import Tolerances
from grasp_refine.collision.query import Pairs
from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import Body
from grasp_refine_apps.bench.mujoco_distance import MujocoBodies

Loop = Callable[[], np.ndarray]
"""Signed distances (N,) of all poses, in metres."""


PeerName = Literal["coal-fresh", "coal-reused", "mujoco"]


@dataclass(frozen=True)
class Peer:
    """A library, called as its user would."""

    name: PeerName
    """Name in rows."""
    what: str
    """Explanation for people."""
    tolerance_m: float
    """Its convergence tolerance, as used, in metres."""
    loop: Callable[[Pairs, np.ndarray, np.ndarray], Loop]
    """From a pair of bodies and their poses (N, 1, 4, 4) to the timed loop; shapes and poses are made before."""


def fresh_coal(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> Loop:
    """Loop over `coal.distance` with new request and result objects, as its examples do, with its own tolerances."""
    side_a, side_b = _shapes(pairs.a[0]), _shapes(pairs.b[0])
    poses, identity = _transforms(T_a, T_b), coal.Transform3s()

    def run() -> np.ndarray:
        found = []
        for pose in poses:
            best = np.inf
            for a, b in product(side_a, side_b):
                result = coal.DistanceResult()
                d = coal.distance(a, identity, b, pose, coal.DistanceRequest(), result)
                if d < best:
                    best, _ = d, (result.getNearestPoint1(), result.normal)
            found.append(best)
        return np.array(found)

    return run


def reused_coal(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> Loop:
    """Loop over `ComputeDistance` of coal, with one request and one result for all, and our tolerances."""
    side_a, side_b = _shapes(pairs.a[0]), _shapes(pairs.b[0])
    functions = [coal.ComputeDistance(a, b) for a, b in product(side_a, side_b)]
    poses, identity = _transforms(T_a, T_b), coal.Transform3s()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance, request.epa_tolerance = pairs.tolerances.gjk, pairs.tolerances.epa

    def run(keep_alive: object = (side_a, side_b)) -> np.ndarray:
        found = []
        for pose in poses:
            best = np.inf
            for distance in functions:
                result.clear()
                d = distance(identity, pose, request, result)
                if d < best:
                    best, _ = d, (result.getNearestPoint1(), result.normal.copy())
            found.append(best)
        return np.array(found)

    return run


def mujoco_loop(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> Loop:
    """Loop over `mj_geomDistance` of mesh geoms, with the best distance so far as cutoff."""
    return MujocoBodies(pairs.a[0], pairs.b[0]).loop(T_a[:, 0], T_b[:, 0])


PEERS = (
    Peer("coal-fresh", "coal.distance, fresh objects", coal.DistanceRequest().gjk_tolerance, fresh_coal),
    Peer("coal-reused", "coal ComputeDistance, reused objects", Tolerances.gjk, reused_coal),
    Peer("mujoco", "MuJoCo mj_geomDistance", mujoco.MjOption().ccd_tolerance, mujoco_loop),
)
"""All peers; each queries every piece pair, without pruning."""


def _shapes(body: Body) -> list[coal.ConvexBase]:
    result = []
    for piece in body.pieces:
        points = coal.StdVec_Vec3s()
        points.extend(list(piece.vertices))
        result.append(coal.Convex.convexHull(points, True, "Qt"))
    return result


def _transforms(T_a: np.ndarray, T_b: np.ndarray) -> list[coal.Transform3s]:
    """Return poses of the second bodies in the frames of the first."""
    return [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in inverse(T_a[:, 0]) @ T_b[:, 0]]
