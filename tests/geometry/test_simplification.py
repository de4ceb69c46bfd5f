"""Meshes with fewer triangles, within a distance."""

import numpy as np
import trimesh

from grasp_refine.geometry.simplification import simplify


def test_a_finely_meshed_box_needs_twelve_triangles() -> None:
    fine = trimesh.creation.box([1, 1, 1]).subdivide().subdivide()
    vertices, faces = simplify(fine.vertices, fine.faces, 1e-3)
    assert len(faces) == 12
    np.testing.assert_allclose(np.ptp(vertices, axis=0), 1.0, atol=1e-3)


def test_an_open_mesh_is_unchanged() -> None:
    fine = trimesh.creation.box([1, 1, 1]).subdivide()
    vertices, faces = simplify(fine.vertices, fine.faces[1:], 1e-3)
    assert len(vertices) == len(fine.vertices) and len(faces) == len(fine.faces) - 1
