"""Meshes with fewer triangles, within a distance."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Int


def simplify(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a mesh with fewer triangles, at most `tolerance` from a given mesh.

    A mesh that is not a closed manifold is returned unchanged.
    """
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.uint64))
    )
    simpler = solid.simplify(tolerance).to_mesh64()
    if solid.status() != manifold3d.Error.NoError or len(simpler.tri_verts) < 4:
        return vertices, faces
    return simpler.vert_properties[:, :3], simpler.tri_verts.astype(np.int64)
