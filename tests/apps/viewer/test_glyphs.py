"""Lines, arrows and cones are where the contacts are, and as large as what they stand for."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine_apps.viewer.glyphs import (
    CONE_HEIGHT,
    CONE_SIDES,
    UNIT_FORCE_LENGTH,
    force_arrows,
    friction_cones,
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
    vertices, faces = friction_cones(point, normal, friction, BODY)
    assert vertices.dtype == np.float32 and faces.dtype == np.uint32
    height = CONE_HEIGHT * DIAGONAL
    for number in range(2):
        away = vertices.reshape(2, -1, 3)[number].astype(float) - point[number]
        along = away @ normal[number]
        across = np.linalg.norm(away - along[:, None] * normal[number], axis=1)
        # The apex, the centre of the base, and its rim.
        tip, rim = along < height / 2, across > height * friction / 2
        assert (np.count_nonzero(tip), np.count_nonzero(rim), len(away)) == (1, CONE_SIDES, CONE_SIDES + 2)
        np.testing.assert_allclose(away[tip], 0.0, atol=1e-8)
        np.testing.assert_allclose(along[~tip], height, rtol=1e-5)
        np.testing.assert_allclose(across[rim] / along[rim], friction, rtol=1e-4)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight and mesh.body_count == 2
    pyramid = CONE_SIDES / 2 * np.sin(2 * np.pi / CONE_SIDES) * friction**2 * height**3 / 3
    assert mesh.volume == pytest.approx(2 * pyramid, rel=1e-4)  # positive: faces look outward


def test_no_contacts_no_cones():
    vertices, faces = friction_cones(np.zeros((0, 3)), np.zeros((0, 3)), 0.5, BODY)
    assert vertices.shape == (0, 3) and faces.shape == (0, 3)
