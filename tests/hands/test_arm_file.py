"""Arms whose files come with a gripper: it is cut off, and the hand is mounted in its place."""

from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import HandError
from grasp_refine.hands.arm_file import load_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount

BOX = '<collision><geometry><box size="0.05 0.05 {}"/></geometry></collision>'
GRIPPER = f"""
<link name="palm">{BOX.format(0.04)}</link><link name="left">{BOX.format(0.06)}</link>
<link name="right">{BOX.format(0.06)}</link><link name="camera">{BOX.format(0.02)}</link><link name="tcp"/>
<joint name="to_palm" type="fixed"><parent link="flange"/><child link="palm"/><origin xyz="0 0 0.03"/></joint>
<joint name="to_camera" type="fixed"><parent link="palm"/><child link="camera"/><origin xyz="0.1 0 0"/></joint>
<joint name="to_tcp" type="fixed"><parent link="palm"/><child link="tcp"/><origin xyz="0 0 0.1"/></joint>
<joint name="left_slide" type="prismatic"><parent link="palm"/><child link="left"/><origin xyz="0 0 0.06"/>
  <axis xyz="0 1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.1"/></joint>
<joint name="right_slide" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="0 0 0.06"/>
  <axis xyz="0 -1 0"/><limit lower="0" upper="0.04" effort="20" velocity="0.1"/><mimic joint="left_slide"/></joint>
"""
ARM = f"""<robot name="arm">
<link name="stand">{BOX.format(0.1)}</link><link name="upper">{BOX.format(0.3)}</link><link name="flange"/>
<joint name="turn" type="revolute"><parent link="stand"/><child link="upper"/><origin xyz="0 0 0.3"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="50" velocity="1"/></joint>
<joint name="to_flange" type="fixed"><parent link="upper"/><child link="flange"/><origin xyz="0 0 0.3"/></joint>
{{gripper}}</robot>"""


def files(folder: Path) -> tuple[Path, Path]:
    """Return the file of an arm with a gripper, and that of the arm alone."""
    both = folder / "with_gripper.urdf", folder / "alone.urdf"
    for file, gripper in zip(both, (GRIPPER, ""), strict=True):
        file.write_text(ARM.format(gripper=gripper))
    return both


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


def test_arms_without_a_gripper_are_read_as_hands_are(hand: Hand) -> None:
    """Ours has none."""
    arm, same = load_arm("ur5e", candidates=16), load_hand("ur5e", candidates=16)
    assert set(arm.links_by_name) == set(same.links_by_name) and arm.notes == same.notes
    assert gr.load_arm is load_arm


def test_hand_without_a_flange_is_mounted_with_a_note(hand: Hand) -> None:
    """The note names the hand and both links; none where a pose, or a flange, is given."""
    arm = load_arm("ur5e", candidates=16)
    (note,) = (note for note in mount(arm, hand).notes if "flange" in note)
    assert hand.name in note and hand.base_link in note and "tool0" in note
    assert not any("flange" in note for note in mount(arm, hand, None, np.eye(4)).notes)
    assert not any("flange" in note for note in mount(arm, load_hand("allegro", candidates=16)).notes)
