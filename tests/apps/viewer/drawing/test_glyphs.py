"""Lines, arrows and cones are where the contacts are, and as large as what they stand for."""

import numpy as np
import pytest

from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine_apps.viewer.drawing.glyphs import (
    CONE_HEIGHT,
    CONE_LINES,
    CONE_SIDES,
    UNIT_FORCE_LENGTH,
    force_arrows,
    friction_cones,
    newtons_per_centimetre,
    segments,
)

BODY = build_body("box", [box((0.1, 0.2, 0.2))], candidates=16)
DIAGONAL = 0.3


def test_lines_join_points_one_to_one_and_skip_what_is_not_known():
    start, end = np.arange(9.0).reshape(3, 3), np.ones((3, 3))
    end[1, 2] = np.nan
    lines = segments(start, end)
    assert lines.dtype == np.float32
    np.testing.assert_array_equal(lines, [[[0, 1, 2], [1, 1, 1]], [[6, 7, 8], [1, 1, 1]]])
    assert segments(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 2, 3)


def test_arrows_start_at_the_contacts_and_are_as_long_as_the_forces_say():
    point, force = (
        np.array([[0.05, 0, 0], [-0.05, 0, 0], [0, 0.1, 0]]),
        np.array([[-0.5, 0, 0], [0.3, 0.4, 0], [0, 0, 0]]),
    )
    arrows = force_arrows(point, force, BODY)
    np.testing.assert_allclose(arrows[:, 0], point[:2], atol=1e-8)
    np.testing.assert_allclose(arrows[:, 1] - arrows[:, 0], UNIT_FORCE_LENGTH * DIAGONAL * force[:2], atol=1e-7)


@pytest.mark.parametrize("friction", [0.15, 1.0])
def test_cones_open_into_the_object_by_the_angle_of_friction(friction: float):
    point = np.array([[0.05, 0.01, 0.02], [0.0, 0.0, 0.1]])
    normal = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    lines = friction_cones(point, normal, friction, BODY)
    assert lines.dtype == np.float32
    height = CONE_HEIGHT * DIAGONAL
    for number, ends in enumerate(lines.reshape(2, -1, 3).astype(float)):
        away = ends - point[number]
        along = away @ normal[number]
        across = np.linalg.norm(away - along[:, None] * normal[number], axis=1)
        tip = along < height / 2
        # Each line is on the rim, or goes from the apex to it.
        assert len(ends) == 2 * (CONE_SIDES + CONE_LINES) and np.count_nonzero(tip) == CONE_LINES
        np.testing.assert_allclose(away[tip], 0.0, atol=1e-8)
        np.testing.assert_allclose(along[~tip], height, rtol=1e-5)
        np.testing.assert_allclose(across[~tip] / along[~tip], friction, rtol=1e-4)


def test_an_arrow_of_a_centimetre_has_the_force_that_is_reported():
    force = np.array([[newtons_per_centimetre(BODY, 30.0) / 30.0, 0.0, 0.0]])
    ((start, end),) = force_arrows(np.zeros((1, 3)), force, BODY)
    assert np.linalg.norm(end - start) == pytest.approx(0.01, rel=1e-5)
