"""Generated bodies: ellipsoids, and concave coils of them, with any number of pieces and vertices."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.engine import Engine
from grasp_refine.collision.query import Pairs
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine_apps.bench.queries.cases import Case

HALF_AXES_M = (0.05, 0.03, 0.02)
"""Half axes in metres of the ellipsoid of a convex body."""

COIL_RADIUS_M, COIL_THICKNESS_M, COIL_PITCH_M, PIECE_OVERLAP = 0.045, 0.016, 0.024, 1.2
"""Dimensions of a coil: radius, thickness, rise per turn (metres), and length of pieces over their spacing."""


def ellipsoid(rng: np.random.Generator, vertices: int, half: tuple[float, float, float], T: np.ndarray) -> Piece:
    """Return the hull of random points on an ellipsoid, all of which are its vertices.

    Args:
        rng: Generator of the points.
        vertices: Number of points.
        half: Half axes in metres.
        T: Its pose (4, 4) in the body.
    """
    directions = rng.normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return hull((directions * half) @ T[:3, :3].T + T[:3, 3])


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
