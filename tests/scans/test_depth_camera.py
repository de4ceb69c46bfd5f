"""Depth pictures: rays against trimesh, frames, noise against its source, and back to points on the surface."""

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import inverse, is_rigid, transform_points
from grasp_refine.scans.depth_camera import (
    D435,
    MASK_PX,
    Intrinsics,
    depth_noise,
    depth_of,
    scan_of_depth,
    views_around,
    with_mask_errors,
    with_noise,
)

CAMERA = Intrinsics(200.0, 220.0, 100.3, 70.1, 210, 150)
BALL_M = 0.04


def bracket() -> trimesh.Trimesh:
    """A concave object without symmetry, off the origin."""
    parts = [trimesh.creation.box([0.10, 0.03, 0.02]), trimesh.creation.box([0.02, 0.05, 0.08])]
    parts[1].apply_translation([0.05, 0.02, 0.03])
    return trimesh.util.concatenate(parts).apply_translation([0.3, -0.1, 0.2])


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=5, radius=BALL_M)


@pytest.fixture(scope="module")
def ball_views():
    poses = views_around(ball(), 2, seed=3)
    return poses, [depth_of(ball(), pose) for pose in poses]


def wall(angle: float, distance: float = 0.5) -> np.ndarray:
    """Depth of a wall that is turned by `angle` about the vertical, as the camera sees it."""
    u = (np.arange(D435.width) - D435.cx) / D435.fx
    depth = distance / (1.0 + np.tan(angle) * u)
    return np.broadcast_to(np.where((depth > 0.1) & (depth < 3), depth, 0.0), (D435.height, D435.width))


def test_each_pixel_has_the_depth_of_its_ray():
    mesh = bracket()
    (pose,) = views_around(mesh, 1, seed=1, intrinsics=CAMERA)
    depth = depth_of(mesh, pose, CAMERA)
    row, column = np.indices(depth.shape).reshape(2, -1)
    sight = np.stack([(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, np.ones(len(row))], axis=-1)
    points, ray, _ = mesh.ray.intersects_location(
        np.broadcast_to(pose[:3, 3], sight.shape), sight @ pose[:3, :3].T, multiple_hits=False
    )
    expected = np.zeros(len(row))
    expected[ray] = transform_points(inverse(pose), points)[:, 2]
    off = np.abs(depth.ravel() - expected)
    assert np.count_nonzero(depth) > 300
    # A ray through an edge may hit either side.
    assert (off < 1e-9).mean() > 0.999


def test_cameras_look_at_the_object_from_above_and_see_it_whole():
    mesh = bracket()
    poses = views_around(mesh, 4, seed=5)
    assert is_rigid(poses).all()
    seen = transform_points(inverse(poses)[:, None], mesh.bounds.mean(axis=0))
    np.testing.assert_allclose(seen[..., :2], 0, atol=1e-12)
    # World z is up in the picture, where y is down.
    assert (poses[:, 2, 1] < 0).all() and np.allclose(poses[:, 2, 0], 0)
    assert (poses[:, 2, 3] > mesh.bounds[1, 2]).all()
    big = mesh.copy().apply_scale(20)
    for pose in views_around(big, 2, seed=5):
        depth = depth_of(big, pose)
        border = np.concatenate([depth[0], depth[-1], depth[:, 0], depth[:, -1]])
        assert not border.any() and depth.any()
    around = np.arctan2(*(poses[:, :2, 3] - mesh.bounds.mean(axis=0)[:2]).T[::-1])
    np.testing.assert_allclose(np.diff(np.unwrap(around)), np.pi / 2)


def test_a_mesh_behind_the_camera_is_refused():
    with pytest.raises(MeshError):
        depth_of(ball(), np.eye(4))


def test_noise_is_that_of_its_source():
    """Intel's white paper: the depth is off by z^2 s / (f b); a millimetre at half a metre."""
    assert depth_noise(np.array(0.5)) == pytest.approx(0.25 * 0.08 / (424 * 0.05))
    for distance in (0.3, 0.5, 1.0):
        exact = wall(0.0, distance)
        noisy = with_noise(exact, seed=0)
        assert (noisy > 0).all()
        assert np.std(noisy - exact) == pytest.approx(float(depth_noise(np.array(distance))), rel=0.05)
    off = noisy - exact
    neighbours = np.corrcoef(off[:, :-1].ravel(), off[:, 1:].ravel())[0, 1]
    assert 0.7 < neighbours < 1.0


def test_grazing_surfaces_are_missing():
    facing, grazing = (with_noise(wall(np.radians(angle)), 0)[240, 424] for angle in (60, 85))
    assert facing > 0 and grazing == 0


def test_edges_have_holes_and_points_behind_the_surface(ball_views):
    _, (depth, _) = ball_views
    noisy = with_noise(depth, seed=1)
    seen = (depth > 0) & (noisy > 0)
    lost = (depth > 0) & (noisy == 0)
    assert 0.01 < lost.sum() / (depth > 0).sum() < 0.2
    assert (noisy[seen] - depth[seen] > 0.01).any()
    np.testing.assert_array_equal(noisy, with_noise(depth, seed=1))
    assert (noisy != with_noise(depth, seed=2)).any()


def test_masks_are_off_at_their_borders_only():
    from scipy import ndimage

    mask = np.zeros((400, 400), dtype=bool)
    mask[100:300, 100:300] = True
    wrong = with_mask_errors(mask, seed=0) != mask
    distance = np.where(mask, ndimage.distance_transform_edt(mask), ndimage.distance_transform_edt(~mask)) - 0.5
    assert wrong.any() and distance[wrong].max() < 5 * MASK_PX
    # The mean of |error| over the border's length, of a normal error.
    assert wrong.sum() / 800 == pytest.approx(MASK_PX * np.sqrt(2 / np.pi), rel=0.3)


def test_exact_pictures_give_points_and_normals_of_the_ball(ball_views):
    poses, depths = ball_views
    scan = scan_of_depth(depths, None, D435, list(poses))
    radius = np.linalg.norm(scan.points, axis=1)
    np.testing.assert_allclose(radius, BALL_M, atol=5e-5)
    assert ((scan.points / radius[:, None] * scan.normals).sum(axis=1) > np.cos(np.radians(5))).mean() > 0.95
    np.testing.assert_allclose(scan.origins, poses[:, :3, 3])
    for at in range(2):
        sight = scan.origins[at] - scan.points[scan.view == at]
        # What a camera sees faces it.
        assert ((scan.points[scan.view == at] * sight).sum(axis=1) > 0).all()


def test_noisy_pictures_give_points_within_the_noise(ball_views):
    poses, depths = ball_views
    pictures = [with_noise(depth, seed) for seed, depth in enumerate(depths)]
    masks = [with_mask_errors(depth > 0, seed) for seed, depth in enumerate(depths)]
    scan = scan_of_depth(pictures, masks, D435, list(poses))
    off = np.linalg.norm(scan.points, axis=1) - BALL_M
    assert np.std(off) < 1.3 * scan.noise_m
    assert (np.abs(off) < 4 * scan.noise_m).mean() > 0.99
    angle = np.degrees(np.arccos((scan.points * scan.normals).sum(axis=1) / np.linalg.norm(scan.points, axis=1)))
    assert np.median(angle) < 10
