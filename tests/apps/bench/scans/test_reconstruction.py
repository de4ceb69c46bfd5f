"""Plain reconstruction of scans."""

import numpy as np
import trimesh

from grasp_refine_apps.bench.scans.reconstruction import reconstruct
from seen import seen


def test_a_sphere_seen_all_around_is_recovered() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    (piece,) = reconstruct(seen(ball, *corners, noise_m=0.0005, rays=40))
    radii = np.linalg.norm(piece.vertices, axis=1)
    assert abs(radii - 0.03).max() < 0.003
