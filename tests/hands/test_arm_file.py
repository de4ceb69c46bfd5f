"""Arms whose files come with a gripper: it is cut off, and the hand is mounted in its place."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import HandError
from grasp_refine.hands.arm_file import load_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from made_hands import joint, link, slide, solid, write_urdf


def bar(name: str, length: float) -> str:
    return link(name, solid(f"box 0.05 0.05 {length}"))


OPENS = {"at": "0 0 0.06", "limits": (0, 0.04), "effort": 20, "velocity": 0.1}
GRIPPER = (
    bar("palm", 0.04) + bar("left", 0.06) + bar("right", 0.06) + bar("camera", 0.02) + link("tcp"),
    joint("to_palm", "flange", "palm", "fixed", at="0 0 0.03"),
    joint("to_camera", "palm", "camera", "fixed", at="0.1 0 0"),
    joint("to_tcp", "palm", "tcp", "fixed", at="0 0 0.1"),
    slide("left_slide", "palm", "left", axis="0 1 0", **OPENS),
    slide("right_slide", "palm", "right", axis="0 -1 0", follow=("left_slide",), **OPENS),
)
ARM = (
    bar("stand", 0.1) + bar("upper", 0.3) + link("flange"),
    joint("turn", "stand", "upper", at="0 0 0.3", axis="0 1 0", limits=(-1, 2), effort=50),
    joint("to_flange", "upper", "flange", "fixed", at="0 0 0.3"),
)


def files(folder: Path) -> tuple[Path, Path]:
    """Return the file of an arm with a gripper, and that of the arm alone."""
    return write_urdf(folder, *ARM, *GRIPPER, name="with_gripper"), write_urdf(folder, *ARM, name="alone")


@pytest.fixture(scope="module")
def hand() -> Hand:
    """Return a hand whose file names no flange."""
    return load_hand("franka_hand", candidates=16)


def test_gripper_of_an_arm_is_cut_off(tmp_path: Path, hand: Hand) -> None:
    """Links, joints and the pose of the mounted hand are those with the file of the arm alone; a note says so."""
    with_gripper, alone = files(tmp_path)
    whole, expected = (mount(load_arm(file, candidates=16), hand) for file in (with_gripper, alone))
    assert whole.joint_names == expected.joint_names and set(whole.links_by_name) == set(expected.links_by_name)
    np.testing.assert_array_equal(whole.actuator.kp, expected.actuator.kp)
    q, T = whole.rest[None], np.eye(4)[None]
    poses = [Chain(one, [hand.base_link])(T, q).T_world_link for one in (whole, expected)]
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-12)
    cut = [note for note in whole.notes if "cut off" in note]
    assert len(cut) == 1 and "'palm'" in cut[0] and "'flange'" in cut[0] and "5 links" in cut[0]
    assert not any("left_slide" in note for note in whole.notes)
    assert not any("cut off" in note for note in expected.notes)
    assert mount(load_arm(with_gripper, candidates=16), hand, "flange").palm == hand.base_link


def test_link_above_the_gripper_is_found_by_load_arm(tmp_path: Path, hand: Hand) -> None:
    """An arm that was read as the gripper at its end has no flange, and the message says what reads it."""
    with pytest.raises(HandError, match=r"flange.*load_arm"):
        mount(load_hand(files(tmp_path)[0], candidates=16), hand, "flange")


def test_hand_without_a_flange_is_mounted_with_a_note(hand: Hand) -> None:
    """The note names the hand and both links; none where a pose, or a flange, is given."""
    arm = load_arm("ur5e", candidates=16)
    (note,) = (note for note in mount(arm, hand).notes if "flange" in note)
    assert hand.name in note and hand.base_link in note and "tool0" in note
    assert not any("flange" in note for note in mount(arm, hand, None, np.eye(4)).notes)
    assert not any("flange" in note for note in mount(arm, load_hand("allegro", candidates=16)).notes)
