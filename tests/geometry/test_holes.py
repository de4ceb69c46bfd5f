"""Holes of a mesh: their rims, and flat caps that close them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.holes import cap_holes, find_holes
from refusals import assert_names, refused


def without(mesh: trimesh.Trimesh, drop: np.ndarray) -> trimesh.Trimesh:
    mesh.update_faces(~drop)
    return mesh


def tube(sections: int = 24) -> trimesh.Trimesh:
    """A cylinder of radius 1 and height 2 without its top."""
    mesh = trimesh.creation.cylinder(1, 2, sections=sections)
    return without(mesh, mesh.face_normals[:, 2] > 0.9)


def pipe() -> trimesh.Trimesh:
    """A pipe, 1 inside and 2 outside, 3 long, without the ring at its top."""
    mesh = trimesh.creation.annulus(1, 2, 3, sections=24)
    return without(mesh, mesh.face_normals[:, 2] > 0.9)


def test_a_hole_says_where_it_is_and_how_wide():
    (hole,) = find_holes(tube())
    assert len(hole.rim) == 24 and hole.flat
    np.testing.assert_allclose(hole.center, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(hole.normal, [0, 0, 1], atol=1e-12)
    assert hole.width == pytest.approx(2 * np.sqrt(2))
    assert find_holes(trimesh.creation.box()) == ()


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_cap_makes_the_solid_whole(turn: float):
    mesh = tube()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 2, 3]))
    closed, what = cap_holes(mesh)
    assert closed.is_volume
    assert closed.volume == pytest.approx(trimesh.creation.cylinder(1, 2, sections=24).volume)
    # No vertex is added.
    assert len(closed.vertices) == len(mesh.vertices)
    assert_names(what, f"{find_holes(mesh)[0].width * 1e3:.3g} mm")


def test_rims_around_each_other_are_closed_with_a_ring():
    closed, what = cap_holes(pipe())
    assert closed.is_volume
    assert_names(what, "2 ", " mm")
    assert closed.volume == pytest.approx(trimesh.creation.annulus(1, 2, 3, sections=24).volume)


def test_holes_on_both_ends_are_closed_apart():
    mesh = trimesh.creation.cylinder(1, 2, sections=24)
    closed, _ = cap_holes(without(mesh, np.abs(mesh.face_normals[:, 2]) > 0.9))
    assert closed.is_volume
    assert closed.volume == pytest.approx(trimesh.creation.cylinder(1, 2, sections=24).volume)


def test_a_bent_hole_is_refused():
    ball = trimesh.creation.icosphere(2)
    # All faces around an edge of the cube that the ball could hold: the rim is bent like a saddle.
    x, y, z = ball.triangles_center.T
    drop = (np.abs(x) < 0.5) & (y > 0.2) & (np.abs(z) < 0.9)
    with refused(MeshError, " edges", " mm", "flat"):
        cap_holes(without(ball, drop))


def test_rims_that_meet_are_refused():
    box = trimesh.creation.box()
    box = without(box, np.isin(np.arange(12), np.flatnonzero(np.abs(box.face_normals[:, 2]) > 0.9)[[0, 3]]))
    two = trimesh.util.concatenate([box, box.copy().apply_translation([1, 1, 0])])
    two.merge_vertices()
    with refused(MeshError, "edges"):
        find_holes(two)


def test_bodies_on_both_sides_of_a_plane_are_closed_each():
    standing, hanging = tube(), tube()
    hanging.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0], [0, 0, 1]))
    hanging.apply_translation([5, 0, 0])
    closed, _ = cap_holes(trimesh.util.concatenate([standing, hanging]))
    assert closed.is_volume
    assert closed.volume == pytest.approx(2 * trimesh.creation.cylinder(1, 2, sections=24).volume)


def test_rims_that_cross_are_refused():
    mesh = pipe()
    inner = np.isclose(mesh.vertices[:, 2], 1.5) & (np.linalg.norm(mesh.vertices[:, :2], axis=1) < 1.5)
    mesh.vertices[inner, :2] += 0.9
    with refused(MeshError, "cross"):
        cap_holes(mesh)
