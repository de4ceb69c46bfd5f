"""Commands on a scan: it is refined, recorded, and found again by what reads the result."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import refusals
from command_line import refused
from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.objects.object import Object
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scans.depth_camera import depth_of, views_around
from grasp_refine_apps.cli import main

SIZE_M = (0.05, 0.06, 0.09)
DEPTH = (
    *("--object", "depth.png", "--intrinsics", "lens.json", "--mask", "mask.png", "--camera", "camera.txt"),
    *("--hypotheses", "2"),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a depth picture of a box, and a result on it."""
    folder = tmp_path_factory.mktemp("scans")
    box = trimesh.creation.box(SIZE_M)
    (pose,) = views_around(box, 1, seed=1)
    depth = depth_of(box, pose)
    table = np.where(depth > 0, depth, 0.8)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Image.fromarray(np.round(table * 1e3).astype(np.uint16)).save("depth.png")
        Image.fromarray(np.where(depth > 0, 255, 0).astype(np.uint8)).save("mask.png")
        np.savetxt("camera.txt", pose)
        Path("lens.json").write_text(json.dumps({"fx": 424, "fy": 424, "ppx": 423.5, "ppy": 239.5}))
        words = ["run", "--hand", "allegro", *DEPTH, "--grasps", "sample:1", "--geometry-only", "--out", "out"]
        assert main([*words, "--table", "-0.045"]) == 0
    return folder


@pytest.fixture
def result(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The result, beside the files, in the folder in which they were made."""
    monkeypatch.chdir(made)
    return Path("out/allegro_depth.npz")


@pytest.fixture(scope="module")
def known(made: Path) -> Object:
    """The object that its result names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        (group,) = load_problem(ProblemSpec(grasps=Path("out/allegro_depth.npz"))).groups
    return group.scene.object


def test_a_result_finds_its_scan_again(result: Path, known: Object):
    obj = known
    assert obj.scan is not None and 0 < len(obj.hypotheses) <= 2
    # The table of the refinement cuts the solids, also where another one is asked for.
    assert min(piece.vertices[:, 2].min() for each in obj.hypotheses for piece in each.pieces) > -0.047
    assert load_problem(ProblemSpec(grasps=result, table=-0.2)).groups[0].scene.object.mesh.bounds[0] == pytest.approx(
        obj.mesh.bounds[0]
    )


def test_a_scan_that_was_moved_is_read_with_the_recorded_sensors(result: Path, known: Object, tmp_path: Path):
    shutil.copy("depth.png", tmp_path / "other.png")
    same = load_problem(ProblemSpec(grasps=result, object=str(tmp_path / "other.png")))
    np.testing.assert_array_equal(same.groups[0].scene.object.mesh.vertices, known.mesh.vertices)


def test_a_cloud_in_millimetres_is_found_again(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    box = trimesh.creation.box(SIZE_M)
    seen = box.sample(4000, seed=0)
    seen = seen[(seen >= np.array(SIZE_M) / 2 - 1e-6).any(axis=1)]
    np.savetxt("scan.xyz", 1e3 * seen)
    words = ["run", "--hand", "allegro", "--object", "scan.xyz", "--unit", "mm", "--seen-from", "0.4,0.4,0.5"]
    assert main([*words, "--hypotheses", "2", "--grasps", "sample:1", "--geometry-only", "--out", "out"]) == 0
    (group,) = load_problem(ProblemSpec(grasps=Path("out/allegro_scan.npz"))).groups
    np.testing.assert_allclose(group.scene.object.scan.points.max(axis=0), np.array(SIZE_M) / 2, atol=1e-4)
    np.testing.assert_array_equal(group.scene.object.scan.origins, [[0.4, 0.4, 0.5]])


def test_another_scan_is_another_object(result: Path):
    with refusals.refused(GraspFileError, "depth", "`other_object`"):
        load_problem(ProblemSpec(grasps=result, camera="0,0,0.5,180,0,0"))
    Path("box.stl").write_bytes(trimesh.creation.box(SIZE_M).export(file_type="stl"))
    with refusals.refused(GraspFileError, "depth", "`other_object`"):
        load_problem(ProblemSpec(grasps=result, object="box.stl"))
    true = load_problem(ProblemSpec(grasps=result, object="box.stl", other_object=True))
    assert true.groups[0].scene.object.scan is None


def test_a_record_of_another_form_is_no_scan(result: Path, tmp_path: Path):
    arrays = dict(np.load(result))
    provenance = read_provenance(result)
    provenance["objects"][0]["scan"] = {"source": "/etc/passwd", "more": 1}
    np.savez(tmp_path / "r.npz", **arrays | {"provenance": np.array(json.dumps(provenance))})
    with refusals.refused(Exception, "depth"):
        load_problem(ProblemSpec(grasps=tmp_path / "r.npz"))


def test_options_of_scans_are_refused_by_name(made: Path, monkeypatch: pytest.MonkeyPatch, capfd):
    monkeypatch.chdir(made)
    sampled = ("run", "--hand", "allegro", "--grasps", "sample:1")
    for words, named in (
        (("--object", "depth.png"), ("depth.png", "--intrinsics")),
        (("--object", "depth.png", "--intrinsics", "1,2"), ("1,2",)),
        (("--object", "mug", "--seen-from", "0,0,1"), ("mug",)),
        ((*DEPTH[:6], "--camera", "none.txt"), ("--camera", "none.txt")),
        ((*DEPTH[:4], "--mask", "none.png"), ("--mask", "none.png")),
        ((*DEPTH[:8], "--hypotheses", "0"), ("--hypotheses", "0")),
        ((*DEPTH[:4], "--seen-from", "0,0,1"), ("--camera", "--seen-from")),
    ):
        refusals.assert_names(refused(capfd, *sampled, *words), *named)
