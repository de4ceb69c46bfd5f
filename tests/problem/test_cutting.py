"""Objects are cut when everything else is known to be right, and only those that are needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_line import refused
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.geometry import pieces
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.objects.object import load_object
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.batch.plan import Planner
from grasp_refine_apps.batch.work import unusable_objects
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.inputs import Inputs

EXAMPLES = resource_dir("robots")
QUICK = ("--geometry-only", "--iterations", "5")


@pytest.fixture
def decomposed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Number of faces of each mesh that is decomposed; each becomes its hull."""
    seen: list[int] = []

    def decompose(vertices: np.ndarray, faces: np.ndarray, *_: object, **__: object) -> list[np.ndarray]:
        seen.append(len(faces))
        return [vertices]

    monkeypatch.setattr(pieces, "decompose", decompose)
    return seen


@pytest.fixture
def objects(tmp_path: Path) -> Path:
    """A folder with a concave mesh in metres, one in millimetres and one with a hole."""
    folder = tmp_path / "objects"
    folder.mkdir()
    arm, leg = trimesh.creation.box(bounds=[[0, 0, 0], [3, 1, 1]]), trimesh.creation.box(bounds=[[0, 0, 0], [1, 3, 1]])
    corner = trimesh.boolean.union([arm, leg])
    corner.copy().apply_scale(0.03).export(folder / "corner.ply")
    corner.copy().apply_scale(30).export(folder / "large.ply")
    corner.update_faces(np.arange(len(corner.faces)) > 3)
    corner.apply_scale(0.03).export(folder / "open.ply")
    return folder


def file_of(folder: Path, *names: str) -> Path:
    """Grasps of the example hand, one on each of some objects."""
    example = load_grasps(EXAMPLES / "allegro" / "example_mug.npz")
    path = folder / f"{'_'.join(names)}.npz"
    save_npz(path, replace(example.select(np.arange(len(names))), object=np.array(names)).arrays())
    return path


@pytest.mark.parametrize(
    ("names", "options", "named"),
    [
        (("corner", "large"), "", "large.ply"),
        (("corner", "open"), "", "open"),
        (("corner",), "--contacts elbow", "elbow"),
        (("corner",), "--index 7", "7"),
        (("corner",), "--targets none.npz", "none.npz"),
        (("corner",), "--out {file}", ".npz"),
    ],
)
def test_nothing_is_cut_before_every_input_is_checked(
    names: tuple[str, ...],
    options: str,
    named: str,
    objects: Path,
    tmp_path: Path,
    workplace: Path,
    decomposed: list[int],
    capfd: pytest.CaptureFixture[str],
):
    file = file_of(tmp_path, *names)
    asked = options.format(file=file).split()
    assert named in refused(capfd, "run", *QUICK, "--grasps", file, "--objects", objects, *asked)
    assert decomposed == []


def test_an_object_that_is_not_asked_for_is_not_even_read(
    objects: Path, tmp_path: Path, workplace: Path, decomposed: list[int]
):
    file = file_of(tmp_path, "corner", "large", "open")
    chosen = ("--grasps", str(file), "--objects", str(objects), "--object-name", "corner")
    assert main(["run", *QUICK, *chosen]) in (0, 1)
    assert len(decomposed) == 1


@pytest.mark.parametrize("hand", ["allegro", "leap", "shadow"])
@pytest.mark.parametrize("name", ["mug", "bottle", "rounded_box"])
def test_a_first_run_of_what_comes_with_the_program_cuts_nothing(
    hand: str, name: str, workplace: Path, decomposed: list[int]
):
    problem = load_problem(ProblemSpec(hand=hand, object=name))
    assert problem.groups[0].scene.object.name == name
    assert decomposed == []


@pytest.mark.parametrize("scale", [1.0, 0.37, 12.5])
def test_the_bowl_of_any_scale_comes_with_the_program(scale: float, tmp_path: Path, decomposed: list[int]):
    bowl = load_object("bowl", scale=scale, unit="m", cache=tmp_path)
    assert len(bowl.body.pieces) > 10 and decomposed == [] and not list(tmp_path.iterdir())
    np.testing.assert_allclose(bowl.body.diagonal, np.linalg.norm(bowl.mesh.extents), rtol=0.05)


def test_a_batch_finds_unusable_objects_before_it_cuts_any(
    objects: Path, tmp_path: Path, workplace: Path, decomposed: list[int]
):
    jobs = read_jobs([str(file_of(tmp_path, "corner", "large", "open"))], Inputs(objects=objects))
    plan = Planner(tmp_path / "out", 64, "a batch", {}, 0).plan(jobs, lambda line: None, lambda number, name: None)
    heard: list[int] = []
    failed = {number: one.message for number, one in unusable_objects(plan.shards, heard.append).items()}
    assert [plan.shards[number].task.object for number in failed] == ["large", "open"]
    assert "`unit='mm'`" in failed[1] and "open" in failed[2]
    assert heard == [0, 1, 2] and decomposed == []
