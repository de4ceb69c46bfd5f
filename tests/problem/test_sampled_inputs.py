"""`--grasps sample:N`: what it needs, what it does not go with, and that what it gives is refined."""

import re
from pathlib import Path

import numpy as np
import pytest

import refusals
from command_line import refused
from grasp_refine.core.errors import GraspFileError
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.commands.inputs import Inputs
from plate_gripper import URDF
from refusals import assert_names

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
    return load_problem(inputs, seed=seed)


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
    assert "4 grasps" in note and re.search(r"\d s$", note)


def test_the_index_is_that_of_sampled_grasps_and_the_seed_varies_them(gripper: str):
    every, some = (load(gripper, index=index).groups[0] for index in ((), (2, 0)))
    np.testing.assert_array_equal(some.scene.q, every.scene.q[[2, 0]])
    np.testing.assert_array_equal(some.rows, [2, 0])
    assert (load(gripper, seed=1).groups[0].scene.q != every.scene.q).any()
    with refusals.refused(GraspFileError, "index 7"):
        load(gripper, index=(7,))


def test_the_table_is_that_of_the_grasps(gripper: str):
    (group,) = load(gripper, table=-0.035).groups
    assert group.scene.table.offset == -0.035
    assert (group.scene.T_world_root[:, 2, 3] > -0.035).all()


@pytest.mark.parametrize("number", ["0", "x", "", "1.5", "²"])
def test_the_number_is_a_whole_one(number: str, gripper: str, workplace: Path, capfd: pytest.CaptureFixture[str]):
    error = refused(capfd, "run", "--hand", gripper, "--object", BOX, "--grasps", f"sample:{number}")
    assert_names(error, f"--grasps sample:{number}", "sample:N", "1", "sample:32")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ((), ("--hand", "--object")),
        (("--hand", "HAND"), ("--object",)),
        (("--object", BOX), ("--hand",)),
        (("--object", "x.obj"), ("x.obj",)),
        (("--hand", "HAND", "--object", "mugg"), ("mug?",)),
        ((*HELD, "--objects", "."), ("--objects", "--object-name")),
        ((*HELD, "--object-name", "a"), ("--objects", "--object-name")),
        ((*HELD, "--targets", "a.npz"), ("--targets a.npz", "--grasps sample:2")),
        ((*HELD, "--scale", "0"), ("--scale", "positive", "0")),
        ((*HELD, "--table", "inf"), ("--table", "metres", "inf")),
        (("--hand", "HAND", "--object", "sphere:0.001"), ("'gripper'", "'sphere:0.001'")),
    ],
)
def test_what_does_not_go_with_it_is_refused(
    options: tuple[str, ...], named: tuple[str, ...], gripper: str, workplace: Path, capfd: pytest.CaptureFixture[str]
):
    given = [gripper if option == "HAND" else option for option in options]
    assert_names(refused(capfd, "run", *given, "--grasps", "sample:2"), *named)
