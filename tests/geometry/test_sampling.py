"""Surface candidates: on the surface, outward, uniform by area, none inside the body, the same for a seed."""

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry import sampling
from grasp_refine.geometry.pieces import Piece, box, capsule, cylinder, hull, sphere
from grasp_refine.geometry.sampling import sample
from refusals import refused


def shifted(x: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x
    return T


def clearance(points: np.ndarray, piece: Piece) -> np.ndarray:
    """Largest signed plane distance (N,) to a polytope."""
    normals, offsets = piece.planes
    return (points @ normals.T - offsets).max(1)


def blobs(count: int, seed: int = 0) -> list[Piece]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 60, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return [hull(0.03 * points + 0.03 * rng.normal(size=3)) for points in directions]


@pytest.mark.parametrize("count", [1, 2, 7, 100, 3000])
@pytest.mark.parametrize("pieces", [[box([0.1, 0.2, 0.3])], [sphere(0.1)], blobs(6)], ids=["box", "ball", "many"])
def test_there_are_exactly_as_many_as_asked(pieces, count):
    found = sample(pieces, count, seed=0)
    assert found.points.shape == found.normals.shape == (count, 3)
    assert found.areas.shape == (count,)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1)


def test_a_box_has_its_corners_its_faces_and_its_area():
    half = np.array([0.05, 0.1, 0.15])
    found = sample([box(2 * half)], 2000, seed=0)
    assert found.areas.sum() == pytest.approx(8 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0]))
    on_plane = np.isclose(np.abs(found.points), half)
    assert on_plane.any(axis=1).all()
    corner = on_plane.all(axis=1)
    assert corner.sum() == 8
    # Weighted by angle, the three faces at a corner count alike, however they are cut into triangles.
    np.testing.assert_allclose(found.normals[corner], np.sign(found.points[corner]) / np.sqrt(3))
    axis = np.argmax(on_plane[~corner], axis=1)
    np.testing.assert_allclose(found.normals[~corner], np.sign(found.points[~corner]) * np.eye(3)[axis])
    for side in range(3):
        share = half.prod() / half[side] / (half[0] * half[1] + half[1] * half[2] + half[2] * half[0])
        assert (axis == side).mean() == pytest.approx(share, abs=0.03)


def test_at_most_half_are_vertices():
    ball = hull(trimesh.creation.icosphere(3).vertices)
    found = sample([ball], 100, seed=0)
    at_vertex = np.isclose(np.linalg.norm(found.points, axis=1), 1, atol=1e-12)
    assert at_vertex.sum() == 50
    np.testing.assert_allclose(found.normals[at_vertex], found.points[at_vertex], atol=0.02)


def test_a_sphere_is_sampled_on_its_round_surface():
    center = np.array([1.0, 2.0, 3.0])
    found = sample([sphere(0.1, center)], 4000, seed=0)
    np.testing.assert_allclose(found.points, center + 0.1 * found.normals, rtol=1e-14)
    assert found.areas.sum() == pytest.approx(4 * np.pi * 0.01)
    np.testing.assert_allclose(found.normals.T @ found.normals / 4000, np.eye(3) / 3, atol=0.02)


def test_a_capsule_is_sampled_on_its_round_surface():
    found = sample([capsule(0.1, [0, 0, 0], [0, 0, 0.3])], 4000, seed=0)
    core = np.outer(found.points[:, 2].clip(0, 0.3), [0, 0, 1])
    np.testing.assert_allclose(found.points, core + 0.1 * found.normals, atol=1e-15)
    assert found.areas.sum() == pytest.approx(2 * np.pi * 0.1 * 0.3 + 4 * np.pi * 0.01)
    between = (found.points[:, 2] > 0) & (found.points[:, 2] < 0.3)
    assert between.mean() == pytest.approx(0.6, abs=0.01)


def test_a_rounded_box_follows_steiners_formula():
    core, radius = box([0.1, 0.2, 0.3]), 0.05
    found = sample([Piece(core.vertices, core.faces, radius)], 4000, seed=0)
    exact = 0.22 + radius * (np.pi / 2) * 4 * 0.6 + 4 * np.pi * radius**2
    assert found.areas.sum() == pytest.approx(exact)
    nearest = found.points.clip([-0.05, -0.1, -0.15], [0.05, 0.1, 0.15])
    np.testing.assert_allclose(found.points, nearest + radius * found.normals, atol=1e-15)


def test_no_candidate_lies_on_an_internal_cut():
    found = sample([box([0.1, 0.1, 0.1]), box([0.1, 0.1, 0.1], shifted(0.1))], 4000, seed=0)
    assert found.areas.sum() == pytest.approx(0.1, rel=0.01)
    on_cut = np.abs(found.points[:, 0] - 0.05) < 1e-5
    assert np.isclose(np.abs(found.points[on_cut, 1:]).max(1), 0.05).all()
    # Away from the eight true corners every normal is a face's: the corners at the cut would lean into it.
    leaning = np.abs(found.normals).max(1) < 0.999
    assert leaning.sum() == 8


def test_flush_surfaces_of_overlapping_pieces_count_once():
    found = sample([box([0.1, 0.1, 0.1]), box([0.1, 0.1, 0.1], shifted(0.05))], 4000, seed=0)
    exact = 2 * 0.01 + 4 * 0.15 * 0.1
    assert found.areas.sum() == pytest.approx(exact, rel=0.015)
    doubled = (found.points[:, 0] > 0.001) & (found.points[:, 0] < 0.049)
    assert doubled.mean() == pytest.approx(4 * 0.048 * 0.1 / exact, abs=0.02)
    inner_ends = np.isclose(np.abs(found.points[:, 0] - 0.025), 0.025) & (np.abs(found.normals[:, 0]) > 0.9)
    assert not inner_ends.any()


def test_the_area_of_two_overlapping_spheres_is_that_of_their_union():
    found = sample([sphere(0.1), sphere(0.1, [0.1, 0, 0])], 4000, seed=0)
    cap = 2 * np.pi * 0.1 * 0.05
    assert found.areas.sum() == pytest.approx(2 * (4 * np.pi * 0.01 - cap), rel=0.02)
    centers = np.array([[0, 0, 0], [0.1, 0, 0]])
    distance = np.linalg.norm(found.points[:, None] - centers, axis=2)
    assert distance.min() > 0.1 - 1e-4


def test_no_candidate_lies_inside_another_piece():
    pieces = blobs(8)
    found = sample(pieces, 2000, seed=0)
    depth = np.stack([clearance(found.points, piece) for piece in pieces])
    diagonal = np.linalg.norm(np.ptp(np.concatenate([piece.vertices for piece in pieces]), axis=0))
    assert depth.min() > -1e-4 * diagonal
    assert (np.abs(depth) < 1e-9).any(axis=0).all()
    union = trimesh.boolean.union([piece.mesh() for piece in pieces])
    assert found.areas.sum() == pytest.approx(union.area, rel=0.03)


def test_normals_point_out_of_the_body():
    pieces = blobs(8)
    found = sample(pieces, 500, seed=1)
    ahead = np.stack([clearance(found.points + 1e-3 * found.normals, piece) for piece in pieces]).min(0)
    behind = np.stack([clearance(found.points - 1e-4 * found.normals, piece) for piece in pieces]).min(0)
    assert (ahead > 0).mean() > 0.95
    assert (behind < 0).all()


def test_a_seed_fixes_everything_and_another_changes_it():
    one, again, other = (sample(blobs(5), 300, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.points, again.points)
    np.testing.assert_array_equal(one.normals, again.normals)
    np.testing.assert_array_equal(one.areas, again.areas)
    assert not np.array_equal(one.points, other.points)


def test_candidates_move_with_the_body():
    T = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3], [0.1, 0.2, 0.3])
    for piece in (cylinder(0.02, 0.1), sphere(0.1).transformed(T)):
        here, there = sample([piece], 200, seed=0), sample([piece.transformed(T)], 200, seed=0)
        assert there.areas == pytest.approx(here.areas)
        if piece.radius == 0:
            np.testing.assert_allclose(there.points, trimesh.transform_points(here.points, T), atol=1e-14)
            np.testing.assert_allclose(there.normals, here.normals @ T[:3, :3].T, atol=1e-12)


def test_order_is_random_so_that_a_part_stands_for_the_whole():
    found = sample([box([0.1, 0.1, 0.1])], 1000, seed=0)
    first = found.points[:500]
    np.testing.assert_allclose(first.mean(0), 0, atol=0.01)


def test_a_body_with_next_to_no_exposed_surface_is_refused(monkeypatch):
    monkeypatch.setattr(sampling, "MAX_DRAWS", 1)
    with refused(MeshError, "50 pieces"):
        sample([sphere(0.1)] * 50, 1000, seed=0)


def test_at_least_one_candidate_is_asked_for():
    with refused(MeshError, "1", "0"):
        sample([sphere(0.1)], 0, seed=0)
