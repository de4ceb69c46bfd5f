"""Bodies: bounding spheres that hold their pieces, sizes, and refusals that name the body."""

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, capsule, cylinder, hull, sphere
from refusals import refused


@pytest.fixture
def body():
    points = np.random.default_rng(0).normal(size=(3, 50, 3)) * 0.02
    blobs = [hull(cloud + [0.1 * index, 0, 0]) for index, cloud in enumerate(points)]
    return build_body("three", [*blobs, capsule(0.01, [0, 0, 0.1], [0, 0.1, 0.1]), sphere(0.02, [0.3, 0, 0])])


def test_bounding_spheres_hold_their_pieces(body):
    assert body.centers.shape == (5, 3) and body.radii.shape == (5,)
    for piece, center, radius in zip(body.pieces, body.centers, body.radii, strict=True):
        assert np.linalg.norm(piece.mesh().vertices - center, axis=1).max() <= radius * (1 + 1e-12)
        assert radius <= np.linalg.norm(np.ptp(piece.bounds, axis=0)) / 2 * (1 + 1e-12)


def test_bounding_spheres_of_primitives_are_the_smallest_ones():
    body = build_body("primitives", [sphere(0.02), box([0.2, 0.3, 0.6]), capsule(0.1, [0, 0, 0], [0, 0, 0.3])])
    np.testing.assert_allclose(body.radii, [0.02, 0.35, 0.25])
    np.testing.assert_allclose(body.centers, [[0, 0, 0], [0, 0, 0], [0, 0, 0.15]])


def test_diagonal_spans_all_pieces_and_their_radii():
    body = build_body("pair", [sphere(0.1), sphere(0.1, [0.3, 0, 0])])
    assert body.diagonal == pytest.approx(np.linalg.norm([0.5, 0.2, 0.2]))


def test_the_extent_is_that_of_a_sphere_about_the_mean_vertex_in_any_frame(body):
    """A box has its diagonal, a capsule its length; the axis-aligned diagonal changes as a body turns."""
    assert build_body("box", [box([0.2, 0.3, 0.6])]).extent == pytest.approx(0.7)
    assert build_body("capsule", [capsule(0.1, [0, 0, 0], [0, 0, 0.3])]).extent == pytest.approx(0.5)
    T = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, -1.1, 0.7]))
    moved = build_body("three", [piece.transformed(T) for piece in body.pieces])
    assert moved.extent == pytest.approx(body.extent, rel=1e-12)
    assert moved.diagonal != pytest.approx(body.diagonal, rel=0.01)
    for piece, other in zip(body.pieces, moved.pieces, strict=True):
        assert other.extent == pytest.approx(piece.extent, rel=1e-12)


def test_area_is_what_the_candidates_stand_for(body):
    assert body.area == pytest.approx(body.candidates.areas.sum())
    union = trimesh.boolean.union([piece.mesh() for piece in body.pieces])
    assert body.area == pytest.approx(union.area, rel=0.03)


def test_the_number_and_the_seed_of_the_candidates_are_passed_on():
    one = build_body("rod", [cylinder(0.01, 0.1)], candidates=77, seed=1)
    other = build_body("rod", [cylinder(0.01, 0.1)], candidates=77, seed=2)
    assert one.candidates.points.shape == (77, 3)
    assert not np.array_equal(one.candidates.points, other.candidates.points)
    assert one.name == "rod" and isinstance(one.pieces, tuple)


def test_refusals_name_the_body():
    with refused(MeshError, "link palm", "convex piece"):
        build_body("link palm", [])
    with refused(MeshError, "link palm", "candidates", "1"):
        build_body("link palm", [sphere(0.1)], candidates=0)
