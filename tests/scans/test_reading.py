"""Files of points, depth, cameras and poses, written here by their specifications; and refusals by name."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.core.se3 import exp_se3, inverse
from grasp_refine.scans import cloud
from grasp_refine.scans.camera_files import as_intrinsics, as_poses, as_positions
from grasp_refine.scans.depth_camera import Intrinsics, depth_of, views_around
from grasp_refine.scans.pcd import read_pcd
from grasp_refine.scans.reading import Sensors, is_scan, read_scan, scan_of_mesh
from refusals import refused
from scan_files import FILES, RADIUS_M, dome, npz, pcd, ply, text

VIEW = Sensors(seen_from=(0, 0, 0.5))
LENS = Intrinsics(300.0, 310.0, 79.5, 60.2, 160, 120)


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_points_and_normals_are_those_of_the_file(name, normals, tmp_path):
    points = dome()
    path = tmp_path / name
    path.write_bytes(FILES[name](points, normals))
    assert is_scan(path)
    scan, notes = read_scan(path, VIEW)
    assert not notes
    np.testing.assert_allclose(scan.points, points, atol=1e-9)
    np.testing.assert_array_equal(scan.origins, [[0, 0, 0.5]])
    if normals:
        facing = ((scan.origins[0] - points) * points).sum(axis=1) > 0
        np.testing.assert_allclose(scan.normals[facing], points[facing] / RADIUS_M, atol=1e-6)
        # They need no sensor.
        np.testing.assert_allclose(read_scan(path, Sensors())[0].normals, points / RADIUS_M, atol=1e-6)
    else:
        with refused(MeshError, name, "sensor"):
            read_scan(path, Sensors())


def test_compressed_points_that_repeat_are_unpacked(tmp_path):
    points = np.repeat(dome(100), 8, axis=0) + np.tile([0, 0, 2**-10], (800, 1))
    points = points.astype(np.float32).astype(float)
    (tmp_path / "packed.pcd").write_bytes(pcd(points, "binary_compressed"))
    np.testing.assert_array_equal(read_pcd(tmp_path / "packed.pcd").points, points)


def test_clouds_of_trimesh_are_read(tmp_path):
    path = tmp_path / "cloud.ply"
    trimesh.PointCloud(dome()).export(path)
    np.testing.assert_allclose(read_scan(path, VIEW)[0].points, dome(), atol=1e-7)
    mesh = tmp_path / "mesh.ply"
    trimesh.creation.box([0.1, 0.1, 0.1]).export(mesh)
    assert not is_scan(mesh)


def test_a_viewpoint_of_a_pcd_file_is_the_sensor(tmp_path):
    path = tmp_path / "seen.pcd"
    path.write_bytes(pcd(dome(), "binary", viewpoint="0.1 0 0.4"))
    scan, _ = read_scan(path, Sensors())
    np.testing.assert_allclose(scan.origins, [[0.1, 0, 0.4]])
    # Another position counts before that of the file; and the viewpoint has the unit of the points.
    np.testing.assert_allclose(read_scan(path, VIEW)[0].origins, [[0, 0, 0.5]])
    path.write_bytes(pcd(1e3 * dome(), "binary", viewpoint="100 0 400"))
    np.testing.assert_allclose(read_scan(path, Sensors(), unit="mm")[0].origins, [[0.1, 0, 0.4]])


def test_a_camera_takes_its_points_to_the_object(tmp_path):
    pose = exp_se3(np.array([0.1, -0.2, 0.6, 0.3, 2.0, -0.4]))
    path = tmp_path / "camera.ply"
    points = dome()
    seen = (points - pose[:3, 3]) @ pose[:3, :3]
    trimesh.PointCloud(seen).export(path)
    scan, _ = read_scan(path, Sensors(camera=pose))
    np.testing.assert_allclose(scan.points, points, atol=1e-6)
    np.testing.assert_allclose(scan.origins, pose[None, :3, 3])
    np.testing.assert_allclose(inverse(pose)[:3, :3] @ pose[:3, :3], np.eye(3), atol=1e-12)
    np.savez(tmp_path / "turned.npz", points=seen, normals=points @ pose[:3, :3])
    turned, _ = read_scan(tmp_path / "turned.npz", Sensors(camera=pose))
    facing = ((pose[:3, 3] - points) * points).sum(axis=1) > 0
    np.testing.assert_allclose(turned.normals[facing], points[facing] / RADIUS_M, atol=1e-6)
    with refused(GraspRefineError, "camera", "seen_from"):
        read_scan(path, Sensors(camera=pose, seen_from=(0, 0, 1)))


def test_units_are_asked_about(tmp_path):
    path = tmp_path / "millimetres.xyz"
    path.write_bytes(text(1e3 * dome(), " ", False))
    with refused(MeshError, "millimetres.xyz", "unit='mm'"):
        read_scan(path, Sensors(seen_from=(0, 0, 500)))
    np.testing.assert_allclose(read_scan(path, VIEW, unit="mm")[0].points, dome(), atol=1e-7)
    np.testing.assert_allclose(read_scan(path, VIEW, scale=0.001)[0].points, dome(), atol=1e-7)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.xyz", b"", "empty"),
        ("one.xyz", b"0 0 0\n", "1 point"),
        ("words.xyz", b"0 0 0\na b c\n", "cannot be read"),
        ("short.xyz", b"0 0\n" * 50, "cannot be read"),
        ("nothing.npz", npz(np.zeros((0, 3)), False), "empty"),
        ("lie.ply", ply(dome(50), "binary_little_endian", count=51), "cut off"),
        ("large.ply", ply(dome(50), "binary_little_endian", count=10**15), str(cloud.MAX_READ_POINTS)),
        ("many.ply", ply(dome(50), "ascii", count=1000), "cut off"),
        ("lie.pcd", pcd(dome(50), "binary", count=51), "cut off"),
        ("large.pcd", pcd(dome(50), "ascii", count=10**15), str(cloud.MAX_READ_POINTS)),
        ("packed.pcd", pcd(dome(50), "binary_compressed", count=51), "cut off"),
        ("damaged.pcd", pcd(dome(50), "binary_compressed")[:-9] + b"\xff" * 9, "damaged"),
        ("other.pcd", pcd(dome(50), "binary_compressed").replace(b"x y z", b"x y q"), "no z"),
        ("header.pcd", b"FIELDS x y z\nDATA ascii\n", "header"),
        ("noise.pcd", bytes(range(256)) * 40, "header"),
        ("noise.npy", bytes(range(256)) * 40, "cannot be read"),
        ("noise.png", bytes(range(256)) * 40, "cannot be read"),
        ("eight.png", None, "16-bit"),
    ],
)
def test_damaged_files_are_refused_by_name(name, content, words, tmp_path):
    path = tmp_path / name
    if content is None:
        Image.fromarray(np.full((120, 160), 9, np.uint8)).save(path)
    else:
        path.write_bytes(content)
    with refused(MeshError, name, words):
        read_scan(path, Sensors(intrinsics="1,1,1,1") if name.endswith((".png", ".npy")) else VIEW)


def test_of_a_large_file_some_points_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(cloud, "MAX_KEPT_POINTS", 1000)
    points = dome(5000)
    for name, make in FILES.items():
        path = tmp_path / name
        path.write_bytes(make(points, False))
        scan, notes = read_scan(path, VIEW)
        np.testing.assert_allclose(scan.points, points[::5], atol=1e-9)
        assert "5000" in notes[0]


# Depth pictures


@pytest.fixture(scope="module")
def pictures():
    """A ball off the origin, seen twice, in millimetres."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M).apply_translation([0.2, 0.1, -0.1])
    poses = views_around(ball, 2, seed=0, intrinsics=LENS)
    return poses, np.stack([np.round(depth_of(ball, pose, LENS) * 1e3).astype(np.uint16) for pose in poses])


def from_middle(scan) -> np.ndarray:
    return np.linalg.norm(scan.points - [0.2, 0.1, -0.1], axis=1)


def test_depth_pictures_are_millimetres_in_the_frame_of_the_pose(pictures, tmp_path):
    poses, depths = pictures
    path, camera = tmp_path / "depth.png", tmp_path / "pose.npy"
    Image.fromarray(depths[0]).save(path)
    np.save(camera, poses[0])
    lens = f"{LENS.fx},{LENS.fy},{LENS.cx},{LENS.cy}"
    scan, _ = read_scan(path, Sensors(intrinsics=lens, camera=str(camera)))
    assert np.abs(from_middle(scan) - RADIUS_M).max() < 2e-3 and np.abs(from_middle(scan) - RADIUS_M).mean() < 4e-4
    np.testing.assert_allclose(scan.origins, poses[:1, :3, 3])
    # Without a pose the frame is the camera's.
    own, _ = read_scan(path, Sensors(intrinsics=LENS))
    np.testing.assert_allclose(own.points @ poses[0, :3, :3].T + poses[0, :3, 3], scan.points, atol=1e-9)
    # Steps of a quarter of a millimetre, and floats in metres.
    Image.fromarray(4 * depths[0]).save(path)
    np.testing.assert_allclose(read_scan(path, Sensors(intrinsics=LENS), scale=0.25)[0].points, own.points, atol=1e-12)
    np.save(tmp_path / "depth.npy", depths[0] / 1e3)
    np.testing.assert_allclose(
        read_scan(tmp_path / "depth.npy", Sensors(intrinsics=LENS))[0].points, own.points, atol=1e-12
    )
    with refused(MeshError, "depth.png", "unit='mm'"):
        read_scan(path, Sensors(intrinsics=LENS), unit="mm")
    np.save(tmp_path / "wrong.npy", depths[0].astype(float))
    with refused(MeshError, "wrong.npy", "unit='mm'"):
        read_scan(tmp_path / "wrong.npy", Sensors(intrinsics=LENS))
    with refused(GraspRefineError, "depth.png", "intrinsics"):
        read_scan(path, Sensors())


def test_masks_cut_out_the_object(pictures, tmp_path):
    poses, depths = pictures
    table = np.where(depths[0] == 0, 700, depths[0]).astype(np.uint16)
    path, mask = tmp_path / "depth.png", tmp_path / "mask.png"
    Image.fromarray(table).save(path)
    Image.fromarray(((depths[0] > 0) * 255).astype(np.uint8)).save(mask)
    scan, _ = read_scan(path, Sensors(intrinsics=LENS, camera=poses[0], mask=str(mask)))
    assert np.abs(from_middle(scan) - RADIUS_M).max() < 2e-3
    np.savez(tmp_path / "channel.npz", depth=table[..., None], mask=depths[0][..., None] > 0)
    again, _ = read_scan(tmp_path / "channel.npz", Sensors(intrinsics=LENS, camera=poses[0]))
    np.testing.assert_array_equal(again.points, scan.points)
    with refused(MeshError, "shape"):
        read_scan(path, Sensors(intrinsics=LENS, mask=np.ones((3, 3))))
    with refused(MeshError, "mask", "empty"):
        read_scan(path, Sensors(intrinsics=LENS, mask=np.zeros(table.shape)))
    with refused(GraspRefineError, "mask", "none.png"):
        read_scan(path, Sensors(intrinsics=LENS, mask="none.png"))


def test_several_views_are_one_file(pictures, tmp_path):
    poses, depths = pictures
    path = tmp_path / "views.npz"
    matrix = [[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1]]
    np.savez(path, depth=depths, mask=depths > 0, intrinsics=matrix, camera=poses)
    scan, _ = read_scan(path, Sensors())
    assert np.abs(from_middle(scan) - RADIUS_M).max() < 2e-3
    np.testing.assert_allclose(scan.origins, poses[:, :3, 3])
    for at in range(2):
        sight = scan.origins[at] - scan.points[scan.view == at]
        assert ((scan.points[scan.view == at] - [0.2, 0.1, -0.1]) * sight).sum(axis=1).min() > 0
    with refused(GraspRefineError, "2 pictures", "1 poses"):
        read_scan(path, Sensors(camera=poses[:1]))


def test_intrinsics_are_read_as_cameras_write_them(tmp_path):
    fx, fy, cx, cy = 600.0, 610.0, 320.5, 240.25
    K = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    files = {
        "realsense.json": json.dumps({"width": 640, "fx": fx, "fy": fy, "ppx": cx, "ppy": cy}),
        "open3d.json": json.dumps({"intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1]}),
        "ros1.yaml": f"image_width: 640\nK: {K}\n",
        "ros2.yaml": f"k: {K}\n",
        "calibration.yaml": f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {K}\n",
        "matrix.txt": f"{fx} 0 {cx}\n0 {fy} {cy}\n0 0 1\n",
        "four.txt": f"{fx} {fy} {cx} {cy}\n",
        "autolab.intr": json.dumps({"_fx": fx, "_fy": fy, "_cx": cx, "_cy": cy, "_frame": "overhead"}),
        "bop.json": json.dumps({"cam_K": K, "depth_scale": 1.0}),
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content)
        np.testing.assert_array_equal(as_intrinsics(tmp_path / name), [fx, fy, cx, cy], err_msg=name)
    for value in (f"{fx},{fy},{cx},{cy}", np.array(K), Intrinsics(fx, fy, cx, cy, 640, 480)):
        np.testing.assert_array_equal(as_intrinsics(value), [fx, fy, cx, cy])
    (tmp_path / "odd.yaml").write_text("k: &a [*a]\n")
    # A billion numbers by aliases.
    lists = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}' if k else '1'] * 10)}]\n" for k in range(9))
    (tmp_path / "bomb.yaml").write_text(f"{lists}k: *a8\n")
    for wrong in (
        "600,600,320",
        "none.json",
        tmp_path / "odd.yaml",
        tmp_path / "bomb.yaml",
        tmp_path / "cut.mat",
        [1, 2],
        "0,600,320,240",
    ):
        with refused(GraspRefineError, "intrinsics"):
            as_intrinsics(wrong)


def test_poses_and_positions_are_read(tmp_path):
    pose = exp_se3(np.array([0.1, -0.2, 0.6, 0.3, 2.0, -0.4]))
    (tmp_path / "pose.txt").write_text("\n".join(" ".join(map(repr, row)) for row in pose.tolist()))
    (tmp_path / "poses.json").write_text(json.dumps([pose.tolist(), np.eye(4).tolist()]))
    np.testing.assert_array_equal(as_poses(tmp_path / "pose.txt"), pose[None])
    np.testing.assert_array_equal(as_poses(str(tmp_path / "poses.json")), [pose, np.eye(4)])
    looking_down = as_poses("0,0,0.5,180,0,0")[0]
    np.testing.assert_allclose(looking_down[:3, 2], [0, 0, -1], atol=1e-12)
    for wrong in (2 * np.eye(4), np.eye(3), "none.npy", "a,b,c"):
        with refused(GraspRefineError, "camera"):
            as_poses(wrong)
    np.testing.assert_array_equal(as_positions("0,0,0.5"), [[0, 0, 0.5]])
    np.testing.assert_array_equal(as_positions(("0,0,0.5", "1,0,0")), [[0, 0, 0.5], [1, 0, 0]])
    np.testing.assert_array_equal(as_positions([0, 0, 0.5]), [[0, 0, 0.5]])
    for wrong in ("0,0", "a,b,c", [0, 0, np.nan], []):
        with refused(GraspRefineError, "seen_from"):
            as_positions(wrong)


def test_open_meshes_become_points_on_their_faces():
    whole = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    upper = whole.submesh([np.flatnonzero(whole.triangles_center[:, 2] > 0)], append=True)
    scan, _ = scan_of_mesh(upper, VIEW, "shell")
    assert len(scan.points) > 5000 and scan.noise_m == 0
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), RADIUS_M, rtol=0.01)
    facing = ((VIEW.seen_from - scan.points) * scan.points).sum(axis=1) > 0.1 * RADIUS_M * 0.5
    assert (scan.points * scan.normals).sum(axis=1)[facing].min() > 0.98 * RADIUS_M
    # Equal heights of a sphere have equal areas.
    assert (scan.points[:, 2] > RADIUS_M / 2).mean() == pytest.approx(0.5, abs=0.05)
