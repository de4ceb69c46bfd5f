"""The narrow phase: closest or deepest points of convex pieces, asked from coal (GJK and EPA).

The only file that imports coal. What it guards against (measured with coal 3.0.3):

- `ComputeDistance` does not keep its geometries alive, so this object does.
- `DistanceResult.normal` is a view into the reused result; it is copied before the next query.
- EPA at tight tolerances sometimes ends with a wild number: an answer that is not finite or lies below the
  signed bounding-sphere bound is asked again with a looser tolerance, and reported as failed if that fails too.
- More than 255 neighbours at a vertex raise: such a hull is triangulated again with few edges at each vertex.
- A query object starts its search for support points where its last query ended, so that an answer depends on what
  was asked before, by millimetres where witness points are not unique. Only a request with a cached guess resets
  that start: every request has one, the default guess where there is nothing better.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np

from grasp_refine.geometry.pieces import Piece
from grasp_refine.stopwatch import stage

_WILD = 1e300
"""A distance beyond this, either way, is no answer."""

_MAX_NEIGHBOURS = 255
"""coal counts the neighbours of a hull vertex in one byte."""


@dataclass(frozen=True)
class Tolerances:
    """Convergence tolerances of the two algorithms, in metres."""

    gjk: float = 1e-9
    """Duality gap of GJK (separated pieces)."""
    epa: float = 1e-8
    """Gap of EPA (penetrating pieces)."""
    retry: float = 1e-6
    """Tolerance of both for the second try of a query whose first answer was not usable."""
    slack: float = 1e-6
    """How far an answer may lie below its lower bound before it counts as wrong."""


@dataclass(frozen=True, eq=False)
class Closest:
    """What the narrow phase found for M items, in the frame of each item's body a."""

    distance: np.ndarray
    """Signed distance (M,) in metres; infinite where no piece pair beat the given limit."""
    point: np.ndarray
    """Witness point (M, 3) on body a."""
    normal: np.ndarray
    """Unit normal (M, 3), from body a to body b."""
    winner: np.ndarray
    """The piece pair (M,) that is closest; -1 where none was found."""
    asked: np.ndarray
    """Number of queries (M,) that were asked."""
    failed: np.ndarray
    """Items (M,) for which at least one query could not be answered, so that the minimum is not certain."""


class NarrowPhase:
    """Closest points of listed pairs of convex pieces; pieces and queries are built once and reused."""

    def __init__(self, pieces_a: Sequence[Piece], pieces_b: Sequence[Piece], tolerances: Tolerances) -> None:
        """Prepare the pairs (pieces_a[k], pieces_b[k]), k = 0 .. K - 1."""
        # The pieces keep their shapes alive.
        self._keep_alive = (tuple(pieces_a), tuple(pieces_b))
        identity = coal.Transform3s()
        self._pairs = []
        for a, b in zip(pieces_a, pieces_b, strict=True):
            (shape_a, T_a), (shape_b, T_b) = _shape_of(a), _shape_of(b)
            self._pairs.append((coal.ComputeDistance(shape_a, shape_b), T_a or identity, T_b))
        self._request = _request(tolerances.gjk, tolerances.epa)
        self._warm_request = _request(tolerances.gjk, tolerances.epa)
        self._loose_request = _request(tolerances.retry, tolerances.retry)
        self._slack = tolerances.slack

    @stage("narrow phase")
    def closest(
        self,
        R: np.ndarray,
        t: np.ndarray,
        starts: np.ndarray,
        pair: np.ndarray,
        bound: np.ndarray,
        limit: np.ndarray,
        guess: np.ndarray | None = None,
        guess_valid: np.ndarray | None = None,
    ) -> Closest:
        """The closest piece pair of each item, asking no pair whose lower bound cannot beat the best so far.

        Args:
            R: Rotation (M, 3, 3) of body b in the frame of body a.
            t: Its origin (M, 3).
            starts: Item i may ask the entries starts[i] .. starts[i + 1] of `pair` and `bound`.
            pair: Piece pairs, for each item in ascending order of `bound`.
            bound: Lower bound of the signed distance of each entry.
            limit: Signed distance (M,) that an answer has to beat.
            guess: Last seen x_a - x_b in the frame of a (M, 3): a warm start for GJK.
            guess_valid: Items (M,) whose guess is used (they were last seen apart).

        Returns:
            The minimum over the listed pieces of each item.
        """
        count = len(R)
        distance = np.full(count, np.inf)
        point, normal = np.zeros((count, 3)), np.zeros((count, 3))
        winner, asked = np.full(count, -1), np.zeros(count, dtype=np.int64)
        failed = np.zeros(count, dtype=bool)
        pairs, cold, warm = self._pairs, self._request, self._warm_request
        result, T = coal.DistanceResult(), coal.Transform3s()
        start_list, pair_list, bound_list, limit_list = (
            starts.tolist(),
            pair.tolist(),
            bound.tolist(),
            limit.tolist(),
        )
        # Without a bound, too, there is a limit to what an answer can be.
        floor_list = np.maximum(bound - self._slack, -_WILD).tolist()
        warm_list = guess_valid.tolist() if guess_valid is not None else None
        # Items with the same pieces follow each other, so that these stay in the processor's cache.
        order = np.argsort(pair[starts[:-1]] if (np.diff(starts) > 0).all() else np.zeros(count), kind="stable")
        for i, R_i, t_i in zip(order.tolist(), R[order], t[order], strict=True):
            T.setRotation(R_i)
            T.setTranslation(t_i)
            request = cold
            if warm_list is not None and warm_list[i]:
                warm.cached_gjk_guess = guess[i]
                request = warm
            best, first = limit_list[i], start_list[i]
            stop = start_list[i + 1]
            for j in range(first, stop):
                if bound_list[j] >= best:
                    stop = j
                    break
                compute, T_a, T_b = pairs[pair_list[j]]
                result.clear()
                d = compute(T_a, T if T_b is None else T * T_b, request, result)
                if not (floor_list[j] <= d < _WILD):
                    result.clear()
                    d = compute(T_a, T if T_b is None else T * T_b, self._loose_request, result)
                    if not (floor_list[j] <= d < _WILD):
                        failed[i] = True
                        continue
                if d < best:
                    best = d
                    distance[i] = d
                    point[i] = result.getNearestPoint1()
                    normal[i] = result.normal
                    winner[i] = pair_list[j]
            asked[i] = stop - first
        return Closest(distance, point, normal, winner, asked, failed)


def _request(gjk_tolerance: float, epa_tolerance: float) -> coal.DistanceRequest:
    request = coal.DistanceRequest()
    request.gjk_tolerance = gjk_tolerance
    request.epa_tolerance = epa_tolerance
    request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
    request.cached_gjk_guess = np.array([1.0, 0.0, 0.0])
    request.cached_support_func_guess = np.zeros(2, dtype=np.int32)
    return request


def _shape_of(piece: Piece) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
    """The coal shape of a piece, built once, which for a hull takes some milliseconds."""
    if "coal" not in piece.derived:
        piece.derived["coal"] = _shape(piece)
    return piece.derived["coal"]


def _shape(piece: Piece) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
    """The coal shape of a piece and its placement in the body (None: the body's own frame)."""
    vertices = piece.vertices
    if len(vertices) == 1:
        return coal.Sphere(piece.radius), coal.Transform3s(np.eye(3), vertices[0])
    if len(vertices) == 2:
        axis = vertices[1] - vertices[0]
        length = float(np.linalg.norm(axis))
        return coal.Capsule(piece.radius, length), coal.Transform3s(_frame(axis / length), vertices.mean(axis=0))
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices))
    edges = np.unique(
        np.sort(np.concatenate([piece.faces[:, [0, 1]], piece.faces[:, [1, 2]], piece.faces[:, [2, 0]]])),
        axis=0,
    )
    if np.bincount(edges.ravel()).max() <= _MAX_NEIGHBOURS // 2:
        shape = coal.Convex.convexHull(points, True, "Qt")
    else:
        triangles = coal.StdVec_Triangle()
        triangles.extend([coal.Triangle(*map(int, face)) for face in _few_neighbours(piece)])
        shape = coal.Convex(points, triangles)
    if piece.radius > 0:
        shape.setSweptSphereRadius(piece.radius)
    return shape, None


def _frame(z: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) whose third column is the unit vector z."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _few_neighbours(piece: Piece) -> np.ndarray:
    """Triangles (F, 3) of the same hull in which flat many-sided faces are zigzag strips, not fans."""
    corners = piece.vertices[piece.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("fi,fi->f", normals, corners[:, 0])
    size = np.ptp(piece.vertices, axis=0).max()
    planes = np.round(np.concatenate([normals, offsets[:, None] / size], axis=1), 7)
    triangles: list[tuple[int, int, int]] = []
    for members in _groups(planes):
        ids = np.unique(piece.faces[members])
        normal = normals[members[0]]
        centered = piece.vertices[ids] - piece.vertices[ids].mean(axis=0)
        frame = _frame(normal)
        ring = ids[np.argsort(np.arctan2(centered @ frame[:, 1], centered @ frame[:, 0]))].tolist()
        low, high, lower = 0, len(ring) - 1, True
        while high - low > 1:
            if lower:
                triangles.append((ring[low], ring[low + 1], ring[high]))
                low += 1
            else:
                triangles.append((ring[low], ring[high - 1], ring[high]))
                high -= 1
            lower = not lower
    return np.array(triangles)


def _groups(rows: np.ndarray) -> list[np.ndarray]:
    """Indices of equal rows, a group each."""
    _, group = np.unique(rows, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
