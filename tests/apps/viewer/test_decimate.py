"""Meshes with fewer triangles: how many, how far off, and whatever the mesh is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from grasp_refine_apps.viewer.decimate import decimate


def test_a_small_mesh_stays_as_it_is():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    assert decimate(mesh, len(mesh.faces)) is mesh


@pytest.mark.parametrize("most", [200, 2000, 5000])
def test_a_ball_keeps_its_shape(most: int):
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    small = decimate(mesh, most)
    assert most / 3 < len(small.faces) <= most
    # The mean of a patch lies no deeper in the ball than the middle of its longest chord.
    off = 0.05 - np.linalg.norm(small.vertices, axis=1)
    assert -1e-9 < off.min() and off.max() < small.edges_unique_length.max() ** 2 / (8 * 0.05)
    outward = np.einsum("fi,fi->f", small.face_normals, small.triangles_center) > 0
    assert outward.mean() > 0.98
    assert small.volume > 0.8 * mesh.volume


def test_open_meshes_and_several_bodies_are_fine():
    sheet = trimesh.creation.icosphere(subdivisions=4)
    sheet.update_faces(sheet.triangles_center[:, 2] > 0)
    far = sheet.copy().apply_translation([10.0, 0.0, 0.0])
    small = decimate(trimesh.util.concatenate([sheet, far]), 300)
    assert 0 < len(small.faces) <= 300
    assert (np.minimum(*(np.linalg.norm(small.vertices - [x, 0, 0], axis=1) for x in (0, 10))) < 1 + 1e-9).all()
    np.testing.assert_allclose(small.bounds, [[-1, -1, 0], [11, 1, 1]], atol=0.2)


def test_no_triangle_is_there_twice_and_none_is_a_line():
    mesh = trimesh.creation.torus(1.0, 0.02, major_sections=300, minor_sections=20)
    small = decimate(mesh, 1000)
    corners = np.sort(small.faces, axis=1)
    assert len(np.unique(corners, axis=0)) == len(corners)
    assert (np.diff(corners, axis=1) > 0).all()
