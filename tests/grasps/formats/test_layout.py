"""Orders and frames of formats agree with the makers' MJCF files, and an order that is not certain is refused."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.layout import (
    ALLEGRO,
    BODEX,
    LEAP,
    MUJOCO,
    SHADOW_FINGERS,
    SHADOW_THUMB,
    Layout,
    layout_of,
)
from grasp_refine.grasps.formats.leap_cache import JOINTS
from grasp_refine.grasps.formats.source import Source
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

SOURCE = Source(Path("g.npy"), None)


def refusal(*arguments, **keywords) -> str:
    """The message with which an order is refused, behind the path of the file."""
    with refused(GraspFileError) as raised:
        layout_of(SOURCE, *arguments, **keywords)
    assert str(raised.value).startswith("g.npy: ")
    return str(raised.value).removeprefix("g.npy: ")


@pytest.mark.parametrize(
    ("layout", "file", "palm"),
    [
        (MUJOCO[0], "shadow_mjcf/right_hand_22dof_dgb.xml", "rh_palm"),
        (MUJOCO[1], "allegro_mjcf/right_hand_dgb.xml", "palm"),
        (MUJOCO[2], "leap_mjcf/right_hand.xml", None),
    ],
)
def test_the_order_is_that_of_the_mjcf_and_the_frame_that_of_its_world(
    layout: Layout, file: str, palm: str | None, shared_assets: Path, load: Callable[..., Hand]
):
    model = mujoco.MjModel.from_xml_path(str(shared_assets / "hands" / file))
    hand = load(layout.hand)
    there = [model.joint(i).name.removeprefix("rh_") for i in range(model.njnt)]
    ours = [hand.mjcf_joints.get(joint, joint) for joint in layout.joints]
    assert there == ours
    if palm is None:
        # The file at hand is of another simulation, which holds the palm elsewhere.
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    at = data.body(palm)
    np.testing.assert_allclose(layout.T_root_base[:3, 3], at.xpos, atol=1e-12)
    np.testing.assert_allclose(layout.T_root_base[:3, :3], at.xmat.reshape(3, 3), atol=1e-12)


def test_bodex_has_the_thumb_of_shadow_first():
    thumb = ("THJ5", "THJ4", "THJ3", "THJ2", "THJ1")
    assert BODEX[0].joints[:5] == thumb == MUJOCO[0].joints[-5:]
    assert BODEX[0].joints[5:] == MUJOCO[0].joints[:-5]
    for layout in BODEX:
        np.testing.assert_array_equal(layout.T_root_base, np.eye(4))


def test_every_layout_is_of_a_hand_of_ours(load: Callable[..., Hand]):
    for layout in (*MUJOCO, *BODEX):
        hand = load(layout.hand, layout.base_link)
        assert set(layout.joints) == set(hand.joint_names)
    assert sorted(JOINTS, key=int) == sorted(LEAP, key=int) == [str(number) for number in range(16)]


def test_leap_hangs_upside_down_a_tenth_of_a_metre_up():
    np.testing.assert_allclose(MUJOCO[2].T_root_base, transform_from_pose(np.array([0, 0, 0.1, 0, 1, 0, 0.0])))


def test_several_hands_with_that_number_need_a_name(load: Callable[..., Hand]):
    message = refusal(MUJOCO, 16, None)
    assert_names(message, "16", "allegro", ", ".join(ALLEGRO), "leap", ", ".join(LEAP), "`hand`")
    assert "shadow" not in message
    assert layout_of(SOURCE, MUJOCO, 16, None, hand_name="leap_tac3d") == MUJOCO[2]
    assert layout_of(SOURCE, MUJOCO, 16, load("allegro")) == MUJOCO[1]
    assert layout_of(SOURCE, MUJOCO, 16, load("leap")) == MUJOCO[2]


def test_names_that_are_numbers_have_no_prefix():
    # LEAP's joints are called 0 to 15; those of another hand are not these because they are numbered.
    message = refusal(MUJOCO, 16, None, names=[f"joint_{i}" for i in range(16)])
    assert_names(message, "joint_0, joint_1, ", "leap", "1, 0, 2, 3, ")


@pytest.mark.parametrize("name", ["sharpa_wave", "shadow_left"])
def test_a_hand_that_the_file_names_is_not_taken_for_another_of_as_many_joints(name: str):
    assert_names(refusal(MUJOCO, 22, None, hand_name=name), f"'{name}'")
    assert layout_of(SOURCE, MUJOCO, 22, None, hand_name="shadow") == MUJOCO[0]


def test_a_number_that_no_hand_has_shows_both_lists(load: Callable[..., Hand]):
    message = refusal(MUJOCO, 9, None)
    assert_names(message, "9", "shadow", "22", ", ".join(SHADOW_FINGERS + SHADOW_THUMB))
    hand = load("leap")
    message = refusal(MUJOCO, 22, hand)
    assert_names(message, "22", "'leap'", ", ".join(hand.joint_names), "16", "1, 0, 2")


def test_names_in_the_file_count_whatever_their_order(load: Callable[..., Hand]):
    names = [f"rh_{name}" for name in sorted(MUJOCO[0].joints)]
    layout = layout_of(SOURCE, MUJOCO, 22, None, names=names)
    assert layout.joints == tuple(sorted(MUJOCO[0].joints))
    assert layout.base_pose == MUJOCO[0].base_pose
    names = [f"joint_{name}" for name in LEAP]
    assert layout_of(SOURCE, MUJOCO, 16, load("leap"), names=names) == MUJOCO[2]


def test_names_that_the_hand_lacks_are_refused_with_both_lists(load: Callable[..., Hand]):
    names = ["THUMB", *MUJOCO[0].joints[1:]]
    hand = load("shadow")
    message = refusal(MUJOCO, 22, hand, names=names)
    assert_names(message, ", ".join(names), "'shadow'", ", ".join(hand.joint_names))
    assert message.count("THUMB") == 2, "among the names, and as the one that is not known"
    assert_names(refusal(MUJOCO, 22, None, names=names), *(", ".join(layout.joints) for layout in MUJOCO))
    assert_names(refusal(MUJOCO, 22, None, names=names[:5]), "22", "5", ", ".join(names[:5]))
    assert_names(refusal(MUJOCO, 2, None, names=["a", "a"]), "2", "1", "a, a")
