"""The plane around an object in depth pictures, on which it stands."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.scans.depth_camera import D435, depth_of, points_of_depth, with_noise
from grasp_refine.scans.reading import Sensors, read_scan
from grasp_refine.scans.scan import Plane
from grasp_refine.scans.support import support_plane

SIZE_M = 0.06


def camera(elevation_deg: float, distance: float = 0.6) -> np.ndarray:
    """Pose (4, 4) of a camera that looks at the origin from the side of +x and from above."""
    angle = np.radians(elevation_deg)
    z = -np.array([np.cos(angle), 0.0, np.sin(angle)])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.array([0.0, 1.0, 0.0]), np.cross(z, [0.0, 1.0, 0.0]), z], axis=1)
    pose[:3, 3] = -distance * z
    return pose


def found(table: trimesh.Trimesh | None, elevation_deg: float, seed: int | None = None) -> Plane | None:
    """The plane around a box of 6 cm at the origin, before a table."""
    box, pose = trimesh.creation.box([SIZE_M] * 3), camera(elevation_deg)
    mask = depth_of(box, pose) > 0
    depth = depth_of(box if table is None else trimesh.util.concatenate([box, table]), pose)
    depth = depth if seed is None else with_noise(depth, seed)
    points = points_of_depth(depth, mask, D435, pose)
    return support_plane([depth], [mask], D435, [pose], points, 0.0 if seed is None else 0.0015)


def floor(height: float, side: float = 1.0) -> trimesh.Trimesh:
    """A plate whose top is at some height."""
    return trimesh.creation.box([side, side, 0.01]).apply_translation([0.0, 0.0, height - 0.005])


@pytest.mark.parametrize("elevation_deg", [30.0, 60.0, 89.0])
@pytest.mark.parametrize("seed", [None, 0])
def test_the_table_below_is_found(elevation_deg: float, seed: int | None):
    plane = found(floor(-SIZE_M / 2), elevation_deg, seed)
    assert plane is not None
    point, normal = plane
    assert normal[2] > np.cos(np.radians(1.0))
    assert point[2] - (normal[:2] @ point[:2]) / normal[2] == pytest.approx(-SIZE_M / 2, abs=0.002)


def test_planes_that_do_not_carry_it_are_none():
    assert found(None, 60.0) is None
    assert found(floor(-0.3), 60.0) is None, "far below"
    rims = [floor(0.02, 0.1).apply_translation([x, y, 0.0]) for x in (-0.1, 0, 0.1) for y in (-0.1, 0, 0.1) if x or y]
    assert found(trimesh.util.concatenate(rims), 60.0) is None, "rim of the bin that it is in"
    steps = trimesh.util.concatenate([floor(-0.03 - 0.03 * k, 0.08 + 0.06 * k) for k in range(5)])
    assert found(steps, 89.0) is None, "many levels"


def test_the_plane_moves_with_the_camera():
    T = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, 1.0, -0.6]))
    box, table, pose = trimesh.creation.box([SIZE_M] * 3), floor(-SIZE_M / 2), camera(50.0)
    depth, mask = depth_of(trimesh.util.concatenate([box, table]), pose), depth_of(box, pose) > 0
    here, there = (
        support_plane([depth], [mask], D435, [at], points_of_depth(depth, mask, D435, at), 0.0)
        for at in (pose, T @ pose)
    )
    assert here is not None and there is not None
    np.testing.assert_allclose(there[0], transform_points(T, here[0]), atol=1e-9)
    np.testing.assert_allclose(there[1], T[:3, :3] @ here[1], atol=1e-6)


def test_scans_of_masked_pictures_know_their_table(tmp_path: Path):
    box, pose = trimesh.creation.box([SIZE_M] * 3), camera(50.0)
    mask = depth_of(box, pose) > 0
    lens = {"intrinsics": [D435.fx, D435.fy, D435.cx, D435.cy], "camera": pose}
    tables = []
    for scene in (trimesh.util.concatenate([box, floor(-SIZE_M / 2)]), box):
        np.savez(tmp_path / "depth.npz", depth=depth_of(scene, pose), mask=mask, **lens)
        scan, notes = read_scan(tmp_path / "depth.npz", Sensors())
        tables.append(scan.table)
        assert any("60 mm" in note for note in notes) == (scan.table is not None)
    assert tables[0] is not None and tables[1] is None
