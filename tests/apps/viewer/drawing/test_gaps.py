"""Gaps outside an object: closed forms of balls and boxes, colours only where a surface is near."""

import numpy as np
import pytest
import trimesh

from grasp_refine.core.se3 import exp_se3, inverse, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, sphere
from grasp_refine_apps.viewer.drawing.colors import distance_colors
from grasp_refine_apps.viewer.drawing.depth import DepthField
from grasp_refine_apps.viewer.drawing.gaps import REACH_M, GapField, gap_patch
from grasp_refine_apps.viewer.drawing.shapes import LIFT_M, Shape

HALF = np.array([0.01, 0.02, 0.03])


def field(*pieces: object) -> GapField:
    return GapField(DepthField.of(build_body("thing", pieces, candidates=32)))


def test_distance_from_edges_and_corners_of_a_box_is_exact() -> None:
    """Planes alone would give less there."""
    gaps, points = field(box(2 * HALF)), np.random.default_rng(0).uniform(-0.035, 0.035, (2000, 3))
    away = np.abs(points) - HALF
    exact = np.linalg.norm(np.maximum(away, 0.0), axis=1) + np.minimum(away.max(axis=1), 0.0)
    found = gaps(points, gaps.field(points), REACH_M)
    np.testing.assert_allclose(found, np.minimum(exact, REACH_M), atol=1e-8)
    corner = (away > 0.0).sum(axis=1) >= 2
    assert (corner & (exact < REACH_M)).sum() > 5


@pytest.mark.parametrize("gap", [-0.001, 0.0005, 0.002])
def test_a_ball_over_a_plate_is_coloured_by_its_height(gap: float) -> None:
    radius, T = 0.02, exp_se3(np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.9]))
    T[:3, 3] = 0.01, 0.02, 0.05 + radius + gap
    ball = trimesh.creation.icosphere(4, radius)
    shape = Shape(ball.vertices.astype(np.float32), ball.faces.astype(np.uint32), (0, 0, 0), "link")
    patch = gap_patch(shape, T, field(box((0.2, 0.2, 0.1))))
    assert patch is not None
    used = np.unique(patch.faces)
    points = transform_points(T, patch.vertices[used].astype(float))
    height = points[:, 2] - 0.05
    # The patch lies a little over the surface, so that it is seen.
    np.testing.assert_allclose(-patch.depth[used], np.minimum(height, REACH_M), atol=1.5 * LIFT_M)
    assert height.min() == pytest.approx(gap - LIFT_M, abs=2e-5)
    np.testing.assert_array_equal(patch.colors[used], distance_colors(-patch.depth[used]))
    assert np.linalg.norm(transform_points(inverse(T), points), axis=1).min() > radius - 1e-4


def test_nothing_is_coloured_far_away() -> None:
    ball = trimesh.creation.icosphere(2, 0.01)
    shape = Shape(ball.vertices.astype(np.float32), ball.faces.astype(np.uint32), (0, 0, 0), "link")
    T = np.eye(4)
    T[:3, 3] = 0.0, 0.0, 0.03 + 0.01 + 2 * REACH_M
    assert gap_patch(shape, T, field(box(2 * HALF))) is None
    assert gap_patch(shape, T, field(sphere(0.03))) is None
