"""Where hands begin: at the palm of a hand on an arm, else at the root."""

from pathlib import Path

import pytest

from grasp_refine.hands.files.base_link import Base, guess_base
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.hand import load_hand
from made_hands import BALL, joint, link, write_urdf


def base_of(folder: Path, joints: dict[str, str], empty: str = "", mimic: dict[str, str] | None = None) -> Base:
    """The base of a robot whose joints are "PARENT > CHILD": kind; links named in `empty` have no geometry."""
    pairs = [[link.strip() for link in pair.split(">")] for pair in joints]
    links = dict.fromkeys(link for pair in pairs for link in pair)
    parts = [link(name, "" if name in empty.split() else BALL) for name in links]
    for (parent, child), kind in zip(pairs, joints.values(), strict=True):
        follow = (mimic[child],) if child in (mimic or {}) else None
        parts.append(joint(f"{child}_j", parent, child, kind, axis="0 0 1", limits=(-1, 1), follow=follow))
    return guess_base(read_tree(write_urdf(folder, *parts)))


ARM = {"stand > upper": "revolute", "upper > lower": "continuous", "lower > rail": "prismatic"}
HAND = {"palm > a": "revolute", "palm > b": "revolute", "b > b2": "revolute"}


def test_a_hand_on_an_arm_begins_at_its_palm(tmp_path: Path) -> None:
    base = base_of(tmp_path, {**ARM, "rail > flange": "fixed", "flange > palm": "fixed", **HAND})
    assert (base.link, base.above) == ("palm", ("upper_j", "lower_j", "rail_j"))
    assert base.why == "it is the palm: 2 moving branches leave it, one chain leads to it"


def test_what_is_fixed_to_the_arm_is_no_branch(tmp_path: Path) -> None:
    joints = {**ARM, "upper > camera": "fixed", "rail > lamp": "fixed", "rail > palm": "fixed", **HAND}
    assert base_of(tmp_path, joints).link == "palm"


def test_a_joint_that_carries_nothing_solid_is_no_branch(tmp_path: Path) -> None:
    joints = {**ARM, "upper > pointer": "revolute", "rail > palm": "fixed", **HAND}
    assert base_of(tmp_path, joints, empty="pointer").link == "palm"


def test_a_robot_that_floats_begins_at_its_palm(tmp_path: Path) -> None:
    assert base_of(tmp_path, {"world > palm": "floating", **HAND}, empty="world").above == ("palm_j",)


def test_the_root_stays_where_no_joint_is_above_the_palm(tmp_path: Path) -> None:
    base = base_of(tmp_path, {"world > mount": "fixed", "mount > palm": "fixed", **HAND}, empty="world mount")
    assert (base.link, base.above) == ("world", ())
    assert base.why == "it is the root, and 2 moving branches leave what is fixed to it"


@pytest.mark.parametrize("joints", [ARM, {"a > b": "fixed"}])
def test_a_single_chain_begins_at_its_root(tmp_path: Path, joints: dict[str, str]) -> None:
    base = base_of(tmp_path, joints)
    assert base == Base(next(iter(joints)).split()[0], (), base.why)
    assert "no link further on has two moving branches" in base.why


def test_the_base_is_above_all_fingers_and_carries_the_palm(tmp_path: Path) -> None:
    # Fingers leave two mounts; the palm's mesh is beside the frame that the mounts are fixed to.
    joints = {
        "arm > wrist": "revolute",
        "wrist > shell": "fixed",
        "wrist > frame": "fixed",
        "frame > left": "fixed",
        "frame > right": "fixed",
        "left > a": "revolute",
        "right > b": "revolute",
    }
    assert base_of(tmp_path, joints).link == "frame"
    assert base_of(tmp_path, joints, empty="frame left right").link == "wrist", "or the palm would be nowhere"
    assert base_of(tmp_path, joints, empty="frame left right wrist shell").link == "frame", "there is no palm"


def test_a_palm_that_follows_the_arm_begins_at_the_root(tmp_path: Path) -> None:
    base = base_of(tmp_path, {"arm > palm": "revolute", **HAND}, mimic={"a": "palm_j"})
    assert base == Base("arm", (), "it is the root; joint 'a_j' mimics 'palm_j' above the palm 'palm'")


def test_the_shadow_hand_begins_at_its_palm(shared_assets: Path) -> None:
    base = guess_base(read_tree(shared_assets / "hands/shadow/shadow_right.urdf"))
    assert (base.link, base.above) == ("palm", ("WRJ2", "WRJ1"))


def test_further_palms_are_named(tmp_path: Path):
    """A robot with two arms begins at its root, which is hardly what is meant."""
    pairs = ["torso > {}_palm", "{0}_palm > {0}_thumb", "{0}_palm > {0}_finger"]
    robot = {pair.format(side): "revolute" for side in ("left", "right") for pair in pairs}
    guess = base_of(tmp_path, robot)
    assert guess.link == "torso" and guess.others == ("left_palm", "right_palm")
    (note,) = [note for note in load_hand(tmp_path, candidates=16).notes if "`base_link`" in note]
    assert "several moving branches leave left_palm, right_palm, too" in note
