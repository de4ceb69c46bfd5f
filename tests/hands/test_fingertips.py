"""Contact links that the program chooses: fingertips, and neither sensors on phalanges nor bars of linkages."""

from pathlib import Path

import numpy as np
import pytest

from bar_gripper import bar_gripper
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.linkages.pins import pinned_links
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from made_hands import BALL, joint, link, links, made_hand, solid

FINGER = (
    joint("j1", "palm", "proximal", at="0 0 0.05", axis="0 1 0", limits=(0, 1.5), velocity=None),
    joint("j2", "proximal", "distal", at="0 0 0.05", axis="0 1 0", limits=(0, 1.5), velocity=None),
    joint("f1", "palm", "palm_sensor", "fixed", at="0.02 0 0"),
    joint("f2", "proximal", "phalanx_sensor", "fixed", at="0.02 0 0"),
    joint("f3", "distal", "pad", "fixed", at="0.02 0 0"),
    joint("f4", "distal", "nail", "fixed", at="-0.02 0 0"),
)
FINGER_LINKS = ("palm", "proximal", "distal", "palm_sensor", "phalanx_sensor", "pad", "nail")


def test_sensors_on_phalanges_are_no_fingertips_and_what_is_fixed_together_is_one(tmp_path: Path) -> None:
    hand = made_hand(tmp_path, links(*FINGER_LINKS, inside=BALL), *FINGER)
    assert [contact.link for contact in hand.contacts] == ["distal", "pad", "nail"]
    assert len(hand.fingers) == 1


@pytest.fixture
def gripper(tmp_path: Path) -> Hand:
    return bar_gripper(tmp_path)


def test_bars_that_are_pinned_to_fingers_are_none(gripper: Hand) -> None:
    assert {contact.link for contact in gripper.contacts} == {"left_finger", "left_pad", "right_finger", "right_pad"}
    assert len(gripper.fingers) == 2
    bodies = {link.name: link.body for link in gripper.links if link.body is not None}
    pins = pinned_links(gripper.base_link, gripper.joints, gripper.joint_names, bodies)
    assert {tuple(sorted(pair, reverse=True)) for pair in pins} == {
        ("left_pad", "left_inner"),
        ("right_pad", "right_inner"),
    }


@pytest.mark.parametrize(
    ("bar", "why"),
    [
        ({"inner_ratio": 0.8}, "it turns less than the finger's bar, so that no pin could hold"),
        ({"inner_offset_m": 0.01}, "it is aside of the finger"),
    ],
)
def test_bars_that_no_pin_could_join_stay_fingers(tmp_path: Path, bar: dict[str, float], why: str) -> None:
    assert len(bar_gripper(tmp_path, **bar).fingers) == 4, why


@pytest.mark.parametrize("sign", [1, -1])
def test_parallel_jaws_on_bars_close(tmp_path: Path, sign: int) -> None:
    hand = bar_gripper(tmp_path, sign=sign)
    closure = closure_frame(hand)
    assert closure.closing == [sign]
    jaws = jaw_frame(hand, closure)
    assert jaws is not None
    # Bars of 50 mm that turn about pivots 30 mm from the middle, with pads 10 mm inside of their ends.
    angle = sign * jaws.q[:, 0]
    np.testing.assert_allclose(jaws.width, 2 * (0.03 + 0.05 * np.sin(0.5 - angle) - 0.01), atol=1e-6)


def linkage(
    folder: Path, *, pad: str = "pad", bar_parent: str = "finger", bar: str = "bar", bar_m: float = -0.04
) -> Hand:
    """A gripper of two jaws; a bar hangs from the inner end of each finger, or from the palm, and no mimic ties it."""

    def box(z: float, length: float) -> str:
        return solid(f"box 0.01 0.01 {length}", (0, 0, z))

    def pinned(parent: str, child: str, kind: str, x: float, z: float, reach: float) -> str:
        limits = (-reach, reach) if reach else (0, 0)
        return joint(f"{child}_j", parent, child, kind, at=(x, 0, z), axis="0 1 0", limits=limits, effort=5)

    parts = [link("palm", box(-0.01, 0.02))]
    for side, x in (("left", -0.03), ("right", 0.03)):
        lever, finger, tip, rod = f"{side}_lever", f"{side}_finger", f"{side}_{pad}", f"{side}_{bar}"
        parts += [
            link(lever, box(0.03, 0.05)),
            link(finger, box(0.02, 0.03)),
            link(tip, box(0.0, 0.02)),
            link(rod, box(bar_m / 2, abs(bar_m))),
            pinned("palm", lever, "revolute", x, 0.0, 0.8),
            pinned(lever, finger, "revolute", 0.0, 0.06, 0.9),
            pinned(finger, tip, "fixed", 0.0, 0.045, 0.0),
            pinned({"finger": finger, "palm": "palm"}[bar_parent], rod, "continuous", x / 2, 0.005, 0.0),
        ]
    return made_hand(folder, *parts, name="linkage")


def test_bars_that_fold_back_from_fingers_are_none(tmp_path: Path) -> None:
    """A published Robotiq 2F-140 without mimics was gripped with the bars beside its fingers, and lost what it held."""
    hand = linkage(tmp_path)
    assert [contact.link for contact in hand.contacts] == ["left_pad", "right_pad"]
    (note,) = [note for note in hand.notes if "mimic" in note]
    assert "left_bar, right_bar" in note
    # Without a link that is a pad by its name, all that is fixed together at the end of the finger.
    plain = linkage(tmp_path, pad="end")
    assert {contact.link for contact in plain.contacts} == {"left_finger", "left_end", "right_finger", "right_end"}
    assert len(plain.fingers) == 2


def test_what_reaches_farther_than_the_link_that_carries_it_is_the_end(tmp_path: Path) -> None:
    hand = linkage(tmp_path, pad="end", bar_m=0.08)
    assert {contact.link for contact in hand.contacts} == {"left_bar", "right_bar"}


def test_knuckles_of_their_own_are_no_fingers(tmp_path: Path) -> None:
    hand = linkage(tmp_path, bar_parent="palm", bar="inner_knuckle", bar_m=0.04)
    assert {contact.link for contact in hand.contacts} == {"left_finger", "left_pad", "right_finger", "right_pad"}
    assert len(linkage(tmp_path, bar_parent="palm", bar="third", bar_m=0.04).fingers) == 4, "no name says otherwise"
