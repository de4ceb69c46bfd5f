"""Bodies that are generated: ellipsoids, and coils of them that are concave, with any number of pieces and vertices."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.engine import Engine
from grasp_refine.collision.query import Pairs
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine_apps.bench.queries.cases import Case

HALF = (0.05, 0.03, 0.02)
"""Half axes in metres of the ellipsoid of a convex body."""

RADIUS, THICKNESS, PITCH, OVERLAP = 0.045, 0.016, 0.024, 1.2
"""Of a coil: radius and thickness, how far it rises in a turn (metres), and how much longer pieces are than apart."""


def ellipsoid(rng: np.random.Generator, vertices: int, half: tuple[float, float, float], T: np.ndarray) -> Piece:
    """The hull of so many random points on an ellipsoid, all of which are its vertices.

    Args:
        rng: Draws them.
        vertices: How many.
        half: Half axes in metres.
        T: Its pose (4, 4) in the body.
    """
    directions = rng.normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return hull((directions * half) @ T[:3, :3].T + T[:3, 3])


def make_body(pieces: int, vertices: int, seed: int) -> Body:
    """A body with so many pieces, each with so many vertices: an ellipsoid, or else a coil about the z axis."""
    rng = np.random.default_rng((seed, pieces, vertices))
    if pieces == 1:
        return build_body("ellipsoid", [ellipsoid(rng, vertices, HALF, np.eye(4))], seed=seed)
    turns = max(1, round(np.sqrt(pieces) / 2))
    half = (THICKNESS / 2, OVERLAP * np.pi * RADIUS * turns / pieces, OVERLAP * PITCH / 2)
    parts = []
    for share in (np.arange(pieces) + 0.5) / pieces:
        angle = 2 * np.pi * turns * share
        c, s = np.cos(angle), np.sin(angle)
        T = np.array(
            [[c, -s, 0, RADIUS * c], [s, c, 0, RADIUS * s], [0, 0, 1, PITCH * turns * (share - 0.5)], [0, 0, 0, 1]]
        )
        parts.append(ellipsoid(rng, vertices, half, T))
    return build_body("coil", parts, seed=seed)


def make_pairs(case: Case, seed: int, engine: Engine = "auto") -> Pairs:
    """The pair of bodies of a case; the same seed gives the same bodies."""
    first, second = case.sides
    a, b = make_body(first, case.vertices, seed), make_body(second, case.vertices, seed + 1)
    return Pairs((a,), (b,), engine=engine)
