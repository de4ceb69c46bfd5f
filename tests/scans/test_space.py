"""Free and unknown space of scans, against exact ray casts of the mesh."""

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.scans.space import Space
from seen import first_hits, seen

SENSORS = (0.3, -0.5, 0.8), (-0.9, 0.2, 0.4)


def truly_free(mesh: trimesh.Trimesh, origins: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points that one of the sensors sees nothing before."""
    free = np.zeros(len(points), dtype=bool)
    for origin in origins:
        distance = np.linalg.norm(points - origin, axis=1)
        free |= first_hits(mesh, origin, (points - origin) / distance[:, None])[0] > distance
    return free


@pytest.mark.parametrize(("noise_m", "views"), [(0.0, 1), (0.001, 2)])
@pytest.mark.parametrize("name", ["mug", "bowl", "bottle"])
def test_space_agrees_with_ray_casts(name: str, noise_m: float, views: int) -> None:
    mesh = EMBEDDED[name]()
    space = Space(seen(mesh, *SENSORS[:views], noise_m=noise_m))
    low, high = mesh.bounds
    points = np.random.default_rng(0).uniform(low - 0.02, high + 0.02, (1500, 3))
    depth, free = space.free_depth(points), truly_free(mesh, space.scan.origins, points)
    assert (~free & (depth > space.margin)).mean() < 0.005
    assert (free & (depth < -space.margin)).mean() < 0.05
    assert ((depth > 0) == free).mean() > 0.95


def test_depth_before_and_behind_a_sphere_is_the_distance_along_the_line_of_sight() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    space = Space(seen(ball, (0, 0, 1)))
    heights = np.array([0.1, 0.05, 0.02, -0.02, -0.2])
    line = heights[:, None] * [0, 0, 1]
    assert space.free_depth(line) == pytest.approx(heights - 0.03, abs=5e-4)


def test_space_beside_the_silhouette_and_below_the_table_is_free() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    scan = seen(ball, (0, 0, 1))
    points = np.array([[0.06, 0, 0], [0, 0, -0.05]])
    assert Space(scan).free_depth(points) == pytest.approx([0.03, -0.08], abs=0.003)
    table = np.array([0, 0, -0.03]), np.array([0, 0, 1.0])
    assert Space(scan, table).free_depth(points)[1] == pytest.approx(0.02)


def test_no_space_is_known_without_a_sensor() -> None:
    scan = seen(trimesh.creation.icosphere(subdivisions=2, radius=0.03), (0, 0, 1))
    blind = type(scan)(scan.points, scan.normals, np.zeros((0, 3)), scan.view, 0.0)
    assert np.isneginf(Space(blind).free_depth(np.eye(3))).all()
