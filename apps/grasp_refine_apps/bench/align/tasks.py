"""Alignment tasks: bring two bodies together so that they touch at a given point of each.

A target is a vertex with its area-weighted normal, or a point drawn uniformly on the exposed faces. The *aligned
pose* of a task puts both targets on each other with opposite normals, turned about them by a roll that is drawn
once. Not all pairs of targets can touch, because something else may be in the way. So the witness points at the
aligned pose, without a gap, decide which tasks are `accepted`, and which of these are certainly solvable (`reachable`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_records import join, take
from grasp_refine.core.se3 import exp_so3, matrix_from_quaternion, matvec, tangents, transform, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.sampling import CLEARANCE, beside, internal
from grasp_refine_apps.bench.align.bodies import BodyPair

CLASSES = ("vertex-vertex", "face-vertex", "vertex-face", "face-face")
"""Features that the targets lie on, first on body a, then on body b."""

ACCEPTED_MISS_M, REACHABLE_MISS_M = 1e-2, 1e-4
"""Largest miss (metres) at the aligned pose of tasks that count, and of tasks that are certainly solvable."""

ACCEPTED_PER_REJECTED = 8
"""Accepted tasks for each rejected one that is run, to estimate an unfiltered benchmark."""

Source = Callable[[int, np.random.Generator], tuple[np.ndarray, np.ndarray]]
"""Draws up to a number of targets (N, 3) of a body, with their normals (N, 3)."""

_MAX_DRAWS = 40
"""Draws, each of four times the requested number, before a pair counts as one with too few accepted tasks."""


@dataclass(frozen=True, eq=False)
class Tasks:
    """N alignment tasks of one pair of bodies."""

    target_class: np.ndarray
    """Index into `CLASSES` (N,)."""
    target_a: np.ndarray
    """Point to touch (N, 3) in the frame of body a, metres."""
    target_b: np.ndarray
    """Point to touch (N, 3) in the frame of body b, metres."""
    T_world_a: np.ndarray
    """Initial poses (N, 4, 4) of body a."""
    T_world_b: np.ndarray
    """Initial poses (N, 4, 4) of body b."""
    accepted: np.ndarray
    """Tasks (N,) whose miss at the aligned pose is below `ACCEPTED_MISS_M`."""
    reachable: np.ndarray
    """Tasks (N,) whose miss at the aligned pose is below `REACHABLE_MISS_M`."""
    weight: np.ndarray
    """Number of drawn tasks that each task represents (N,): 1 for accepted, more for rejected tasks."""

    def __len__(self) -> int:
        return len(self.target_class)

    def take(self, index: np.ndarray) -> Tasks:
        """Select the tasks `index`."""
        return take(self, index)

    def every(self, step: int) -> Tasks:
        """Select every `step`-th accepted and rejected task of each class; their weights include the tasks left out."""
        weight, kept = self.weight.copy(), []
        for index in range(len(CLASSES)):
            for accepted in (True, False):
                group = np.flatnonzero((self.target_class == index) & (self.accepted == accepted))
                some = group[::step]
                weight[some] *= weight[group].sum() / max(weight[some].sum(), 1.0)
                kept.append(some)
        return replace(self, weight=weight).take(np.sort(np.concatenate(kept)))


def draw_tasks(pair: BodyPair, classes: Sequence[str], count: int, seed: int | tuple[int, ...]) -> Tasks:
    """Draw `count` accepted tasks of a pair, shared evenly among `classes`, and a sample of rejected tasks.

    Fewer, where too few tasks of a class are accepted. Tasks of a class depend on the pair and the seed only; pairs
    of one benchmark need different seeds, or they would share their random numbers.
    """
    seed = (seed,) if isinstance(seed, int) else seed
    shares = np.diff(np.floor(np.linspace(0, count, len(classes) + 1)).astype(int))
    drawn = [
        _of_class(pair, CLASSES.index(name), share, np.random.default_rng((*seed, CLASSES.index(name))))
        for name, share in zip(classes, shares, strict=True)
        if share
    ]
    return join(*drawn)


def aligned_poses(
    T_world_a: np.ndarray, on_a: tuple[np.ndarray, np.ndarray], on_b: tuple[np.ndarray, np.ndarray], roll: np.ndarray
) -> np.ndarray:
    """Return poses (N, 4, 4) of body b that put its targets onto the targets of body a, with opposite normals.

    Args:
        T_world_a: Poses of body a (N, 4, 4).
        on_a: Targets (N, 3) and outward unit normals (N, 3), in the frame of body a.
        on_b: Targets (N, 3) and outward unit normals (N, 3), in the frame of body b.
        roll: Angles (N,) about the normal, radians.
    """
    frame_a, frame_b = _frame(on_a[1]), _frame(-on_b[1])
    turn = exp_so3(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    R = frame_a @ turn @ frame_b.mT
    return T_world_a @ transform(R, on_a[0] - matvec(R, on_b[0]))


def exposed_vertices(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) that are part of one piece only, and their area-weighted unit normals (V, 3)."""
    points, normals, owners = [], [], []
    for number, piece in enumerate(body.pieces):
        total = np.zeros_like(piece.vertices)
        for corner in range(3):
            np.add.at(total, piece.faces[:, corner], piece.areas[:, None] * piece.normals)
        length = np.linalg.norm(total, axis=1)
        known = length > 1e-9 * length.max()
        points.append(piece.vertices[known])
        normals.append(total[known] / length[known, None])
        owners.append(np.full(known.sum(), number))
    point, normal, owner = (np.concatenate(columns) for columns in (points, normals, owners))
    free = ~beside(point, owner, body.pieces, CLEARANCE * body.diagonal)
    return point[free], normal[free]


def points_on_faces(body: Body, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw at most `count` points (N, 3) uniformly on all faces, except those inside the body, and their normals."""
    areas = [piece.areas for piece in body.pieces]
    owner_of = np.repeat(np.arange(len(areas)), [len(area) for area in areas])
    corners_of = np.concatenate([piece.vertices[piece.faces] for piece in body.pieces])
    normal_of = np.concatenate([piece.normals for piece in body.pieces])
    area = np.concatenate(areas)
    face = rng.choice(len(area), size=count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), size=count)
    points = np.einsum("nk,nkc->nc", weights, corners_of[face])
    inside = internal(points, normal_of[face], owner_of[face], body.pieces, CLEARANCE * body.diagonal)
    return points[~inside], normal_of[face][~inside]


def _of_class(pair: BodyPair, index: int, count: int, rng: np.random.Generator) -> Tasks:
    """Draw `count` accepted tasks of one class, or as many as were found, then the sample of the rejected."""
    pairs = Pairs((pair.a,), (pair.b,))
    sources = [_source(body, place) for body, place in zip((pair.a, pair.b), CLASSES[index].split("-"), strict=True)]
    found: list[Tasks] = []
    for _ in range(_MAX_DRAWS):
        found.append(_draw(pair, pairs, sources, index, 4 * count, rng))
        if sum(int(one.accepted.sum()) for one in found) >= count:
            break
    tasks = join(*found)
    accepted = np.flatnonzero(tasks.accepted)
    # Tasks drawn after the last one needed do not count for the acceptance rate.
    last = accepted[count - 1] + 1 if len(accepted) >= count else len(tasks)
    accepted, rejected = accepted[:count], np.flatnonzero(~tasks.accepted[:last])
    sample = rejected[: max(1, count // ACCEPTED_PER_REJECTED)]
    if len(sample):
        tasks.weight[sample] = len(rejected) / len(sample)
    return tasks.take(np.concatenate([accepted, sample]))


def _draw(
    pair: BodyPair, pairs: Pairs, sources: Sequence[Source], index: int, count: int, rng: np.random.Generator
) -> Tasks:
    """Draw up to `count` tasks of one class, accepted or not."""
    targets = [source(count, rng) for source in sources]
    N = min(len(points) for points, _ in targets)
    (t_a, n_a), (t_b, n_b) = ((points[:N], normals[:N]) for points, normals in targets)
    T_a = np.broadcast_to(np.eye(4), (N, 4, 4)).copy()
    T_aligned = aligned_poses(T_a, (t_a, n_a), (t_b, n_b), rng.uniform(0.0, 2.0 * np.pi, N))
    at = query(pairs, T_a[:, None], T_aligned[:, None])
    miss_a = at.point_a[:, 0] - transform_points(T_a, t_a)
    miss_b = at.point_b[:, 0] - transform_points(T_aligned, t_b)
    miss = np.sqrt((miss_a**2).sum(axis=1) + (miss_b**2).sum(axis=1))
    miss[~at.valid[:, 0]] = np.inf
    return Tasks(
        np.full(N, index),
        t_a,
        t_b,
        T_a,
        _initial(pair, N, rng),
        miss < ACCEPTED_MISS_M,
        miss < REACHABLE_MISS_M,
        np.ones(N),
    )


def _source(body: Body, place: str) -> Source:
    """Return a sampler of targets of a body: on its exposed vertices, which are found once, or on its faces."""
    if place == "face":
        return partial(points_on_faces, body)
    points, normals = exposed_vertices(body)

    def draw(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        chosen = rng.integers(len(points), size=count if len(points) else 0)
        return points[chosen], normals[chosen]

    return draw


def _initial(pair: BodyPair, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw random poses (count, 4, 4) of body b: any orientation, centres 0.5 to 1.5 mean diagonals apart.

    About a tenth of them penetrate.
    """
    quaternion = rng.normal(size=(count, 4))
    R = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    away = rng.uniform(0.5, 1.5, size=(count, 1)) * 0.5 * (pair.a.diagonal + pair.b.diagonal)
    return transform(R, away * direction)


def _frame(normal: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) whose third columns are unit normals (N, 3)."""
    return np.concatenate([tangents(normal), normal[..., None]], axis=-1)
