"""Where hands come to an object to grasp it, and in which shape: drawn at random, before anything is touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from grasp_refine.core.se3 import matvec, tangents, transform
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.sampling.closure_frame import ClosureFrame
from grasp_refine.scene.plane import Plane

CONE = np.radians(30.0)
"""Angle between the normals of two places and the line through both, below which fingers oppose each other there; and
how far the way in which a hand comes to a single place is off the normal."""

DEPTH = 1.5
"""The centre of a grip goes beyond the place by up to so many of its radii, so that hands come as near as they can."""

SHUT, SPREAD = 0.3, 0.5
"""Shares of the ways from rest: hands are at least so far open, and fingers spread at most so far to the limits."""


@dataclass(frozen=True, eq=False)
class Placed:
    """M hands at an object."""

    T: Float[np.ndarray, "M 4 4"]
    """Poses of the base link in the object's frame, metres."""
    q: Float[np.ndarray, "M n"]
    """Joint values, rad or m."""
    way: Float[np.ndarray, "M 3"]
    """Unit vectors along which the hands come, object frame."""


@dataclass(frozen=True, eq=False)
class Places:
    """M places of an object, in its frame."""

    point: Float[np.ndarray, "M 3"]
    """What is to be in the middle of the hand, metres."""
    way: Float[np.ndarray, "M 3"]
    """Unit vectors along which the hands come."""
    across: Float[np.ndarray, "M 3"]
    """Unit vectors, at right angles to these, along which their fingers close."""


def opposed(obj: Object, farthest: float) -> Int[np.ndarray, "P 2"]:
    """Pairs (P, 2) of surface points, as numbers, that face away from each other, not farther apart than that."""
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    apart = x[None] - x[:, None]
    length = np.linalg.norm(apart, axis=-1)
    least = np.cos(CONE) * length
    facing = (-(apart * n[:, None]).sum(axis=-1) > least) & ((apart * n).sum(axis=-1) > least)
    return np.argwhere(facing & (length < farthest))


def places_on(obj: Object, pairs: Int[np.ndarray, "P 2"], count: int, rng: np.random.Generator) -> Places:
    """Places (count), half of them between `opposed` pairs, if there are any, the others on the surface.

    To what is between two points hands come from any side, and their fingers close on both; to what is on the surface
    they come along its normal, more or less, and turned anyhow about it.
    """
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    ends = x[pairs[rng.integers(len(pairs), size=count // 2)]] if len(pairs) else np.zeros((0, 2, 3))
    across = ends[:, 1] - ends[:, 0]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    chosen = rng.integers(len(x), size=count - len(ends))
    tilt = rng.uniform(0.0, CONE, (len(chosen), 1))
    way = -np.cos(tilt) * n[chosen] + np.sin(tilt) * _beside(n[chosen], rng)
    return Places(
        point=np.concatenate([ends.mean(axis=1), x[chosen]]),
        way=np.concatenate([_beside(across, rng), way]),
        across=np.concatenate([across, _beside(way, rng)]),
    )


def placed(hand: Hand, closure: ClosureFrame, places: Places, table: Plane | None, rng: np.random.Generator) -> Placed:
    """Hands, one per place, more or less open, with the grip around it; they may penetrate the object.

    What would come from below a table comes from above, mirrored.
    """
    way, count = places.way, len(places.way)
    if table is not None:
        normal = np.asarray(table.normal)
        way = way - 2.0 * np.maximum(way @ normal, 0.0)[:, None] * normal
    side = np.cross(way, places.across)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    frame = np.column_stack([closure.across, np.cross(closure.approach, closure.across), closure.approach])
    R = np.stack([np.cross(side, way), side, way], axis=-1) @ frame.T
    middle = places.point + closure.radius * rng.uniform(0.0, DEPTH, (count, 1)) * way
    q = hand.rest + rng.uniform(SHUT, 1.0, (count, 1)) * (closure.opened - hand.rest)
    # Hands of which no finger is spread far are as likely as others: those that are often run into each other.
    spread = rng.uniform(0.0, SPREAD, (count, 1)) * rng.uniform(-1.0, 1.0, q.shape) * closure.spreading
    q += np.where(spread > 0, closure.upper - hand.rest, hand.rest - closure.lower) * spread
    return Placed(transform(R, middle - R @ closure.center), q, way)


def _beside(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (M, 3) at right angles to others."""
    turn = rng.uniform(0.0, 2.0 * np.pi, len(axis))
    return matvec(tangents(axis), np.stack([np.cos(turn), np.sin(turn)], axis=-1))
