"""What the compiled search rules out piece pairs by: spheres, boxes and support functions that hold whole pieces."""

import numpy as np
import pytest

from grasp_refine.collision.bounds import CELLS, bounds_of, support_table
from grasp_refine.collision.engine import engines
from grasp_refine.core.se3 import exp_so3
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from shapes_for_tests import ellipsoid_hull

TURNED = np.eye(4)
TURNED[:3, :3] = exp_so3(np.array([0.4, -1.1, 0.7]))

PIECES = {
    "sphere": sphere(0.02, [0.01, -0.02, 0.03]),
    "capsule": capsule(0.01, [0.02, 0, 0], [0.02, 0.05, -0.03]),
    "box": box([0.06, 0.01, 0.03], TURNED),
    "hull": ellipsoid_hull(2, 300).transformed(TURNED),
    "rounded hull": Piece(ellipsoid_hull(1, 30).vertices, ellipsoid_hull(1, 30).faces, radius=0.015),
}


@pytest.mark.parametrize("name", PIECES)
def test_spheres_and_boxes_hold_the_whole_piece(name: str) -> None:
    piece = PIECES[name]
    u = np.random.default_rng(0).normal(size=(300, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    points = piece.vertices[(u @ piece.vertices.T).argmax(axis=1)] + piece.radius * u
    bounds = bounds_of(list(PIECES.values()))
    center, radius, axes, half = (
        column[list(PIECES).index(name)] for column in (bounds.center, bounds.radius, bounds.axes, bounds.half)
    )
    assert np.linalg.norm(points - center, axis=1).max() <= radius * (1 + 1e-12)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert (np.abs((points - center) @ axes.T) <= half * (1 + 1e-12)).all()
    # Touched on all sides: the box is no larger than it must be.
    np.testing.assert_allclose(np.ptp(piece.vertices @ axes.T, axis=0) / 2 + piece.radius, half, rtol=1e-12)


def test_a_box_gets_its_own_sides_however_it_is_turned_and_a_sheet_its_thickness() -> None:
    np.testing.assert_allclose(np.sort(bounds_of([PIECES["box"]]).half[0]), [0.005, 0.015, 0.03], atol=1e-12)
    sheet = hull(np.random.default_rng(5).uniform(-1, 1, (40, 3)) * [0.05, 0.04, 1e-4])
    assert bounds_of([sheet]).half.min() < 1.2e-4


@pytest.mark.skipif("native" not in engines(), reason="only the compiled engine has a table")
def test_the_table_holds_the_support_functions_at_the_corners_of_the_cells() -> None:
    pieces = list(PIECES.values())
    table = support_table([pieces[:2], pieces, pieces[3:]])
    steps = np.linspace(-1.0, 1.0, CELLS + 1)
    # Of each side of the cube, the coordinate that is constant, and the two that follow it cyclically.
    u = np.array(
        [
            np.roll([sign, first, second], side)
            for side in range(3) for sign in (1.0, -1.0) for first in steps for second in steps
        ]
    )  # fmt: skip
    expected = [(u @ piece.vertices.T).max(axis=1) + piece.radius * np.linalg.norm(u, axis=1) for piece in pieces]
    np.testing.assert_allclose(table[1], np.transpose(expected), rtol=0, atol=1e-16)
    np.testing.assert_array_equal(table[0], np.c_[table[1, :, :2], np.zeros((len(u), 3))])
    np.testing.assert_array_equal(table[2, :, :2], table[1, :, 3:])
