"""Cases: generated bodies, ellipsoids and concave coils of them, and poses in which two are a given distance apart."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from grasp_refine.collision.engine import Engine
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, hull

Kind = Literal["convex", "mixed", "concave"]
"""One piece against one; one against several, as a link against an object; several against several."""

State = Literal["far", "near", "touching", "shallow", "deep"]
"""Relative state of the bodies, see `STATE_DISTANCES_M`."""

STATE_DISTANCES_M: dict[State, float] = {"far": 0.2, "near": 0.004, "touching": 0.0, "shallow": -0.001, "deep": -0.005}
"""Signed distance of the bodies in metres, which are 10 to 14 cm long."""

HALF_AXES_M = (0.05, 0.03, 0.02)
"""Half axes in metres of the ellipsoid of a convex body."""

COIL_RADIUS_M, COIL_THICKNESS_M, COIL_PITCH_M, PIECE_OVERLAP = 0.045, 0.016, 0.024, 1.2
"""Dimensions of a coil: radius, thickness, rise per turn (metres), and length of pieces over their spacing."""

START_GAP_M = 0.3
"""Initial gap of the bodies in metres, larger than their length."""

DISTANCE_TOLERANCE = 0.1
"""Largest difference of the signed distance from the desired one, as its share; in contact: `CONTACT_TOLERANCE_M`."""
CONTACT_TOLERANCE_M = 1e-9

DRAWS_PER_POSE = 40
"""Largest number of poses drawn per requested pose."""

STEP_DEVIATIONS = (0.001, 0.02)
"""Standard deviations of a solver's step, in metres and radians: the offset of the poses of a warm start."""


@dataclass(frozen=True)
class Case:
    """A case to be measured; its fields are entries of a row."""

    kind: Kind = "convex"
    pieces: int = 1
    """Pieces of each body, only of the second one where the kind is mixed; 1 where it is convex."""
    vertices: int = 32
    """Vertices of each piece."""
    state: State = "near"
    batch: int = 256
    """Poses in one call."""

    @property
    def sides(self) -> tuple[int, int]:
        """Pieces of the first and of the second body."""
        return (self.pieces if self.kind == "concave" else 1), (1 if self.kind == "convex" else self.pieces)

    @property
    def piece_pairs(self) -> int:
        """Piece pairs of the two bodies."""
        first, second = self.sides
        return first * second


def cases_of(
    kinds: tuple[Kind, ...],
    pieces: tuple[int, ...],
    vertices: tuple[int, ...],
    states: tuple[State, ...],
    batches: tuple[int, ...],
) -> tuple[Case, ...]:
    """Return every combination; convex bodies have one piece."""
    found = (
        Case(kind, 1 if kind == "convex" else count, corners, state, batch)
        for kind, count, corners, state, batch in product(kinds, pieces, vertices, states, batches)
    )
    return tuple(dict.fromkeys(found))


def ellipsoid(rng: np.random.Generator, vertices: int, half: tuple[float, float, float], T: np.ndarray) -> Piece:
    """Return the hull of random points on an ellipsoid; all of them are vertices.

    Args:
        rng: Generator of the points.
        vertices: Number of points.
        half: Half axes in metres.
        T: Pose (4, 4) of the ellipsoid in the body.
    """
    return hull(points_on_ellipsoid(rng, vertices, half) @ T[:3, :3].T + T[:3, 3])


def points_on_ellipsoid(rng: np.random.Generator, count: int, half: tuple[float, float, float]) -> np.ndarray:
    """Draw points (count, 3) on an ellipsoid with these half axes, about the origin."""
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * half


def make_body(pieces: int, vertices: int, seed: int) -> Body:
    """Make a body of `pieces` pieces with `vertices` vertices each: an ellipsoid, or else a coil about the z axis."""
    rng = np.random.default_rng((seed, pieces, vertices))
    if pieces == 1:
        return build_body("ellipsoid", [ellipsoid(rng, vertices, HALF_AXES_M, np.eye(4))], seed=seed)
    turns = max(1, round(np.sqrt(pieces) / 2))
    half = (
        COIL_THICKNESS_M / 2,
        PIECE_OVERLAP * np.pi * COIL_RADIUS_M * turns / pieces,
        PIECE_OVERLAP * COIL_PITCH_M / 2,
    )
    parts = []
    for share in (np.arange(pieces) + 0.5) / pieces:
        angle = 2 * np.pi * turns * share
        c, s = np.cos(angle), np.sin(angle)
        T = np.array(
            [
                [c, -s, 0, COIL_RADIUS_M * c],
                [s, c, 0, COIL_RADIUS_M * s],
                [0, 0, 1, COIL_PITCH_M * turns * (share - 0.5)],
                [0, 0, 0, 1],
            ]
        )
        parts.append(ellipsoid(rng, vertices, half, T))
    return build_body("coil", parts, seed=seed)


def make_pairs(case: Case, seed: int, engine: Engine = "auto") -> Pairs:
    """Make the pair of bodies of a case; equal seeds give equal bodies."""
    first, second = case.sides
    a, b = make_body(first, case.vertices, seed), make_body(second, case.vertices, seed + 1)
    return Pairs((a,), (b,), engine=engine)


def draw_poses(pairs: Pairs, distance: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw poses (count, 1, 4, 4) of the first and of the second body, at a signed distance.

    Apart, a body that moves by d - d' along the witness normal is d' away, whatever its shape. Beyond contact, the
    move reaches the depth only where no other direction is shallower: other draws are rejected.

    Args:
        pairs: One pair of bodies.
        distance: Desired signed distance in metres.
        count: Number of poses.
        seed: Seed of all draws.

    Raises:
        GraspRefineError: too few draws reached that distance.
    """
    rng = np.random.default_rng(seed)
    allowed = DISTANCE_TOLERANCE * abs(distance) + CONTACT_TOLERANCE_M
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(DRAWS_PER_POSE):
        T_a, T_b = _apart(rng, count)
        for wanted in (max(distance, 0.0), distance):
            witness = query(pairs, T_a, T_b)
            T_b[..., :3, 3] += (wanted - witness.distance)[..., None] * witness.normal
        off = np.abs(query(pairs, T_a, T_b).distance[:, 0] - distance)
        good = np.flatnonzero(off <= allowed)
        found.append((T_a[good], T_b[good]))
        if sum(len(first) for first, _ in found) >= count:
            first, second = (np.concatenate(side)[:count] for side in zip(*found, strict=True))
            return first, second
    raise GraspRefineError(f"bodies of this kind cannot be {1e3 * distance:g} mm apart: choose other states or pieces")


def nearby(T: np.ndarray, seed: int, step: tuple[float, float] = STEP_DEVIATIONS) -> np.ndarray:
    """Return poses a random step from `T` (..., 4, 4), with standard deviations in metres and radians."""
    rng = np.random.default_rng(seed)
    scale = np.repeat(step, 3)
    noise = exp_se3(rng.normal(size=(*T.shape[:-2], 6)) * scale)
    moved = T.copy()
    moved[..., :3, :3] = noise[..., :3, :3] @ T[..., :3, :3]
    moved[..., :3, 3] += noise[..., :3, 3]
    return moved


def _apart(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw relative poses in any direction, with the bodies apart."""
    T_a, T_b = exp_se3(rng.normal(size=(2, count, 1, 6)) * [0.02, 0.02, 0.02, 2, 2, 2])
    away = rng.normal(size=(count, 1, 3))
    T_b[..., :3, 3] = T_a[..., :3, 3] + START_GAP_M * away / np.linalg.norm(away, axis=-1, keepdims=True)
    return T_a, T_b
