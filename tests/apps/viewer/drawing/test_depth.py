"""Depth of surfaces in bodies: closed forms of balls and boxes, and bounds for all other points."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box, capsule, sphere
from grasp_refine_apps.viewer.drawing.depth import EDGE_M, DepthField, depth_patch
from grasp_refine_apps.viewer.drawing.shapes import Shape

RADIUS = 0.02


def body(*pieces: object) -> Body:
    return build_body("thing", pieces, candidates=32)


def shape(mesh: trimesh.Trimesh) -> Shape:
    return Shape(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), (0, 0, 0), "link")


def test_depth_in_a_ball_a_capsule_and_a_box():
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (200, 3))
    np.testing.assert_allclose(DepthField.of(body(sphere(RADIUS)))(points), RADIUS - np.linalg.norm(points, axis=1))
    along = np.clip(points[:, 2], -0.01, 0.01)
    core = np.stack([0 * along, 0 * along, along], axis=1)
    found = DepthField.of(body(capsule(RADIUS, (0, 0, -0.01), (0, 0, 0.01))))(points)
    np.testing.assert_allclose(found, RADIUS - np.linalg.norm(points - core, axis=1), atol=1e-12)
    half = np.array([0.01, 0.02, 0.03])
    from_faces = (half - np.abs(points)).min(axis=1)
    np.testing.assert_allclose(DepthField.of(body(box(2 * half)))(points), from_faces, atol=1e-12)
    # A box with rounded edges reaches as far beyond its core as its radius.
    rounded = replace(box(2 * half - 0.01), radius=0.005)
    inside = from_faces > 0
    np.testing.assert_allclose(DepthField.of(body(rounded))(points[inside]), from_faces[inside], atol=1e-12)


def test_depth_in_two_pieces_is_that_in_the_deeper_one():
    both = body(sphere(RADIUS), sphere(RADIUS, (0.03, 0.0, 0.0)))
    assert DepthField.of(both)(np.array([[0.03, 0.0, 0.0]]))[0] == pytest.approx(RADIUS)


def test_cuts_between_pieces_are_no_surface():
    half = np.array([0.01, 0.02, 0.03])
    left = box((half[0], 2 * half[1], 2 * half[2]))
    T = np.eye(4)
    T[0, 3] = half[0] / 2
    right = left.transformed(T)
    T[0, 3] = -half[0] / 2
    points = np.random.default_rng(1).uniform(-half, half, (200, 3))
    found = DepthField.of(body(left.transformed(T), right))(points)
    # Within a piece, planes of the other one are not looked at.
    np.testing.assert_allclose(found, (half - np.abs(points)).min(axis=1), atol=1e-12)


@pytest.mark.parametrize("sunk", [0.0005, 0.004])
def test_a_ball_in_a_plate_is_coloured_where_it_is_inside_and_as_deep(sunk: float):
    plate, T = DepthField.of(body(box((0.2, 0.2, 0.1)))), exp_se3(np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.9]))
    T[:3, 3] = 0.01, 0.02, 0.05 + RADIUS - sunk
    patch = depth_patch(shape(trimesh.creation.icosphere(4, RADIUS)), T, plate)
    assert patch is not None
    world = transform_points(T, patch.vertices.astype(float))
    np.testing.assert_allclose(patch.depth, 0.05 - world[:, 2], atol=5e-5)
    assert patch.depth.max() == pytest.approx(sunk, abs=2e-4)
    # All of the cap, whose area is 2 pi r h.
    mesh = trimesh.Trimesh(patch.vertices, patch.faces, process=False)
    assert mesh.area == pytest.approx(2 * np.pi * RADIUS * sunk, rel=0.1)
    assert mesh.edges_unique_length.max() < EDGE_M * 1.3


def test_a_large_triangle_is_coloured_between_its_corners():
    ball = DepthField.of(body(sphere(RADIUS)))
    wide = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [0, 2, 0]], [[0, 1, 2]])
    patch = depth_patch(shape(wide), exp_se3(np.array([0.0, 0.0, 0.015, 0.0, 0.0, 0.0])), ball)
    assert patch is not None and patch.depth.max() == pytest.approx(0.005, abs=1e-4)
    assert np.linalg.norm(patch.vertices, axis=1).max() == pytest.approx(np.sqrt(RADIUS**2 - 0.015**2), abs=2e-4)


def test_what_is_apart_has_no_patch():
    away = exp_se3(np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]))
    assert depth_patch(shape(trimesh.creation.icosphere(2, RADIUS)), away, DepthField.of(body(sphere(RADIUS)))) is None
