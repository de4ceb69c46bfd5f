"""MultiGripperGrasp: poses of a gripper's root, and joints in the order of Isaac Sim, as its project lists it."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_se3, pose_from_transform
from grasp_refine.grasps.formats.agreement import check_same
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.multigripper import GRIPPERS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.writing import written
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

Load = Callable[..., Hand]
NUM_DOFS = {
    "Allegro": 16, "Barrett": 8, "HumanHand": 20, "fetch_gripper": 2, "franka_panda": 2, "h5_hand": 4, "jaco_robot": 3,
    "robotiq_3finger": 11, "sawyer": 2, "shadow_hand": 22, "wsg_50": 2,
}  # fmt: skip
"""Lengths of `opened_dofs` in its gripper_isaac_info.json."""
POSES = pose_from_transform(exp_se3(np.random.default_rng(4).normal(size=(3, 6)) * [0.1, 0.1, 0.1, 2, 2, 2]))


def contents(gripper: str, **changes: Any) -> dict[str, Any]:
    dofs = (np.arange(3 * NUM_DOFS.get(gripper, 4)).reshape(3, -1) / 100).tolist()
    return {"gripper": gripper, "object_id": "Mug", "pose": POSES.tolist(), "dofs": dofs} | changes


def save(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def load_none(base_link: str) -> Hand:
    raise AssertionError("nothing is rebased")


def test_orders_are_as_long_as_its_grippers_have_joints():
    assert {name: len(layout.joints) for name, layout in GRIPPERS.items()} == NUM_DOFS
    assert all(len(set(layout.joints)) == len(layout.joints) for layout in GRIPPERS.values())
    allegro = [int(name[6:-2]) for name in GRIPPERS["Allegro"].joints]
    assert allegro == [0, 12, 4, 8, 1, 13, 5, 9, 2, 14, 6, 10, 3, 15, 7, 11]
    shadow = GRIPPERS["shadow_hand"].joints
    assert shadow[4:7] == ("thumb_joint1", "index_finger_join2", "little_finger_joint2")
    assert shadow[-2:] == ("little_finger_joint5", "thumb_joint5")
    # Level by level, as the README of its branch iros_2024 lists them.
    robotiq = [name.removeprefix("RIQ_").removesuffix("_joint") for name in GRIPPERS["robotiq_3finger"].joints]
    assert robotiq[3:7] == [f"link_{n}_RIQ_link_{n + 1}_joint_{f}" for n, f in ((0, "c"), (0, "b"), (1, "a"), (1, "c"))]
    human = GRIPPERS["HumanHand"].joints
    assert (human[0], human[5], human[19]) == ("palm_index1_0_joint", "index1_0_index1_joint", "thumb2_thumb3_joint")


@pytest.mark.parametrize("gripper", list(GRIPPERS))
def test_files_and_round_trips(gripper: str, tmp_path: Path):
    simulated = {"result": [1, 0, 1], "fall_time": [3.0, 0.5, 3.0], "final_dofs": [], "test_type": "gravity"}
    read = reading(save(tmp_path / "a.json", contents(gripper, **simulated)))
    grasps, layout = read.grasps, GRIPPERS[gripper]
    assert read.format.name == "multigripper" and set(grasps.object) == {"Mug"} and set(grasps.scale) == {1.0}
    assert (grasps.hand, grasps.base_link, grasps.joint_names) == (layout.hand, layout.base_link, layout.joints)
    np.testing.assert_allclose(grasps.hand_pose, POSES, atol=1e-15)
    np.testing.assert_array_equal(grasps.q, contents(gripper)["dofs"])
    assert_names(" ".join(read.notes), "order", gripper, "success (1 of 2, 0 of 1)", "fall_time", "final_dofs")
    known = FORMATS["multigripper"]
    parts, lost = known.write(grasps, load_none)
    assert [part.path for part in parts] == [f"{gripper}-Mug.json"] and not lost
    with written(tmp_path / "b.json", known, parts):
        pass
    again = reading(tmp_path / "b.json").grasps
    assert check_same(grasps, again) < 1e-15
    for labels in (grasps.labels, again.labels):
        np.testing.assert_array_equal(labels["success"], simulated["result"])
        np.testing.assert_array_equal(labels["fall_time"], simulated["fall_time"])


def test_a_file_of_the_allegro_hand_is_of_no_other(grasps: Callable[..., GraspSet], load: Load, tmp_path: Path):
    with refused(GraspFileError, "multigripper", "'shadow'"):
        FORMATS["multigripper"].write(grasps("shadow"), partial(load, "shadow"))
    path = save(tmp_path / "a.json", contents("Allegro"))
    with refused(GraspFileError, path, "Allegro", "'shadow'"):
        reading(path, hand=load("shadow", "palm"))


def test_one_finger_of_the_franka_hand_is_enough(tmp_path: Path):
    both = reading(save(tmp_path / "a.json", contents("franka_panda"))).grasps
    one = replace(both, joint_names=both.joint_names[:1], q=both.q[:, :1])
    parts, _ = FORMATS["multigripper"].write(one, load_none)
    assert parts[0].content["dofs"] == [[first, first] for first in both.q[:, 0]]


def test_poses_only(tmp_path: Path):
    held = {key: value for key, value in contents("ezgripper").items() if key != "dofs"}
    held["object_ID"] = held.pop("object_id")
    read = reading(save(tmp_path / "a.json", held))
    assert (read.grasps.hand, read.grasps.joint_names) == ("ezgripper", ()) and "dofs" in read.notes[0]


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (contents("ezgripper"), ("'ezgripper'", "no joints", "Isaac Sim", "panda_finger_joint1")),
        (contents("wsg_50", dofs=[[0.0]] * 3), ("dofs", "(3, 2)", "(3, 1)")),
        (contents("wsg_50", dofs=[[0.0, 0.0]] * 2), ("dofs", "(3, 2)", "(2, 2)")),
        (contents("wsg_50", pose=[[0.0] * 6]), ("pose", "(N, 7)", "(1, 6)")),
        (contents("wsg_50", pose=[[0, 0, 0, 2, 0, 0, 0]]), ("pose", "row 0")),
        (contents("wsg_50", object_id=3), ("object_id", "int")),
        (contents("wsg_50") | {"gripper": [1]}, ("gripper",)),
        (contents("wsg_50", result=[1]), ("result", "(3)", "(1,)")),
        ({"gripper": "wsg_50", "pose": []}, ("multigripper", "object_id")),
    ],
)
def test_defects_are_named(content: Any, named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.json", content)
    with refused(GraspFileError, path, *named):
        reading(path)


def test_a_grasp_that_is_not_finite_costs_no_other(tmp_path: Path):
    held = contents("wsg_50")
    held["pose"][1][0] = float("nan")
    assert reading(save(tmp_path / "a.json", held)).grasps.finite.tolist() == [True, False, True]
