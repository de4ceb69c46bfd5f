"""Results are for the object that they were refined on: another one is refused by name, or taken when asked."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import refusals
from command_line import refused
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import save_npz
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.objects.object import load_object
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.recorded_objects import Recorded, object_entries, pieces_digest, surface_digest
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.cli import main

ALLEGRO = resource_dir("robots") / "allegro"
QUICK = ("--geometry-only", "--index", "0")


@pytest.fixture(scope="module")
def refined(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a box of millimetres that is called like one of ours, and a result on it."""
    folder = tmp_path_factory.mktemp("refined")
    load_object("rounded_box").mesh.apply_scale(1000).export(folder / "mine.obj")
    grasps = ALLEGRO / "example_rounded_box.npz"
    run = ["run", *QUICK, "--grasps", str(grasps), "--object", "mine.obj", "--unit", "mm", "--out", "out"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(run) == 0
    return folder


@pytest.fixture
def result(refined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The result, in a copy of its folder, in which commands run."""
    monkeypatch.chdir(shutil.copytree(refined, tmp_path, dirs_exist_ok=True))
    return tmp_path / "out" / "allegro_rounded_box.npz"


def test_a_mesh_is_known_by_its_triangles_alone():
    mesh = load_object("mug").mesh
    rng = np.random.default_rng(0)
    order = rng.permutation(len(mesh.vertices))
    faces = np.argsort(order)[mesh.faces][rng.permutation(len(mesh.faces))]
    turned = mesh.copy()
    turned.vertices, turned.faces = mesh.vertices[order] + 1e-14, np.roll(faces, 1, axis=1)
    assert surface_digest(turned) == surface_digest(mesh)
    mirrored, moved = mesh.copy(), mesh.copy()
    mirrored.faces = mesh.faces[:, ::-1]
    moved.vertices = mesh.vertices + [0, 0, 1e-6]
    digests = {surface_digest(one) for one in (mesh, mirrored, moved, mesh.copy().apply_scale(1.001))}
    assert len(digests) == 4


def test_pieces_are_known_by_their_vertices_and_radii():
    pieces = load_object("mug").body.pieces
    assert pieces_digest(pieces[::-1]) == pieces_digest(pieces)
    assert pieces_digest(pieces[1:]) != pieces_digest(pieces)
    assert pieces_digest([replace(pieces[0], radius=1e-3)]) != pieces_digest(pieces[:1])


@pytest.mark.parametrize("words", [("validate", "--no-simulate"), ("view", "--no-open", "--port", "0"), ("run",)])
def test_another_object_is_refused_by_name(result: Path, capfd: pytest.CaptureFixture[str], words: tuple[str, ...]):
    capfd.readouterr()
    grasps = ("--grasps", result) if words[0] == "run" else (result,)
    said = refused(capfd, *words, *grasps, "--object", "mug", "--scale", "1000", "--index", "0")
    refusals.assert_names(said, result, "'rounded_box'", "mug", "--other-object")


def test_another_size_is_another_object(result: Path):
    with refusals.refused(GraspFileError, "60 x 50 x 90 mm", "72 x 60 x 108 mm", "`other_object`"):
        load_problem(ProblemSpec(object="mine.obj", scale=1.2, grasps=result))


def test_another_object_is_taken_when_asked_for(result: Path):
    mug = load_problem(ProblemSpec(object="mug", scale=1000, other_object=True, grasps=result))
    assert mug.groups[0].scene.object.name == "mug"
    assert any("60 x 50 x 90 mm" in note for note in mug.notes)


def test_the_same_mesh_is_the_same_object_wherever_it_lies(result: Path):
    Path("elsewhere").mkdir()
    Path("mine.obj").rename("elsewhere/other.obj")
    assert load_problem(ProblemSpec(object="elsewhere/other.obj", grasps=result)).notes == ()


def test_a_mesh_that_was_exported_anew_is_taken_with_a_note(result: Path):
    """In metres, with the eight digits of the exporter, which are fewer than those of millimetres."""
    load_object("mine.obj", scale=1e-3).mesh.export("metres.obj")
    (note,) = load_problem(ProblemSpec(object="metres.obj", scale=1e3, grasps=result)).notes
    assert "rounded_box" in note
    shifted = load_object("mine.obj", scale=1e-3).mesh
    shifted.apply_translation([0.0, 0.0, 1e-4]).export("shifted.obj")
    with refusals.refused(GraspFileError, "`other_object`"):
        load_problem(ProblemSpec(object="shifted.obj", scale=1e3, grasps=result))


def test_other_pieces_of_the_same_mesh_are_noted(tmp_path: Path):
    (group,) = load_problem(ProblemSpec(hand="allegro", index=(0,))).groups
    coarse = load_problem(ProblemSpec(hand="allegro", index=(0,), threshold=1.0)).groups
    save_npz(tmp_path / "r.npz", {"provenance": np.array(json.dumps({"objects": _plain(object_entries([group]))}))})
    assert not Recorded.of([tmp_path / "r.npz"]).check_objects([group], other=False)
    (note,) = Recorded.of([tmp_path / "r.npz"]).check_objects(coarse, other=False)
    assert "pieces" in note and "mug" in note


def _plain(entries: list[dict]) -> list[dict]:
    return [{**entry, "measures_m": list(entry["measures_m"])} for entry in entries]


@pytest.mark.slow
def test_a_batch_refuses_results_of_another_object(result: Path, capfd: pytest.CaptureFixture[str]):
    words = ["batch", str(result), "--geometry-only", "--workers", "1", "--object"]
    assert main([*words, "mug", "--scale", "1000", "--out", "other"]) == 1
    assert "--other-object" in "".join(capfd.readouterr())
    assert not list(Path("other").rglob("*.npz"))
    assert main([*words, "mine.obj", "--out", "same"]) == 0
    (shard,) = Path("same").rglob("*.npz")
    assert read_provenance(shard)["objects"] == read_provenance(result)["objects"]


@pytest.mark.parametrize(
    "objects",
    ["mug", [1], [{"name": [], "scale": 1.0, "mesh": "", "pieces": "", "measures_m": [1]}], [{"name": "mug"}], None],
)
def test_results_without_hashes_are_read_as_before(tmp_path: Path, objects: object):
    (group,) = load_problem(ProblemSpec(hand="allegro", index=(0,))).groups
    save_npz(tmp_path / "old.npz", {"provenance": np.array(json.dumps({"objects": objects}))})
    recorded = Recorded.of([tmp_path / "old.npz", tmp_path / "foreign.npy"])
    assert recorded.check_objects([group], other=False) == ()
