"""Random placement of hands at an object before any contact: poses and joint values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import matvec, tangents, transform
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.sampling.closure_frame import ClosureFrame
from grasp_refine.scene.plane import Plane

CONE_ANGLE_RAD = np.radians(30.0)
"""Angle in radians between the normals of two points and the line through both, below which fingers oppose each other
there; and largest angle between the direction in which a hand approaches a single point and the normal there."""

MAX_DEPTH_RADII = 1.5
"""Most radii of the closure frame by which its centre goes beyond the point, so that hands come as near as possible."""

MIN_OPENING_SHARE, MAX_SPREAD_SHARE = 0.3, 0.5
"""Least share of the range from rest to open hands, and largest share of the range to the limits of spreading
joints."""


@dataclass(frozen=True, eq=False)
class Placed:
    """M hands at an object."""

    T: Float[np.ndarray, "M 4 4"]
    """Poses of the base link in the object's frame, metres."""
    q: Float[np.ndarray, "M n"]
    """Joint values, rad or m."""
    way: Float[np.ndarray, "M 3"]
    """Unit vectors along which the hands approach, object frame."""


@dataclass(frozen=True, eq=False)
class Places:
    """M places for a hand on an object, in the object's frame."""

    point: Float[np.ndarray, "M 3"]
    """Point for the centre of the hand, metres."""
    way: Float[np.ndarray, "M 3"]
    """Unit vectors along which the hands approach."""
    across: Float[np.ndarray, "M 3"]
    """Unit vectors, at right angles to these, along which their fingers close."""


def opposed_pairs(obj: Object, farthest: float) -> Int[np.ndarray, "P 2"]:
    """Pairs (P, 2) of indices of surface points that face away from each other, not farther apart than `farthest`."""
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    apart = x[None] - x[:, None]
    length = np.linalg.norm(apart, axis=-1)
    least = np.cos(CONE_ANGLE_RAD) * length
    facing = (-(apart * n[:, None]).sum(axis=-1) > least) & ((apart * n).sum(axis=-1) > least)
    return np.argwhere(facing & (length < farthest))


def sample_places(
    obj: Object, pairs: Int[np.ndarray, "P 2"], single: Int[np.ndarray, " S"], count: int, rng: np.random.Generator
) -> Places:
    """Places (count), half of them between `opposed_pairs` pairs, if there are any, the others at `single` points.

    Hands approach a place between two points from any side, and their fingers close on both; they approach a place on
    the surface nearly along its normal, at any angle about it.
    """
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    ends = x[pairs[rng.integers(len(pairs), size=count // 2)]] if len(pairs) else np.zeros((0, 2, 3))
    across = ends[:, 1] - ends[:, 0]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    chosen = single[rng.integers(len(single), size=count - len(ends))]
    tilt = rng.uniform(0.0, CONE_ANGLE_RAD, (len(chosen), 1))
    way = -np.cos(tilt) * n[chosen] + np.sin(tilt) * _perpendicular(n[chosen], rng)
    return Places(
        point=np.concatenate([ends.mean(axis=1), x[chosen]]),
        way=np.concatenate([_perpendicular(across, rng), way]),
        across=np.concatenate([across, _perpendicular(way, rng)]),
    )


def place_hands(
    hand: Hand, closure: ClosureFrame, places: Places, table: Plane | None, rng: np.random.Generator
) -> Placed:
    """Hands, one per place, more or less open, with their centre near it; they may penetrate the object.

    Hands that would approach from below a table approach from above, mirrored.
    """
    way, count = places.way, len(places.way)
    if table is not None:
        normal = np.asarray(table.normal)
        way = way - 2.0 * np.maximum(way @ normal, 0.0)[:, None] * normal
    side = np.cross(way, places.across)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    frame = np.column_stack([closure.across, np.cross(closure.approach, closure.across), closure.approach])
    R = np.stack([np.cross(side, way), side, way], axis=-1) @ frame.T
    middle = places.point + closure.radius * rng.uniform(0.0, MAX_DEPTH_RADII, (count, 1)) * way
    q = hand.rest + rng.uniform(MIN_OPENING_SHARE, 1.0, (count, 1)) * (closure.opened - hand.rest)
    # Hands with little spread are as likely as others: widely spread fingers often run into each other.
    spread = rng.uniform(0.0, MAX_SPREAD_SHARE, (count, 1)) * rng.uniform(-1.0, 1.0, q.shape) * closure.spreading
    q += np.where(spread > 0, closure.upper - hand.rest, hand.rest - closure.lower) * spread
    return Placed(transform(R, middle - R @ closure.center), q, way)


def _perpendicular(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (M, 3) at right angles to others."""
    turn = rng.uniform(0.0, 2.0 * np.pi, len(axis))
    return matvec(tangents(axis), np.stack([np.cos(turn), np.sin(turn)], axis=-1))
