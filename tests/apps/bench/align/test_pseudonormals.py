"""Normals at points of bodies: of faces, and inside the normal cones of edges and vertices."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.geometry.pieces import box, capsule, cylinder, hull, sphere
from grasp_refine_apps.bench.align.pseudonormals import pseudonormals


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def test_a_box_has_the_normals_of_its_symmetry_however_its_faces_are_cut():
    piece = box([0.1, 0.04, 0.06])
    points = np.array([[0.01, 0.005, 0.03], [0.0, 0.0, 0.03], [0.01, 0.02, 0.03]])
    np.testing.assert_allclose(
        pseudonormals([piece], points), [unit(0, 0, 1), unit(0, 0, 1), unit(0, 1, 1)], atol=1e-12
    )
    np.testing.assert_allclose(
        pseudonormals([piece], piece.vertices), np.sign(piece.vertices) / np.sqrt(3.0), atol=1e-12
    )


def test_faces_count_by_their_angle_and_not_by_their_triangles():
    sides = 12
    piece = cylinder(0.02, 0.05, sides=sides)
    radial = piece.vertices * [1, 1, 0] / 0.02
    total = 2 * (np.pi / 2) * np.cos(np.pi / sides) * radial
    total[:, 2] = np.pi * (1 - 2 / sides) * np.sign(piece.vertices[:, 2])
    expected = total / np.linalg.norm(total, axis=1, keepdims=True)
    np.testing.assert_allclose(pseudonormals([piece], piece.vertices), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_at_a_vertex_the_normal_is_inside_its_cone(seed: int):
    """Hulls of long and of dense clouds, most vertices of which are nearly flat or in slivers."""
    directions = np.random.default_rng(seed).normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    piece = hull(directions * [0.01, 0.02, 0.1])
    normals = pseudonormals([piece], piece.vertices)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)
    height = normals @ piece.vertices.T
    at = np.arange(len(height))
    own = height[at, at].copy()
    height[at, at] = -np.inf
    assert (height.max(axis=1) < own - 1e-7).all()


def test_along_an_edge_the_normal_is_midway_between_its_faces():
    piece = hull(np.random.default_rng(5).normal(size=(20, 3)) * 0.03)
    edges = {tuple(sorted((face[k], face[k - 1]))) for face in piece.faces.tolist() for k in range(3)}
    for first, second in edges:
        (sides,) = np.nonzero(np.isin(piece.faces, (first, second)).sum(axis=1) == 2)
        point = 0.3 * piece.vertices[first] + 0.7 * piece.vertices[second]
        np.testing.assert_allclose(
            pseudonormals([piece], point[None]), [unit(*piece.normals[sides].sum(axis=0))], atol=1e-9
        )


def test_round_pieces_have_radial_normals():
    ball, rod = sphere(0.02, [0.1, 0.0, 0.0]), capsule(0.01, [0.0, 0.0, 0.0], [0.0, 0.0, 0.1])
    np.testing.assert_allclose(pseudonormals([ball], np.array([[0.1, 0.02, 0.0]])), [[0, 1, 0]], atol=1e-12)
    ends = np.array([[0.01, 0.0, 0.03], [0.0, 0.006, 0.108]])
    np.testing.assert_allclose(pseudonormals([rod], ends), [[1, 0, 0], unit(0, 0.6, 0.8)], atol=1e-12)


def test_of_several_pieces_the_nearest_surface_counts():
    here, there = box([0.02] * 3), sphere(0.01, [0.05, 0.0, 0.0])
    points = np.array([[0.01, 0.0, 0.0], [0.04, 0.0, 0.0]])
    np.testing.assert_allclose(pseudonormals([here, there], points), [[1, 0, 0], [-1, 0, 0]], atol=1e-12)
