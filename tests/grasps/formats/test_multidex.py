"""MultiDex and D(R,O)-Grasp: rows of torch files, after what their own code does with them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import inverse, transform_from_pose
from grasp_refine.grasps.formats import dro, multidex
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from refusals import assert_names, refused

Load = Callable[..., Hand]
NUM_JOINTS = {"shadowhand": 24, "allegro": 16, "barrett": 8, "robotiq_3finger": 11, "leaphand": 16}


def rows(count: int, robot: str, rotation: Callable[[Rotation], np.ndarray]) -> tuple[np.ndarray, Rotation]:
    """Rows in single precision, and their rotations."""
    random = np.random.default_rng(3)
    turned = Rotation.random(count, random_state=3)
    parts = [random.normal(size=(count, 3)), rotation(turned), random.normal(size=(count, NUM_JOINTS[robot]))]
    return np.concatenate(parts, axis=1).astype(np.float32), turned


def six(turned: Rotation) -> np.ndarray:
    return turned.as_matrix()[:, :, :2].swapaxes(1, 2).reshape(-1, 6)


def angles(turned: Rotation) -> np.ndarray:
    return turned.as_euler("XYZ")


def save(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(content, path)
    return path


def metadata(robot: str, rotation: Callable[[Rotation], np.ndarray], count: int = 3) -> list[tuple[Any, ...]]:
    values, _ = rows(count, robot, rotation)
    return [(torch.tensor(row), "contactdb+apple", robot) for row in values]


def test_the_tables_have_as_many_joints_as_the_hands():
    for table in (multidex.ROBOTS, dro.ROBOTS):
        assert {robot: len(layout.joints) for robot, layout in table.items()} == NUM_JOINTS
        assert all(len(set(layout.joints)) == len(layout.joints) for layout in table.values())
    # As in the URDFs of GeorgeWuzy/CEDex-Grasp c5acc16, barrett_adagrasp/model.urdf and robotiq_3finger.
    barrett = [name[3:6] for name in multidex.ROBOTS["barrett"].joints]
    assert barrett == ["j32", "j33", "j11", "j12", "j13", "j21", "j22", "j23"]
    robotiq = [
        name.removeprefix("gripper_finger").replace("joint_", "") for name in multidex.ROBOTS["robotiq_3finger"].joints
    ]
    assert robotiq == "A_2 A_3 A_4 B_knuckle B_2 B_3 B_4 C_knuckle C_2 C_3 C_4".split()


@pytest.mark.parametrize("robot", list(NUM_JOINTS))
def test_rows_of_multidex(robot: str, tmp_path: Path):
    values, turned = rows(4, robot, six)
    info = {"robot_name": robot, "num_total": 4}
    listed = [(torch.tensor(row), f"contactdb+{i}", robot) for i, row in enumerate(values)]
    read = reading(save(tmp_path / f"{robot}.pt", {"info": info, "metadata": listed}))
    assert read.format.name == "multidex" and read.grasps.joint_names == multidex.ROBOTS[robot].joints
    T = transform_from_pose(read.grasps.hand_pose)
    np.testing.assert_allclose(T[:, :3, 3], values[:, :3], atol=1e-7)
    np.testing.assert_allclose(T[:, :3, :3], turned.as_matrix(), atol=1e-6)
    np.testing.assert_array_equal(read.grasps.q, values[:, 9:].astype(float))
    assert read.grasps.object.tolist() == [f"contactdb+{i}" for i in range(4)] and set(read.grasps.scale) == {1.0}
    assert_names(read.notes[0], "order", robot)
    # The sets for its networks have a contact map in front; others leave the hand to `info`.
    maps = [(torch.zeros(8, 1), row, thing, of) for row, thing, of in listed]
    short = [(row, thing) for row, thing, _ in listed]
    for number, other in enumerate((maps, short)):
        again = reading(save(tmp_path / f"{number}.pt", {"info": info, "metadata": other}), format="multidex").grasps
        np.testing.assert_array_equal(again.q, read.grasps.q)


def test_columns_that_are_not_orthogonal_turn_by_as_much():
    tilt = 0.1
    row = np.array([[0, 0, 0, np.cos(tilt), np.sin(tilt), 0, np.sin(tilt), np.cos(tilt), 0]])
    np.testing.assert_allclose(multidex._transforms(row)[0], np.eye(4), atol=1e-15)


@pytest.mark.parametrize("robot", list(NUM_JOINTS))
def test_rows_of_dro(robot: str, tmp_path: Path):
    values, turned = rows(4, robot, angles)
    listed = [(torch.tensor(row), "ycb+pear", robot) for row in values]
    read = reading(save(tmp_path / "cmap_dataset.pt", {"info": {robot: {"num_total": 4}}, "metadata": listed}))
    assert read.format.name == "dro"
    T_root_base = dro.ROBOTS[robot].T_root_base
    T = transform_from_pose(read.grasps.hand_pose) @ inverse(T_root_base)
    np.testing.assert_allclose(T[:, :3, 3], values[:, :3], atol=1e-6)
    np.testing.assert_allclose(T[:, :3, :3], turned.as_matrix(), atol=1e-6)
    # The same rows as one array in a folder named after the hand, and as predictions.
    array = reading(save(tmp_path / robot / "ycb+pear_4.pt", torch.tensor(values)))
    part = {"robot_name": robot, "object_name": "ycb+pear", "predict_q": torch.tensor(values)}
    success = torch.tensor([True, False, True, True])
    predicted = reading(save(tmp_path / "vis.pt", [{**part, "success": success}]))
    for other in (array, predicted):
        assert other.format.name == "dro" and set(other.grasps.object) == {"ycb+pear"}
        np.testing.assert_array_equal(other.grasps.hand_pose, read.grasps.hand_pose)
    np.testing.assert_array_equal(predicted.grasps.labels["success"], success)


def test_the_root_of_leap_lies_above_its_palm():
    hand = load_hand("leap", base_link="base", candidates=16)
    chain = Chain(hand, ("palm_lower",))
    T_root_palm = chain(np.eye(4)[None], np.zeros((1, 16))).T_world_link[0, 0]
    np.testing.assert_allclose(T_root_palm, dro.ROBOTS["leaphand"].T_root_base, atol=1e-5)


def test_a_right_allegro_is_no_left_one(grasps: Callable[..., GraspSet], load: Load, tmp_path: Path):
    with refused(GraspFileError, "dro", "left", "'allegro'"):
        FORMATS["dro"].write(grasps("allegro"), partial(load, "allegro"))
    path = save(tmp_path / "a.pt", {"metadata": metadata("allegro", angles)})
    assert reading(path).grasps.hand == "allegro_left"
    given = reading(path, hand=load("allegro", "base_link"))
    assert given.grasps.hand == "allegro" and "left" in given.notes[-1]


def test_several_hands_in_one_file(load: Load, tmp_path: Path):
    listed = metadata("shadowhand", six) + metadata("allegro", six, 2)
    path = save(tmp_path / "a.pt", {"metadata": listed})
    with refused(GraspFileError, path, "`hand`", "shadowhand (3)", "allegro (2)"):
        reading(path)
    for hand, base, count in (("shadow", "forearm", 3), ("allegro", "base_link", 2)):
        read = reading(path, hand=load(hand, base))
        assert len(read.grasps) == count and read.grasps.hand == hand
        assert_names(read.notes[1], "shadowhand (3)")
    with refused(GraspFileError, path, "leap"):
        reading(path, hand=load("leap", "palm_lower"))


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({"metadata": [(torch.zeros(10), "a", "ezgripper")]}, ("fits", "multidex", "dro", "`format`")),
        ({"metadata": [(torch.zeros(12), "a", "allegro")]}, ("rows of allegro", "12", "25", "22")),
        ({"metadata": [*metadata("allegro", six), (torch.zeros(3), "a", "allegro")]}, ("25", "3")),
        ({"metadata": [*metadata("allegro", six), 3]}, ("metadata[3]",)),
        ({"metadata": []}, ("metadata",)),
        ({"metadata": "x"}, ("metadata",)),
        ({"metadata": [("a", "b")]}, ("metadata",)),
        ([{"predict_q": torch.zeros(2, 22)}], ("robot_name",)),
        ([{"predict_q": torch.zeros(2), "robot_name": "allegro", "object_name": "a"}], ("predict_q", "(2,)")),
        (torch.zeros(2, 22), ("folder", "none of")),
    ],
)
def test_defects_are_named(content: Any, named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.pt", content)
    with refused(GraspFileError, path, *named):
        reading(path)


def test_a_hand_whose_order_is_not_known_is_refused(tmp_path: Path):
    path = save(tmp_path / "a.pt", {"metadata": [(torch.zeros(10), "a", "ezgripper")]})
    for name in ("multidex", "dro"):
        with refused(GraspFileError, path, "'ezgripper'", "no joints", "shadowhand: WRJ2, WRJ1", "bh_j32_joint"):
            reading(path, format=name)


def test_a_grasp_that_is_not_finite_costs_no_other(tmp_path: Path):
    for name, rotation in (("multidex", six), ("dro", angles)):
        listed = metadata("allegro", rotation)
        listed[1][0][4] = np.nan
        read = reading(save(tmp_path / "a.pt", {"metadata": listed}))
        assert read.format.name == name and read.grasps.finite.tolist() == [True, False, True]
