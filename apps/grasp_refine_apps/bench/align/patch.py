"""The patch witness: choice among many witness points where two faces, or an edge and a face, are near parallel.

There the plain witness point is not determined: it jumps from corner to corner when a body turns by 1e-9 rad. The
patch is the set of all points p of the plane across the contact normal n over which the gap of the two pieces is
within epsilon of the smallest one. The gap of convex pieces is a convex function of p; so the patch is convex and
moves continuously with the poses, and so does its point nearest to the targets, which `Patch` takes.

Shift piece b along -n until it is epsilon deep in piece a: the patch is the projection, along n, of the overlap.
So it needs no polygons, only the half-spaces of the two pieces (`Overlap`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.arguments import is_number
from grasp_refine.core.array_records import index_distinct
from grasp_refine.core.errors import CollisionError
from grasp_refine.core.se3 import cross, matvec, tangents, transform_points
from grasp_refine.geometry.pieces import Piece
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.size import length_factor
from grasp_refine_apps.bench.align.overlap import Overlap

_MIN_EXTENT_EPSILONS = 10.0
"""Largest bound of a patch's extent, in epsilons, at which the witness is kept."""

_LOCAL_RADII_EPSILONS = (1e2, 1e3, np.inf)
"""Radii around the witness, in epsilons, whose faces are tried first: if the answer is inside, no others matter."""

_BLOCK_ITEMS = 256
"""Items that are clipped at a time, so that intermediate results stay in the cache."""


@dataclass(frozen=True)
class Patch:
    """The witness points nearest to the targets among all that are within epsilon of being the closest."""

    epsilon: float = 1e-5
    """Excess over the smallest distance, in metres; scaled in proportion for pairs of bodies smaller than 1 cm or
    larger than 1 m (`size.length_factor`)."""

    def __post_init__(self) -> None:
        """Refuse a patch without extent.

        Raises:
            CollisionError: epsilon is not positive and finite.
        """
        if not (is_number(self.epsilon) and 0 < self.epsilon < np.inf):
            raise CollisionError(f"the epsilon of a patch must be positive and finite, got {self.epsilon}")

    def refine(
        self,
        pairs: Pairs,
        T_world_a: np.ndarray,
        T_world_b: np.ndarray,
        witness: Witness,
        target_a: np.ndarray | None,
        target_b: np.ndarray | None,
    ) -> Witness:
        """Move witness points and distance over the patch, for items of any shape (...); the normal stays.

        Along n the points stay on the surfaces of the pieces. Unchanged, bit for bit: items without points, with
        spheres or capsules, with a patch that certainly extends no farther than 10 epsilon, and pairs whose sum of
        squared misses would grow: by less than epsilon squared, the effect of heights, unless a target lies beyond
        the face. The radius of a rounded polytope is added to its core along n: its patch ends where the flat
        part ends.

        Args:
            pairs: The body pairs that were queried.
            T_world_a: Poses (..., 4, 4) of the first bodies.
            T_world_b: Poses of the second bodies.
            witness: Their witness as NumPy arrays, leading shape (...).
            target_a: Target point (..., 3), frame of body a, metres. NaN: none, only the target of body b counts.
            target_b: Target point (..., 3), frame of body b, metres. Items without either keep their witness.
        """
        shape = witness.distance.shape
        if len(shape) > 1:
            T_a, T_b = (T.reshape(-1, 4, 4) for T in (T_world_a, T_world_b))
            a, b = (None if target is None else target.reshape(-1, 3) for target in (target_a, target_b))
            return self.refine(pairs, T_a, T_b, witness.reshape(-1), a, b).reshape(*shape)
        goals = _Goals.of(witness, (T_world_a, T_world_b), (target_a, target_b))
        pieces_a, pieces_b = pairs.piece_pairs
        used = np.unique(witness.winner[witness.valid])
        polytopes = [k for k in used if len(pieces_a[k].faces) and len(pieces_b[k].faces)]
        index = np.flatnonzero(witness.valid & goals.known.any(axis=0) & np.isin(witness.winner, polytopes))
        if not len(index):
            return witness
        n, winner = witness.normal[index], witness.winner[index]
        sides = (
            _Side.of([pieces_a[k] for k in winner], T_world_a[index], witness.point_a[index], n),
            _Side.of([pieces_b[k] for k in winner], T_world_b[index], witness.point_b[index], -n),
        )
        wide = np.flatnonzero(~(_extent_bound(*sides) <= _MIN_EXTENT_EPSILONS))
        index, n = index[wide], n[wide]
        goal = np.einsum("kij,ki->kj", tangents(n), goals.middle[index])
        # Winners index the piece pairs of all body pairs, one body pair after the other.
        pair = np.searchsorted(pairs.first_piece_pair, winner[wide], side="right") - 1
        factor = length_factor(pairs.a, pairs.b)[pair]
        move_a, move_b = np.empty((2, len(n), 3))
        for scale in np.unique(factor):
            some = np.flatnonzero(factor == scale)
            first, second = (side.take(wide[some]) for side in sides)
            moves = replace(self, epsilon=self.epsilon * scale)._moves(first, second, n[some], goal[some])
            move_a[some], move_b[some] = moves
        before = goals.missed(index, np.zeros_like(n), np.zeros_like(n))
        better = goals.missed(index, move_a, move_b) <= before
        return _move_points(witness, index[better], move_a[better], move_b[better])

    def _moves(self, a: "_Side", b: "_Side", n: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Moves (K, 3) of the points of K contacts, world frame, nearest to goals (K, 2) in their tangents."""
        move_a, move_b = np.full((2, len(n), 3), np.nan)
        left = np.argsort(a.count + b.count, kind="stable")
        for radius in self.epsilon * np.array(_LOCAL_RADII_EPSILONS):
            beyond = []
            for some in _blocks(left):
                tangent = tangents(n[some])
                frame = np.concatenate([tangent, n[some, :, None]], axis=2)
                sides = [
                    side.take(some).half_spaces(frame, radius, shift) for side, shift in ((a, 0.0), (b, self.epsilon))
                ]
                normals, offsets = (np.concatenate(both, axis=1) for both in zip(*sides, strict=True))
                m, c = np.ascontiguousarray(normals[..., :2]), np.ascontiguousarray(normals[..., 2])
                overlap = Overlap(m, c, offsets - matvec(m, goal[some]), sides[0][1].shape[1], self.epsilon)
                p, top, bottom = overlap.nearest()
                p += goal[some]
                across = matvec(tangent, p)
                move_a[some] = across + top[:, None] * n[some]
                move_b[some] = across + (bottom + self.epsilon)[:, None] * n[some]
                beyond.append(some[(p**2).sum(axis=1) > radius**2])
            left = np.concatenate([*beyond, left[:0]])
        return move_a, move_b


class PatchLayer(WitnessLayer):
    """Witness layer whose points move over a patch towards their targets; the motion of the patch has no derivative."""

    def __init__(self, pairs: Pairs, method: Derivative, patch: Patch) -> None:
        """Prepare the pairs, as `WitnessLayer`."""
        super().__init__(pairs, method)
        self.patch = patch

    def find(
        self,
        T_a: np.ndarray,
        T_b: np.ndarray,
        targets: tuple[np.ndarray | None, ...],
        cutoff: np.ndarray | float,
        previous: Witness | None,
    ) -> Witness:
        """Return the witness nearest to the targets."""
        found = super().find(T_a, T_b, targets, cutoff, previous)
        return self.patch.refine(self.pairs, T_a, T_b, found, *targets)


@dataclass(frozen=True, eq=False)
class _Goals:
    """Targets of M items relative to their witness points."""

    offset: np.ndarray
    """Offsets t - x (2, M, 3) on the two bodies, world frame, metres; 0 where there is no target."""
    known: np.ndarray
    """Mask (2, M) of the targets that exist."""

    @staticmethod
    def of(witness: Witness, poses: Sequence[np.ndarray], targets: Sequence[np.ndarray | None]) -> "_Goals":
        offset = np.full((2, *witness.point_a.shape), np.nan)
        for place, x, T, target in zip(offset, (witness.point_a, witness.point_b), poses, targets, strict=True):
            if target is not None:
                with np.errstate(invalid="ignore", over="ignore"):
                    place[:] = transform_points(T, target) - x
        known = np.all(np.isfinite(offset), axis=2)
        return _Goals(np.where(known[..., None], offset, 0.0), known)

    @property
    def middle(self) -> np.ndarray:
        """Mean offset (M, 3) over the existing targets."""
        return self.offset.sum(axis=0) / np.maximum(self.known.sum(axis=0), 1)[:, None]

    def missed(self, index: np.ndarray, move_a: np.ndarray, move_b: np.ndarray) -> np.ndarray:
        """Sums (K,) of squared misses of the items (K,) when their points move by (K, 3)."""
        away = np.stack([move_a, move_b]) - self.offset[:, index]
        return ((away**2).sum(axis=2) * self.known[:, index]).sum(axis=0)


@dataclass(frozen=True, eq=False)
class _Side:
    """Polytopes on one side of M contacts, with their poses."""

    pieces: tuple[Piece, ...]
    """The distinct polytopes."""
    piece: np.ndarray
    """Index (M,) into them."""
    R: np.ndarray
    """Rotations (M, 3, 3) of the bodies, world frame."""
    point: np.ndarray
    """Witness points (M, 3) of the cores, body frames, metres."""
    outward: np.ndarray
    """Outward contact normals (M, 3), body frames."""

    @staticmethod
    def of(pieces: Sequence[Piece], T: np.ndarray, x: np.ndarray, outward: np.ndarray) -> "_Side":
        """Side of contacts of `pieces` at poses T (M, 4, 4), points x and normals `outward` (M, 3), world frame."""
        distinct, index = index_distinct(pieces)
        radius = np.array([piece.radius for piece in distinct])[index]
        R = T[:, :3, :3]
        local = matvec(R.mT, x - T[:, :3, 3])
        normal = matvec(R.mT, outward)
        return _Side(distinct, index, R, local - radius[:, None] * normal, normal)

    def take(self, index: np.ndarray) -> "_Side":
        """Return the contacts `index`."""
        return replace(self, **{name: getattr(self, name)[index] for name in ("piece", "R", "point", "outward")})

    @property
    def count(self) -> np.ndarray:
        """Number of half-spaces (M,) of each contact's polytope."""
        return np.array([len(piece.planes[1]) for piece in self.pieces])[self.piece]

    def half_spaces(self, frame: np.ndarray, radius: float, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Normals (M, W, 3) and offsets (M, W), in metres, of the half-spaces within `radius` of the points.

        Half-spaces are expressed in frames (M, 3, 3), world frame, whose third axes are n, about the points, for the
        polytopes shifted by -`shift` n. Where there are fewer than W, normals are 0 and offsets infinite.
        """
        tables = [piece.planes for piece in self.pieces]
        first = np.cumsum([0, *(len(offsets) for _, offsets in tables)])
        items, planes = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for start, (normals, offsets), some in zip(first[:-1], tables, self._groups(), strict=True):
            if len(some):
                slack = offsets - self.point[some] @ normals.T
                along = self.outward[some] @ normals.T
                # Relevant heights are at most epsilon, which is small against any radius.
                reach = radius * (np.sqrt(np.maximum(1.0 - along**2, 0.0)) + 0.1)
                item, plane = np.nonzero(slack <= reach)
                items.append(some[item])
                planes.append(start + plane)
        item, plane = np.concatenate(items), np.concatenate(planes)
        order = np.argsort(item, kind="stable")
        count = np.bincount(item, minlength=len(self.piece))
        begin = np.cumsum(count) - count
        row = np.full((len(count), count.max(initial=1)), first[-1])
        row[item[order], np.arange(len(item)) - np.repeat(begin, count)] = plane[order]
        normals = np.concatenate([*(normals for normals, _ in tables), np.zeros((1, 3))])[row]
        offsets = np.concatenate([*(offsets for _, offsets in tables), [np.inf]])[row]
        turned = normals @ (self.R.mT @ frame)
        return turned, offsets - matvec(normals, self.point) - shift * turned[..., 2]

    def dips(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smallest and second smallest slopes (M,) of edges at the vertices farthest out, and the first edges.

        A slope is the sine of the angle below the plane across n. Edges (M, 3) are unit vectors in the world frame.
        Rounded polytopes, which have no table of neighbours, get slopes of zero.
        """
        first, second = np.zeros((2, len(self.piece)))
        edge = np.zeros((len(self.piece), 3))
        for piece, some in zip(self.pieces, self._groups(), strict=True):
            if piece.radius > 0 or not len(some):
                continue
            rings, n = piece.rings(1), self.outward[some]
            farthest = (n @ piece.vertices.T).argmax(axis=1)
            start, count = rings.start[farthest], np.diff(rings.start)[farthest]
            begin = np.cumsum(count) - count
            run = np.repeat(np.arange(len(some)), count)
            member = rings.members[np.arange(len(run)) + np.repeat(start - begin, count)]
            along = piece.vertices[member] - piece.vertices[farthest[run]]
            length = np.linalg.norm(along, axis=1)
            itself = length == 0.0
            along /= np.where(itself, 1.0, length)[:, None]
            dip = np.where(itself, np.inf, -np.einsum("ei,ei->e", along, n[run]))
            first[some] = np.minimum.reduceat(dip, begin)
            lowest = np.flatnonzero(dip == first[some][run])
            lowest = lowest[np.unique(run[lowest], return_index=True)[1]]
            edge[some] = matvec(self.R[some], along[lowest])
            dip[lowest] = np.inf
            second[some] = np.minimum.reduceat(dip, begin)
        return np.maximum(first, 0.0), np.maximum(second, 0.0), edge

    def _groups(self) -> list[np.ndarray]:
        """Contacts of each polytope."""
        counts = np.bincount(self.piece, minlength=len(self.pieces))
        return np.split(np.argsort(self.piece, kind="stable"), np.cumsum(counts)[:-1])


def _extent_bound(a: _Side, b: _Side) -> np.ndarray:
    """Upper bounds (M,) of the extent of the patches, in epsilons; infinite where there is none.

    A polytope lies in the cone of the edges at its farthest vertex. If all of them dip by the sine s, it is deeper
    than epsilon everywhere beyond epsilon / s. If all but one dip by s, that holds beyond a strip of this width along
    that one; and the strips of the two polytopes intersect in a rhombus.
    """
    first_a, second_a, edge_a = a.dips()
    first_b, second_b, edge_b = b.dips()
    # Both edges are nearly across n where this matters; their shorter projections only enlarge the bound.
    n = matvec(a.R, a.outward)
    crossing = np.abs((cross(edge_a, edge_b) * n).sum(axis=1))
    with np.errstate(divide="ignore"):
        rhombus = (1.0 / second_a + 1.0 / second_b) / crossing
        return np.minimum(1.0 / np.maximum(first_a, first_b), rhombus)


def _blocks(index: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the items `index` (K,) in blocks."""
    for start in range(0, len(index), _BLOCK_ITEMS):
        yield index[start : start + _BLOCK_ITEMS]


def _move_points(witness: Witness, index: np.ndarray, move_a: np.ndarray, move_b: np.ndarray) -> Witness:
    """Move the points of the items (K,) by (K, 3), and update their distances."""
    point_a, point_b, distance = witness.point_a.copy(), witness.point_b.copy(), witness.distance.copy()
    point_a[index] += move_a
    point_b[index] += move_b
    distance[index] += (witness.normal[index] * (move_b - move_a)).sum(axis=1)
    return replace(witness, point_a=point_a, point_b=point_b, distance=distance)
