"""Tabulated support functions: never below the true ones, and how far above."""

import numpy as np
import pytest

from grasp_refine.collision.supports import Supports
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from shapes_for_tests import ellipsoid_hull

PIECES = [
    sphere(0.02, [0.01, -0.02, 0.03]),
    capsule(0.01, [0.02, 0, 0], [0.02, 0.05, -0.03]),
    box([0.06, 0.01, 0.03]),
    hull(np.random.default_rng(0).normal(size=(8, 3)) * 0.02),
    ellipsoid_hull(0),
    ellipsoid_hull(2, 300),
    Piece(ellipsoid_hull(1, 30).vertices, ellipsoid_hull(1, 30).faces, radius=0.015),
]


def directions(count: int) -> np.ndarray:
    """Random unit vectors, and those along the axes, edges and diagonals of the cube."""
    u = np.random.default_rng(1).normal(size=(count, 3))
    special = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 3)
    u = np.concatenate([special[special.any(axis=1)], u])
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def true_support(piece: Piece, u: np.ndarray) -> np.ndarray:
    return (u @ piece.vertices.T).max(axis=1) + piece.radius * np.linalg.norm(u, axis=1)


@pytest.mark.parametrize("k", range(len(PIECES)))
def test_a_piece_reaches_no_farther_than_the_table_says_and_hardly_less_far(k: int) -> None:
    u = directions(5000)
    found = Supports.of([PIECES]).along(np.zeros(len(u), dtype=int), u)[:, k]
    excess = found - true_support(PIECES[k], u)
    diameter = np.linalg.norm(np.ptp(PIECES[k].bounds, axis=0))
    assert excess.min() > -1e-15
    assert excess.max() < 0.04 * diameter and excess.mean() < 0.002 * diameter


def test_along_the_axes_edges_and_diagonals_of_the_cube_it_is_exact() -> None:
    u = directions(0)
    found = Supports.of([PIECES]).along(np.zeros(len(u), dtype=int), u)
    np.testing.assert_allclose(found, np.stack([true_support(piece, u) for piece in PIECES], axis=1), atol=1e-15)


def test_the_reach_of_a_point_is_its_coordinate() -> None:
    """The bilinear weights give every direction back, so a linear function is exact; so are directions' lengths."""
    point = np.array([0.3, -0.2, 0.5])
    dot = Piece(point[None], np.zeros((0, 3), dtype=np.int64))
    u = 3.0 * directions(500)
    np.testing.assert_allclose(Supports.of([[dot]]).along(np.zeros(len(u), dtype=int), u)[:, 0], u @ point, atol=1e-14)


def test_each_body_has_its_own_rows() -> None:
    bodies = [PIECES[:1], PIECES[2:5], PIECES[1:3]]
    u = directions(20)
    together = Supports.of(bodies)
    for index, pieces in enumerate(bodies):
        found = together.along(np.full(len(u), index), u)
        alone = Supports.of([pieces]).along(np.zeros(len(u), dtype=int), u)
        np.testing.assert_allclose(found[:, : len(pieces)], alone, atol=1e-16)
        assert not found[:, len(pieces) :].any()
    mixed = np.arange(len(u)) % 3
    expected = [together.along(np.array([m]), u[k : k + 1])[0] for k, m in enumerate(mixed)]
    np.testing.assert_allclose(together.along(mixed, u), expected, atol=1e-16)
