"""Lightning Grasp: the object's pose in the hand's frame, joints in the order of its own files of the hands."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_se3, inverse, transform_from_pose
from grasp_refine.grasps.formats.lightning_grasp import LAYOUTS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

Load = Callable[..., Hand]
T_HAND_OBJECT = exp_se3(np.random.default_rng(2).normal(size=(3, 6)))


def contents(count: int, **more: Any) -> dict[str, Any]:
    return {"q": np.arange(3.0 * count).reshape(3, count) / 100, "object_pose": T_HAND_OBJECT} | more


def save(path: Path, content: dict[str, Any]) -> Path:
    torch.save({key: torch.tensor(v) if isinstance(v, np.ndarray) else v for key, v in content.items()}, path)
    return path


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.hand)
def test_the_object_lies_in_the_frame_of_the_hand(layout: Any, tmp_path: Path):
    count = len(layout.joints)
    read = reading(save(tmp_path / "apple.pt", contents(count, robot_name=layout.hand)))
    grasps = read.grasps
    assert (read.format.name, grasps.hand, grasps.base_link) == ("lightning_grasp", layout.hand, layout.base_link)
    assert grasps.joint_names == layout.joints and set(grasps.object) == {"apple"} and set(grasps.scale) == {1.0}
    np.testing.assert_array_equal(grasps.q, contents(count)["q"])
    T = inverse(transform_from_pose(grasps.hand_pose) @ inverse(layout.T_root_base))
    np.testing.assert_allclose(T, T_HAND_OBJECT, atol=1e-12)
    assert_names(read.notes[0], "order", layout.hand)


def test_the_order_of_shadow_is_its_own():
    assert LAYOUTS[0].joints[:9] == ("RFJ1", "RFJ2", "RFJ3", "RFJ4", "LFJ1", "LFJ2", "LFJ3", "LFJ4", "LFJ5")
    fingers = (("TH", 5), ("MF", 4), ("FF", 4))
    assert LAYOUTS[0].joints[9:] == tuple(f"{finger}J{n}" for finger, k in fingers for n in range(1, k + 1))


def test_names_of_the_object(tmp_path: Path):
    for path, name in (
        ("./assets/object/ycb/013_apple/textured.obj", "013_apple"),
        (["my/cube_40mm.stl"] * 3, "cube_40mm"),
    ):
        read = reading(save(tmp_path / "x.pt", contents(22, mesh_path=path))).grasps
        assert set(read.object) == {name}


def test_allegro_and_leap_have_as_many_joints(load: Load, tmp_path: Path):
    path = save(tmp_path / "a.pt", contents(16))
    with refused(GraspFileError, path, "16", "allegro", "leap", "`hand`"):
        reading(path)
    assert reading(path, hand=load("leap", "palm_lower")).grasps.hand == "leap"
    assert reading(save(path, contents(16, robot_name=["allegro"] * 3))).grasps.hand == "allegro"


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (contents(5), ("5 joint values", "shadow has 22")),
        (contents(22, object_pose=T_HAND_OBJECT[:2]), ("object_pose", "(3, 4, 4)", "(2, 4, 4)")),
        (contents(22, object_pose=2 * T_HAND_OBJECT), ("object_pose", "row 0", "rigid")),
        (contents(22, object_pose=T_HAND_OBJECT.swapaxes(1, 2)), ("object_pose", "rigid")),
        (contents(22, object_pose=T_HAND_OBJECT * [1, 1, -1, 1]), ("object_pose", "rigid")),
        (contents(22, q=np.zeros(22)), ("q", "(22,)")),
        (contents(22, robot_name="mine"), ("'mine'",)),
        (contents(22, mesh_path=3), ("mesh_path", "int")),
    ],
)
def test_defects_are_named(content: dict[str, Any], named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.pt", content)
    with refused(GraspFileError, path, *named):
        reading(path)


def test_a_grasp_that_is_not_finite_costs_no_other(tmp_path: Path):
    T = T_HAND_OBJECT.copy()
    T[1, 0, 3] = np.nan
    assert reading(save(tmp_path / "a.pt", contents(22, object_pose=T))).grasps.finite.tolist() == [True, False, True]
