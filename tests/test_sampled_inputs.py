"""`--grasps sample:N`: what it needs, what it does not go with, and that what it gives is refined."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import refused
from plate_gripper import URDF

from grasp_refine import grasp_sampling
from grasp_refine.cli import main
from grasp_refine.commands.inputs import Inputs
from grasp_refine.errors import GraspFileError, GraspRefineError
from grasp_refine.problem import Problem

BOX = "box:0.5,0.6,0.7"
HELD = ("--hand", "HAND", "--object", BOX)


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A file that is a hand."""
    path: Path = tmp_path_factory.mktemp("hand") / "gripper.urdf"
    path.write_text(URDF)
    return str(path)


def load(hand: str, seed: int = 0, **options: object) -> Problem:
    inputs = Inputs(**{"hand": hand, "object": BOX, "scale": 0.1, "grasps": Path("sample:4")} | options)
    return inputs.load(seed, lambda line: None)


def test_sampled_grasps_are_a_problem_like_any_other(gripper: str):
    problem = load(gripper)
    (group,) = problem.groups
    assert len(problem) == 4
    assert group.object == BOX
    assert group.scale == 0.1
    np.testing.assert_allclose(np.ptp(group.scene.object.mesh.vertices, axis=0), [0.05, 0.06, 0.07])
    np.testing.assert_array_equal(group.grasps.scale, 0.1)
    assert group.scene.target_link is None
    assert problem.files == (problem.hand.urdf,)
    assert problem.closing() == {"pregrasp": "own", "squeeze": "own"}
    assert problem.sampled == "sample:4"
    (note,) = [note for note in problem.notes if "sampled" in note]
    assert note.startswith("sampled 4 grasps in ") and note.endswith(" s")


def test_what_takes_a_while_is_told_after_what_was_asked_is_known_to_be_sound(gripper: str):
    heard: list[str] = []
    with pytest.raises(GraspRefineError, match="--scale"):
        Inputs(hand=gripper, object=BOX, scale=0.0, grasps=Path("sample:4")).load(0, heard.append, heard.append)
    assert heard == []
    Inputs(hand=gripper, object=BOX, scale=0.1, grasps=Path("sample:4")).load(0, heard.append, heard.append)
    assert heard == [f"sampling grasps of gripper on {BOX}"]


def test_the_index_is_that_of_sampled_grasps_and_the_seed_varies_them(gripper: str):
    every, some = (load(gripper, index=index).groups[0] for index in ((), (2, 0)))
    np.testing.assert_array_equal(some.scene.q, every.scene.q[[2, 0]])
    np.testing.assert_array_equal(some.rows, [2, 0])
    assert (load(gripper, seed=1).groups[0].scene.q != every.scene.q).any()
    with pytest.raises(GraspFileError, match="index 7 is out of range"):
        load(gripper, index=(7,))


def test_the_table_is_that_of_the_grasps(gripper: str):
    (group,) = load(gripper, table=-0.035).groups
    assert group.scene.table.offset == -0.035
    assert (group.scene.T_world_root[:, 2, 3] > -0.035).all()


def test_it_is_noted_where_fewer_are_found(gripper: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(grasp_sampling, "TRIES", 1)
    monkeypatch.setattr(grasp_sampling, "AT_LEAST", 256)
    problem = load(gripper, grasps=Path("sample:256"))
    assert f"found only {len(problem)} of 256 grasps of 'gripper' on '{BOX}'" in problem.notes


@pytest.mark.parametrize("number", ["0", "x", "", "1.5", "²"])
def test_the_number_is_a_whole_one(number: str, gripper: str, workplace: Path, capfd: pytest.CaptureFixture[str]):
    error = refused(capfd, "run", "--hand", gripper, "--object", BOX, "--grasps", f"sample:{number}")
    assert error == f"--grasps sample:{number}: sample:N needs a whole number N from 1 on, as in sample:32"


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ((), "give --hand and --object"),
        (("--hand", "HAND"), "give --object"),
        (("--object", BOX), "give --hand"),
        (("--object", "x.obj"), "x.obj: no such mesh file"),
        (("--hand", "HAND", "--object", "mugg"), "did you mean mug?"),
        ((*HELD, "--objects", "."), "--objects and --object-name are for grasp files"),
        ((*HELD, "--object-name", "a"), "--objects and --object-name are for grasp files"),
        ((*HELD, "--targets", "a.npz"), "--targets a.npz: has no rows for the grasps of --grasps sample:2"),
        ((*HELD, "--scale", "0"), "--scale must be positive and finite, got 0"),
        ((*HELD, "--table", "inf"), "--table must be a height in metres, got inf"),
        (
            ("--hand", "HAND", "--object", "sphere:0.001"),
            "no grasp of hand 'gripper' on object 'sphere:0.001' was",
        ),
    ],
)
def test_what_does_not_go_with_it_is_refused(
    options: tuple[str, ...], complaint: str, gripper: str, workplace: Path, capfd: pytest.CaptureFixture[str]
):
    given = [gripper if option == "HAND" else option for option in options]
    assert complaint in refused(capfd, "run", *given, "--grasps", "sample:2")


def test_sampled_grasps_are_refined_and_written(gripper: str, workplace: Path, capsys: pytest.CaptureFixture[str]):
    assert (
        main(["run", "--hand", gripper, "--object", BOX, "--scale", "0.1", "--grasps", "sample:3", "--iterations", "5"])
        == 0
    )
    assert "3 grasps" in capsys.readouterr().out
    (path,) = Path("grasp-refine-results").glob("*.npz")
    with np.load(path) as arrays:
        assert arrays["hand_pose"].shape == (3, 7)
        np.testing.assert_array_equal(arrays["scale"], 0.1)
        provenance = json.loads(str(arrays["provenance"]))
    # Drawn, not read: the hand, the object and the seed say which they are.
    assert provenance["source"]["sampled"] == "sample:3" and provenance["source"]["hand"]["path"] == gripper
    assert provenance["seed"] == 0 and provenance["config"]["inputs"]["object"] == BOX
