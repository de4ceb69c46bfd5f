"""Bodies that several tests share: convex, concave, and random poses that bring them together."""

from itertools import product

import numpy as np

from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere


def ellipsoid_hull(seed: int, vertices: int = 100, axes: tuple[float, float, float] = (0.05, 0.03, 0.02)) -> Piece:
    """The hull of random points on an ellipsoid."""
    directions = np.random.default_rng(seed).normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return hull(directions * axes)


def piece_body(piece: Piece) -> Body:
    """A body of one piece, with few candidates."""
    return build_body("piece", [piece], candidates=16)


def convex_body(seed: int, vertices: int = 100) -> Body:
    """A body of one such hull."""
    return build_body(f"hull {seed}", [ellipsoid_hull(seed, vertices)], seed=seed)


def ring_pieces(pieces: int = 10) -> list[Piece]:
    """Wedges of a ring about z, 12 cm wide with a hole of 7 cm, 3 cm high; neighbours share a face."""
    edges = np.linspace(0.0, 2.0 * np.pi, pieces + 1)
    parts = []
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        corners = product((0.035, 0.06), (start, (start + stop) / 2, stop), (-0.015, 0.015))
        parts.append(hull([(r * np.cos(angle), r * np.sin(angle), z) for r, angle, z in corners]))
    return parts


def ring_body(seed: int = 0, pieces: int = 10) -> Body:
    """That ring as a concave body."""
    return build_body("ring", ring_pieces(pieces), seed=seed)


def cluster_body(seed: int, pieces: int = 5) -> Body:
    """Random hulls, some of which overlap and some of which lie apart."""
    rng = np.random.default_rng(seed)
    parts = [hull(rng.normal(size=(15, 3)) * 0.015 + center) for center in rng.normal(size=(pieces, 3)) * 0.04]
    return build_body(f"cluster {seed}", parts, seed=seed)


BODY_PAIRS = {
    "hulls": lambda: (convex_body(0), convex_body(1)),
    "concave": lambda: (cluster_body(2), cluster_body(3)),
    "ring and hull": lambda: (ring_body(1), convex_body(0)),
    "sphere and box": lambda: (build_body("s", [sphere(0.02)]), build_body("b", [box([0.05, 0.04, 0.03])])),
    "capsule and hull": lambda: (build_body("c", [capsule(0.01, (0, 0, -0.02), (0, 0, 0.03))]), convex_body(4)),
}
"""Name -> function that makes two bodies."""
