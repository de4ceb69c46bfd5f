"""Distances from points to triangle meshes, against closed forms and every triangle in turn."""

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry.nearest_triangle import Triangles, distance_to_triangles

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ([1, 1, 2], 2),  # above the face
        ([1, 1, -2], 2),  # below it
        ([2, -3, 4], 5),  # beside an edge
        ([-3, -4, 0], 5),  # beside a corner
        ([2 + 3, 1.5 + 4, 0], 5),  # along the normal (3, 4) of the long edge, from its middle
        ([4 + 2, -1, 2], 3),
        ([1, 0, 0], 0),
    ],
)
def test_distance_to_a_triangle_in_closed_form(point: list[float], distance: float) -> None:
    for corners in (TRIANGLE, TRIANGLE[::-1], np.roll(TRIANGLE, 1, axis=0)):
        assert distance_to_triangles(np.array([point], dtype=float), corners[None])[0] == pytest.approx(
            distance, abs=1e-15
        )


def test_a_triangle_may_be_a_segment_or_a_point() -> None:
    segment, point = TRIANGLE[[0, 1, 1]], TRIANGLE[[0, 0, 0]]
    points = np.array([[2.0, 3, 4], [6, 0, 0], [0, 3, 4]])
    np.testing.assert_array_equal(distance_to_triangles(points, np.stack([segment, segment, point])), [5, 2, 5])


@pytest.mark.parametrize("count", [1, 3, 4, 5, 600])
def test_the_nearest_triangle_is_the_nearest_of_all(count: int) -> None:
    rng = np.random.default_rng(count)
    # Slivers, small and large triangles, near each other and far.
    corners = rng.standard_normal((count, 1, 3)) + rng.standard_normal((count, 3, 3)) * rng.random((count, 1, 3)) ** 4
    points = np.concatenate([rng.standard_normal((200, 3)), 100 * rng.standard_normal((20, 3)), corners[:, 0]])
    distance, triangle = Triangles(corners).nearest(points)
    every = distance_to_triangles(points[:, None], corners[None])
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(every[np.arange(len(points)), triangle], distance, rtol=1e-9, atol=1e-12)


def test_more_points_than_a_block_keep_their_order() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    points = np.random.default_rng(0).standard_normal((10_000, 3))
    distance, _ = Triangles(np.asarray(ball.triangles)).nearest(points)
    # The faces of the mesh lie up to 0.3 % of the radius inside the sphere.
    np.testing.assert_allclose(distance, np.abs(np.linalg.norm(points, axis=1) - 1), atol=5e-3)


def test_no_points() -> None:
    distance, triangle = Triangles(TRIANGLE[None]).nearest(np.zeros((0, 3)))
    assert len(distance) == len(triangle) == 0
