"""Scanned objects: from files, open meshes and memory, with hypotheses of ours or of other programs."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.geometry.mesh import MAX_OPEN_SHARE, open_share
from grasp_refine.scans.depth_camera import D435, depth_of, scan_of_depth, views_around, with_noise
from refusals import refused

SIZE_M = (0.04, 0.06, 0.08)
CORNER_VIEW = (0.4, 0.5, 0.4)


def cloud(count: int = 1200) -> np.ndarray:
    """Points on the three sides of a box that a sensor before its corner sees."""
    at = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))
    at[np.arange(count), np.arange(count) % 3] = 0.5
    return at * SIZE_M


def half_box() -> trimesh.Trimesh:
    """Mesh of these sides."""
    box = trimesh.creation.box(SIZE_M)
    return box.submesh([np.flatnonzero(box.face_normals.sum(axis=1) > 0)], append=True)


def is_box(obj: gr.Object, tolerance: float = 0.004) -> None:
    """Assert that an object has sides where they were seen, and that all hypotheses have volume."""
    np.testing.assert_allclose(obj.mesh.bounds[1], np.array(SIZE_M) / 2, atol=tolerance)
    weights = [each.weight for each in obj.hypotheses]
    assert sum(weights) == pytest.approx(1) and weights == sorted(weights, reverse=True)
    assert obj.scan is not None and obj.supplied == obj.hypotheses[0].pieces
    assert all(piece.mesh().volume > 0 for each in obj.hypotheses for piece in each.pieces)


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the files."""
    monkeypatch.chdir(tmp_path)
    trimesh.PointCloud(cloud()).export("scan.ply")
    return tmp_path


def test_a_cloud_is_an_object_that_may_be_several_solids(there: Path):
    obj = gr.load_object("scan.ply", seen_from=CORNER_VIEW, hypotheses=2)
    is_box(obj)
    assert obj.name == "scan" and len(obj.hypotheses) == 2
    # In memory, and as a scan.
    same = gr.load_object(points=cloud().astype(np.float32), seen_from=CORNER_VIEW, hypotheses=2, name="mine")
    np.testing.assert_allclose(same.mesh.bounds, obj.mesh.bounds, atol=1e-5)
    assert same.name == "mine" and same.record is None
    is_box(gr.load_object(obj.scan, hypotheses=2))


def test_what_is_recorded_of_a_scan_reads_it_again(there: Path):
    obj = gr.load_object("scan.ply", seen_from=CORNER_VIEW, hypotheses=2, table=-0.04)
    assert obj.record is not None
    again = gr.load_object(**obj.record)
    np.testing.assert_array_equal(again.mesh.vertices, obj.mesh.vertices)
    assert [each.weight for each in again.hypotheses] == [each.weight for each in obj.hypotheses]


def test_a_box_seen_from_the_front_has_a_thickness():
    """Its mask says that the plane is no table."""
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, -0.5
    depth = depth_of(trimesh.creation.box(SIZE_M), pose)
    mask = depth > 0
    obj = gr.load_object(scan_of_depth([with_noise(depth, 0)], [mask], D435, [pose]), hypotheses=3)
    low, high = obj.mesh.bounds
    np.testing.assert_allclose((low[:2], high[:2]), np.array([[-0.5], [0.5]]) * SIZE_M[:2], atol=0.004)
    assert low[2] == pytest.approx(-SIZE_M[2] / 2, abs=0.004) and 0.01 < high[2] - low[2] < 0.15


def test_a_depth_picture_is_an_object_in_the_frame_of_its_pose(there: Path):
    box = trimesh.creation.box(SIZE_M)
    (pose,) = views_around(box, 1, seed=0)
    depth = depth_of(box, pose)
    Image.fromarray(np.round(depth * 1e3).astype(np.uint16)).save("depth.png")
    Image.fromarray((depth > 0).astype(np.uint8)).save("mask.png")
    obj = gr.load_object("depth.png", intrinsics=D435, mask="mask.png", camera=pose, hypotheses=2)
    assert abs(obj.mesh.bounds[1, 2] - SIZE_M[2] / 2) < 0.004
    same = gr.load_object(scan_of_depth([np.round(depth, 3)], None, D435, [pose]), hypotheses=2)
    np.testing.assert_allclose(same.mesh.bounds, obj.mesh.bounds, atol=1e-4)


def test_an_open_mesh_is_a_scan_where_the_sensor_is_given(there: Path):
    half_box().export("half.stl")
    with refused(MeshError, "half", "`seen_from`"):
        gr.load_object("half.stl")
    is_box(gr.load_object("half.stl", seen_from=CORNER_VIEW, hypotheses=2))
    trimesh.creation.box(SIZE_M).export("whole.stl")
    with refused(MeshError, "whole.stl", "closed", "`seen_from`"):
        gr.load_object("whole.stl", seen_from=CORNER_VIEW)


def test_a_hull_of_a_mesh_with_a_large_open_side_is_doubted():
    (note,) = gr.load_object(half_box(), holes="hull").notes
    assert "`seen_from`" in note
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
    dented = ball.submesh([np.flatnonzero(ball.triangles_center[:, 2] < 0.038)], append=True)
    (note,) = gr.load_object(dented, holes="hull").notes
    assert "`seen_from`" not in note and "hull" in note


def test_the_open_share_is_that_of_flat_caps():
    # Half a box: the cap is bent, around three sides; its vector area is that of these.
    x, y, z = SIZE_M
    hull = half_box().convex_hull.area
    assert open_share(half_box()) == pytest.approx(np.linalg.norm([x * y, y * z, z * x]) / hull)
    # A tube: two caps that point away from each other.
    tube = trimesh.creation.cylinder(0.03, 0.1, sections=64)
    tube.update_faces(np.abs(tube.face_normals[:, 2]) < 0.5)
    ends = np.pi * 0.03**2 * 2
    assert open_share(tube) == pytest.approx(ends / (ends + 0.1 * np.pi * 0.06), rel=0.01)
    assert open_share(trimesh.creation.box(SIZE_M)) == 0 < MAX_OPEN_SHARE


def test_completions_of_another_program_are_taken_as_they_are(there: Path):
    Path("done").mkdir()
    for name, depth in (("shallow", 0.03), ("deep", 0.06), ("deeper", 0.09)):
        trimesh.creation.box([depth, 60e-3, 80e-3]).export(f"done/{name}.stl")
    obj = gr.load_object("scan.ply", seen_from=CORNER_VIEW, completions="done")
    assert [each.weight for each in obj.hypotheses] == pytest.approx([1 / 3] * 3)
    Path("done/weights.toml").write_text("shallow = 1\ndeep = 3\ndeeper = 0\n")
    obj = gr.load_object("scan.ply", seen_from=CORNER_VIEW, completions="done")
    np.testing.assert_allclose(obj.mesh.extents, [0.06, 0.06, 0.08])
    assert [each.weight for each in obj.hypotheses] == [0.75, 0.25, 0]
    # But for what lies below the table.
    cut = gr.load_object("scan.ply", seen_from=CORNER_VIEW, completions="done", table=-0.03)
    np.testing.assert_allclose(cut.mesh.extents, [0.06, 0.06, 0.07])
    for text, word in (("shallow = 1\n", "deep"), ("shallow = -1\ndeep = 1\ndeeper = 1\n", "weights"), ("[", "read")):
        Path("done/weights.toml").write_text(text)
        with refused(MeshError, "weights.toml", word):
            gr.load_object("scan.ply", seen_from=CORNER_VIEW, completions="done")
    with refused(MeshError, "none"):
        gr.load_object("scan.ply", seen_from=CORNER_VIEW, completions="none")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, ("points",)),
        ({"source": "mug", "points": [[0, 0, 0]]}, ("points",)),
        ({"source": "mug", "seen_from": (0, 0, 1)}, ("mug", "scans")),
        ({"source": "sphere:0.03", "camera": np.eye(4)}, ("sphere:0.03", "scans")),
        ({"source": "mug", "completions": "done"}, ("mug", "scans")),
        ({"source": "mug", "hypotheses": 2}, ("mug", "hypotheses", "scans")),
        ({"source": "scan.ply", "seen_from": (0, 0, 1), "hypotheses": 0}, ("hypotheses", "0")),
        ({"source": "scan.ply", "seen_from": (0, 0, 1), "mask": "mask.png"}, ("scan.ply", "mask")),
        ({"points": [[0, 0, 0]], "seen_from": (0, 0, 1)}, ("1 point",)),
        ({"points": np.zeros((50, 2))}, ("points", "(50, 2)")),
        ({"points": cloud(), "seen_from": (0, 0)}, ("seen_from",)),
        ({"source": "missing.pcd"}, ("missing.pcd", "no such file")),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(there: Path, arguments: dict, words: tuple[str, ...]):
    with refused(GraspRefineError, *words):
        gr.load_object(**arguments)
