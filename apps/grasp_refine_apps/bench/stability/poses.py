"""Poses in which two bodies are in some state, and the truth about them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from grasp_refine.core.array_records import join, take
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.bench.stability.bodies import BodyPairs
from grasp_refine_apps.bench.stability.cases import (
    FEATURES,
    GAPS,
    KINDS,
    STATE_DISTANCES,
    STATE_DISTANCES_M,
    STATES,
    State,
    Task,
)
from grasp_refine_apps.bench.stability.reference import Truth, Truths

MAX_ROTATIONS = 4
"""Largest number of relative rotations of a pair of bodies; the first is the identity."""

MAX_FEATURE_ROTATIONS, FEW_FEATURE_ROTATIONS, MANY_VERTEX_PAIRS = 8, 2, 20_000
"""Largest number of rotations for features, the same for large bodies, and the vertex pairs that make them large."""

POSES_PER_ROTATION = 8
"""Number of poses that justify one more rotation."""

NUM_START_PAIRS = 4
"""Number of piece pairs from whose contact the search of poses starts, for each rotation."""

DRAWS_PER_POSE = 4
"""Number of poses drawn for each requested one, where other pieces may be in the way."""


COPLANAR_TOLERANCE = 1e-6
"""Faces whose normals differ by less than this are one face, without an edge between them."""


@dataclass(frozen=True, eq=False)
class PosedBodies:
    """N poses of two bodies, and the truth."""

    T_a: np.ndarray
    """Poses (N, 4, 4) of the first body near the origin of the world; half of them are not rotated."""
    T_b: np.ndarray
    """Poses (N, 4, 4) of the second body."""
    truth: Truth
    """The truth (N,), in the frame of the first body."""

    def moved(self, translation: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses after both bodies were moved by `translation` metres."""
        T_a, T_b = self.T_a.copy(), self.T_b.copy()
        for T in (T_a, T_b):
            T[:, :3, 3] += translation * np.array([0.6, -0.48, 0.64])
        return T_a, T_b


@dataclass(frozen=True, eq=False)
class PoseSampler:
    """A sampler of poses of two bodies."""

    a: Body
    b: Body
    seed: tuple[int, ...]
    """Seed of all draws: equal seeds and states give equal poses."""

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the larger body, in metres."""
        return max(self.a.diagonal, self.b.diagonal)

    @cached_property
    def _turned(self) -> list[Truths]:
        """Truth at some rotations of the second body in the frame of the first."""
        turns = Rotation.random(MAX_ROTATIONS - 1, rng=np.random.default_rng(self.seed)).as_matrix()
        return [self._truths(R) for R in (np.eye(3), *turns)]

    def can_be(self, state: State) -> bool:
        """Return True if these bodies can be in this state: round bodies have no features that could meet."""
        return state not in FEATURES or all(len(piece.faces) for body in (self.a, self.b) for piece in body.pieces)

    def pose(self, state: State, count: int) -> PosedBodies | None:
        """Return poses in this state, the same at every call; None: the bodies cannot be in it."""
        if not self.can_be(state):
            return None
        rng = np.random.default_rng((*self.seed, STATES.index(state)))
        find = self._feature_against_feature if state in FEATURES else self._any
        R, t, truths = zip(*find(rng, state, count), strict=True)
        R, t = np.concatenate(R)[:count], np.concatenate(t)[:count]
        return PosedBodies(*self._in_world(rng, R, t), take(join(*truths), slice(count)))

    def _any(
        self, rng: np.random.Generator, state: State, count: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Truth]]:
        """Yield rotations (n, 3, 3) and offsets (n, 3) in a state that is not one of features, and the truth."""
        turns = min(max(count // POSES_PER_ROTATION, 2), MAX_ROTATIONS)
        n = -(-count // turns)
        for truths in self._turned[:turns]:
            if state in ("total", "concentric"):
                middles = [0.5 * (body.centers.min(axis=0) + body.centers.max(axis=0)) for body in (self.a, self.b)]
                away = 0.0 if state == "concentric" else 0.1 * self.diagonal
                t = middles[0] - truths.R @ middles[1] + away * rng.normal(size=(n, 3))
            else:
                t = self._at_distance(rng, truths, n, self._distances(rng, state, n))
            yield np.tile(truths.R, (n, 1, 1)), t, truths.at(t)

    def _distances(self, rng: np.random.Generator, state: State, n: int) -> np.ndarray:
        """Desired signed distances (n,) of a state in metres."""
        if state in ("shallow", "deep"):
            low, high = (-9, -2) if state == "shallow" else (np.log10(0.02), np.log10(0.2))
            return -self.diagonal * 10 ** rng.uniform(low, high, n)
        return np.full(
            n, STATE_DISTANCES_M[state] if state in STATE_DISTANCES_M else STATE_DISTANCES[state] * self.diagonal
        )

    def _at_distance(self, rng: np.random.Generator, truths: Truths, n: int, distance: np.ndarray) -> np.ndarray:
        """Offsets (n, 3) at which the bodies have these distances; inwards the truth may be less deep."""
        t = np.empty((n, 3))
        some = rng.integers(len(truths.pairs), size=NUM_START_PAIRS)
        for i in range(n):
            touching, outward = truths.difference(some[i % NUM_START_PAIRS]).boundary(rng)
            # From there outwards, straight or oblique, until all pieces are apart.
            along = outward + rng.normal(size=3) * rng.choice([0.0, 0.1, 1.0])
            step = self.diagonal * 10 ** rng.uniform(-2, 0.5)
            t[i] = touching + step * along / np.linalg.norm(along)
        for _ in range(30):
            truth = truths.at(t)
            inside = truth.distance <= 0.0
            if not inside.any():
                break
            t[inside] += (
                0.3 * self.diagonal * rng.normal(size=(int(inside.sum()), 3)) + truth.normal[inside] * self.diagonal
            )
        # With the same nearest points, at the desired distance.
        return t + (distance - truth.distance)[:, None] * truth.normal

    def _feature_against_feature(
        self, rng: np.random.Generator, state: State, count: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Truth]]:
        """Yield rotations, offsets and the truth for a face, edge or vertex of each body against the other's."""
        turns = min(
            max(count // POSES_PER_ROTATION, 1),
            FEW_FEATURE_ROTATIONS if self._vertex_pairs > MANY_VERTEX_PAIRS else MAX_FEATURE_ROTATIONS,
        )
        n = -(-count // turns)
        draws = 1 if len(self.a.pieces) * len(self.b.pieces) == 1 else DRAWS_PER_POSE
        for turn in range(turns):
            first, second = (self._feature(rng, body, state) for body in (self.a, self.b))
            R = _against(rng, first, second, straight=turn % 4 == 0)
            gap = self.diagonal * np.resize(np.roll(GAPS, -turn * n), n)
            on_first, on_second = (feature.points(rng, draws * n) for feature in (first, second))
            t = on_first + np.tile(gap, draws)[:, None] * first.outward - on_second @ R.T
            truth = self._truths(R).at(t)
            # The first one for each gap where nothing else is in the way.
            blocked = np.abs(truth.distance.reshape(draws, n) - gap) > 1e-9 * self.diagonal
            best = blocked.argmin(axis=0) * n + np.arange(n)
            yield np.tile(R, (n, 1, 1)), t[best], take(truth, best)

    def _feature(self, rng: np.random.Generator, body: Body, state: State) -> Feature:
        """Choose any such feature of a body; of several pieces, one without others far in front of it."""
        piece, towards = (body.pieces[0], None) if len(body.pieces) == 1 else extreme(body.pieces, rng)
        return FEATURE[state](piece, rng, towards)

    @property
    def _vertex_pairs(self) -> int:
        counts = [sum(len(piece.vertices) for piece in body.pieces) for body in (self.a, self.b)]
        return counts[0] * counts[1]

    def _truths(self, R: np.ndarray) -> Truths:
        return Truths(self.a.pieces, self.b.pieces, R)

    def _in_world(self, rng: np.random.Generator, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (N, 4, 4) of both bodies from poses of the second in the frame of the first."""
        N = len(R)
        T_a, T_b = np.tile(np.eye(4), (2, N, 1, 1))
        turned = np.arange(N) % 2 == 1
        T_a[turned, :3, :3] = Rotation.random(N, rng=rng).as_matrix()[turned]
        T_a[turned, :3, 3] = self.diagonal * rng.normal(size=(N, 3))[turned]
        T_b[:, :3, :3] = T_a[:, :3, :3] @ R
        T_b[:, :3, 3] = T_a[:, :3, 3] + (T_a[:, :3, :3] @ t[..., None])[..., 0]
        return T_a, T_b


def pose_samplers(made: BodyPairs, task: Task) -> list[PoseSampler]:
    """Make the samplers of the pairs of bodies of a task, the same in every run."""
    size = int(np.float64(task.diagonal).view(np.uint64))
    return [PoseSampler(*bodies, (task.seed, KINDS.index(task.kind), size, k)) for k, bodies in enumerate(made.pairs)]


def _against(rng: np.random.Generator, first: Feature, second: Feature, *, straight: bool) -> np.ndarray:
    """Return a rotation (3, 3) that turns a feature of the second body towards one of the first.

    Args:
        rng: Generator of the angle about the normal.
        first: Feature of the first body.
        second: Feature that is rotated.
        straight: Whether their tangents become parallel, as for two edges.
    """
    angle = 0.0 if straight else rng.uniform(0, 2 * np.pi)
    spin = Rotation.from_rotvec(angle * first.outward).as_matrix()
    frame_a, frame_b = (
        np.stack([f.tangent, f.outward, np.cross(f.tangent, f.outward)], axis=1) for f in (first, second)
    )
    return spin @ (frame_a * [1, -1, -1]) @ frame_b.T


# faces, edges and vertices, with a direction that points away from the piece


@dataclass(frozen=True, eq=False)
class Feature:
    """A face, an edge or a vertex of a piece."""

    corners: np.ndarray
    """Corners (1, 2 or 3, 3), metres; points of the feature are their convex combinations."""
    outward: np.ndarray
    """A unit vector (3,) along which no point of the piece is farther."""
    tangent: np.ndarray
    """A unit vector (3,) perpendicular to it: along the edge, or any."""

    def points(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw points (count, 3) on it."""
        return rng.dirichlet(np.ones(len(self.corners)), count) @ self.corners


def face(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose a face of a piece: the face that faces a direction (3,) most, or a random face, large faces more often."""
    area = np.where(piece.normals.any(axis=1), piece.areas, 0.0)
    k = rng.choice(len(area), p=area / area.sum()) if towards is None else (piece.normals @ towards).argmax()
    corners = piece.vertices[piece.faces[k]]
    return Feature(corners, piece.normals[k], _unit(corners[1] - corners[0]))


def edge(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose an edge between faces in different planes: the most towards a direction (3,), or at random."""
    loops = np.stack([piece.faces, np.roll(piece.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    owner = np.repeat(np.arange(len(piece.faces)), 3)
    order = np.lexsort(np.sort(loops, axis=1).T)
    first, second = owner[order[0::2]], owner[order[1::2]]
    normals = piece.normals
    both = normals[first].any(axis=1) & normals[second].any(axis=1)
    sharp = np.flatnonzero(both & (np.linalg.norm(normals[first] - normals[second], axis=1) > COPLANAR_TOLERANCE))
    means = normals[first[sharp]] + normals[second[sharp]]
    k = sharp[rng.integers(len(sharp)) if towards is None else (means @ towards).argmax()]
    corners = piece.vertices[loops[order[2 * k]]]
    tangent = _unit(corners[1] - corners[0])
    outward = _unit(normals[first[k]] + normals[second[k]])
    return Feature(corners, _unit(outward - (outward @ tangent) * tangent), tangent)


def vertex(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose a vertex: the farthest in a direction (3,), which points away from it; or any, with its mean normal."""
    if towards is None:
        v = rng.integers(len(piece.vertices))
        outward = _unit(piece.normals[(piece.faces == v).any(axis=1)].sum(axis=0))
    else:
        v, outward = (piece.vertices @ towards).argmax(), towards
    tangent = _unit(np.cross(np.eye(3)[np.abs(outward).argmin()], outward))
    return Feature(piece.vertices[[v]], outward, tangent)


def extreme(pieces: Sequence[Piece], rng: np.random.Generator) -> tuple[Piece, np.ndarray]:
    """Return the farthest of several pieces in a random direction (3,), and that direction."""
    towards = _unit(rng.normal(size=3))
    return max(pieces, key=lambda piece: (piece.vertices @ towards).max()), towards


FEATURE: Mapping[State, Callable[[Piece, np.random.Generator, np.ndarray | None], Feature]] = MappingProxyType(
    {"face-face": face, "edge-edge": edge, "vertex-vertex": vertex}
)
"""State -> function that finds a feature for it."""


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
