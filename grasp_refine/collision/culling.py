"""Queries in the loop of a solver: certainly separated pairs are skipped until their motion could bring contact."""

import numpy as np

from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query_items
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import Body


def query_near(
    pairs: Pairs,
    pair: np.ndarray,
    bound: np.ndarray,
    T_a: np.ndarray,
    T_b: np.ndarray,
    cutoff: np.ndarray,
    previous: Witness | None,
) -> Witness:
    """Query the items (M, P) that may penetrate, or have no cutoff; the others are FAR, at their bounds.

    Args:
        pairs: Pairs of bodies.
        pair: Pair of each item (M, P).
        bound: Lower bounds (M, P) of the signed distances; NaN where a pose is not finite.
        T_a: Poses (M, P, 4, 4) of the first bodies.
        T_b: Poses of the second bodies.
        cutoff: Largest distances (M, P) in metres of interest.
        previous: The last answers.
    """
    apart = np.isfinite(cutoff) & (bound > 0)
    if apart.all():
        return nothing_near(bound)
    # No distance is below NaN: such pairs are skipped.
    found = query_items(pairs, pair, T_a, T_b, cutoff=np.where(apart, np.nan, cutoff), previous=previous)
    found.distance[apart], found.status[apart] = bound[apart], QueryStatus.FAR
    return found


def nothing_near(bound: np.ndarray) -> Witness:
    """Return the FAR answers of pairs (M, P) that are not queried, with their lower bounds as distances."""
    point_a, point_b, normal = np.zeros((3, *bound.shape, 3))
    winner, num_queries = np.zeros((2, *bound.shape), np.int64)
    status = np.full(bound.shape, QueryStatus.FAR, dtype=np.int8)
    return Witness(point_a, point_b, normal, bound.copy(), status, winner - 1, num_queries)


def bounding_sphere(body: Body) -> np.ndarray:
    """Centre and radius (4,) in metres of a bounding sphere of all pieces of a body, in its frame."""
    center = 0.5 * (body.centers.min(axis=0) + body.centers.max(axis=0))
    radius = (np.linalg.norm(body.centers - center, axis=1) + body.radii).max()
    return np.append(center, radius)


def motion(spheres: np.ndarray, T_before: np.ndarray, T_now: np.ndarray) -> np.ndarray:
    """Upper bounds (M, L) of the displacement of any point of each of L bodies, in metres.

    Args:
        spheres: Their bounding spheres (L, 4).
        T_before: Poses (M, L, 4, 4).
        T_now: Later poses (M, L, 4, 4).
    """
    moved = transform_points(T_now, spheres[:, :3]) - transform_points(T_before, spheres[:, :3])
    turned = (T_now - T_before)[..., :3, :3]
    # A rotation by theta moves a point at distance r by 2 r sin(theta / 2), and |R - R'| is sqrt(8) sin(theta / 2).
    chord = np.sqrt(0.5 * (turned * turned).sum(axis=(-1, -2)))
    return np.sqrt((moved * moved).sum(axis=-1)) + spheres[:, 3] * chord
