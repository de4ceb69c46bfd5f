"""hand.toml: every key, and every way to get one wrong."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.description.hand_toml import Contact, Coupled, HandToml, read_hand_toml
from grasp_refine.errors import HandError


def read(folder: Path, text: str, *files: str) -> HandToml:
    for name in files or ("hand.urdf",):
        (folder / name).touch()
    path = folder / "hand.toml"
    path.write_text(text)
    return read_hand_toml(path)


def test_an_empty_file_names_the_only_urdf(tmp_path: Path) -> None:
    assert read(tmp_path, "") == HandToml(tmp_path / "hand.toml", tmp_path / "hand.urdf")


def test_every_key(tmp_path: Path) -> None:
    text = """
    urdf = "a.urdf"
    base_link = "palm"
    mjcf = "a.xml"
    collision = "mjcf"
    mjcf_joints = { J1 = "rh_J1" }
    rest_pose = { J1 = 1, J2 = -0.5 }
    actuator = { kp = 3, force_limit = { default = 2.0, J1 = 10.0 } }

    [[contact]]
    link = "tip"
    [[contact]]
    link = "thumb_tip"
    group = "thumb"
    point = [0.0, 0.01, 0]
    normal = [0, 3, 4]

    [[coupled]]
    joints = ["J1", "J2"]
    [[coupled]]
    joints = ["J3", "J4"]
    ratio = [1, -0.5]
    """
    toml = read(tmp_path, text, "a.urdf", "b.urdf", "a.xml")
    assert (toml.urdf, toml.mjcf, toml.base_link) == (tmp_path / "a.urdf", tmp_path / "a.xml", "palm")
    assert (toml.collision, toml.mjcf_joints) == ("mjcf", {"J1": "rh_J1"})
    assert toml.rest_pose == {"J1": 1.0, "J2": -0.5}
    assert toml.contacts[0] == Contact("tip", "tip", None, None)
    assert toml.contacts[1].group == "thumb" and toml.contacts[1].point == (0.0, 0.01, 0.0)
    np.testing.assert_allclose(toml.contacts[1].normal, [0, 0.6, 0.8])
    assert toml.coupled == (Coupled(("J1", "J2"), (1.0, 1.0)), Coupled(("J3", "J4"), (1.0, -0.5)))
    assert toml.actuator == {"kp": {"default": 3.0}, "force_limit": {"default": 2.0, "J1": 10.0}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("urdf = ", r"cannot be read as TOML \(Invalid value"),
        (
            "urfd = 'x'",
            r"unknown key 'urfd'; valid: name, urdf, base_link, mjcf, mjcf_joints, collision, rest_pose, contact, ",
        ),
        ("urdf = 'none.urdf'", r"urdf = 'none.urdf': no such file .*/none.urdf"),
        ("urdf = 1", r"urdf must be a text, got 1"),
        (f"urdf = '{'a' * 300}'", r"urdf = 'a+': no such file"),
        ("x = " + "[" * 5000, r"cannot be read as TOML \(its lists or tables are nested too deep"),
        ("x" + ".a" * 100 + " = 1", r"cannot be read as TOML \(a key has more than 64 parts"),
        ("x = " + "9" * 5000, r"cannot be read as TOML \(Exceeds the limit"),
        ('name = "a\\u001b[2J"', r"name holds letters that no name has: a\\x1b\[2J"),
        ('"a\\nb" = 1', r"unknown key 'a b'; valid"),
        (f"rest_pose = {{J1 = {10**400}}}", r"\[rest_pose\] J1 must be a number, at most 1e\+100, got 10+\.\.\.0+$"),
        (f"rest_pose = {{J1 = 0x{'f' * 9000}}}", r"J1 must be a number, at most 1e\+100, got a whole number of"),
        ("actuator = {kp = 1e200}", r"\[actuator\] kp default must be a number, at most 1e\+100, got 1e\+200"),
        ("base_link = ''", r"base_link must be a text, got ''"),
        ("mjcf = 'none.xml'", r"mjcf = 'none.xml': no such file"),
        ("collision = 'mesh'", r"collision = 'mesh'; valid: 'urdf', 'mjcf'"),
        ("mjcf_joints = 'x'", r"\[mjcf_joints\] must be a table, got 'x'"),
        ("mjcf_joints = {J1 = 1}", r"\[mjcf_joints\] J1 must be a text, got 1"),
        ("rest_pose = 1", r"\[rest_pose\] must be a table, got 1"),
        ("rest_pose = {J1 = 'x'}", r"\[rest_pose\] J1 must be a number, at most 1e\+100, got 'x'"),
        ("rest_pose = {J1 = nan}", r"\[rest_pose\] J1 must be a number, at most 1e\+100, got nan"),
        ("rest_pose = {J1 = true}", r"\[rest_pose\] J1 must be a number, at most 1e\+100, got True"),
        ("contact = {link = 'a'}", r"\[\[contact\]\] must be a list, got"),
        ("contact = ['a']", r"\[\[contact\]\] 1 must be a table, got 'a'"),
        ("contact = [{link = 'a'}, {group = 'a'}]", r"\[\[contact\]\] 2 link must be a text, got None"),
        (
            "contact = [{lnk = 'a'}]",
            r"\[\[contact\]\] 1: unknown key 'lnk'; valid: link, group, point, normal",
        ),
        ("contact = [{link = 'a', point = [1, 2]}]", r"\[\[contact\]\] 1 point must hold 3 numbers, got 2"),
        ("contact = [{link = 'a', point = 1}]", r"\[\[contact\]\] 1 point must be a list, got 1"),
        ("contact = [{link = 'a', normal = [0, 0, 0]}]", r"\[\[contact\]\] 1 normal has no direction"),
        ("coupled = [{joints = ['a']}]", r"\[\[coupled\]\] 1 needs two or more different joints"),
        ("coupled = [{joints = ['a', 'a']}]", r"\[\[coupled\]\] 1 needs two or more different joints"),
        ("coupled = [{joints = ['a', 'b'], ratio = [1]}]", r"and for each a ratio other than 0"),
        ("coupled = [{joints = ['a', 'b'], ratio = [1, 0]}]", r"and for each a ratio other than 0"),
        ("coupled = [{joint = ['a', 'b']}]", r"unknown key 'joint'; valid: joints, ratio"),
        (
            "actuator = {kd = 1}",
            r"\[actuator\]: unknown key 'kd'; valid: kp, force_limit, damping, armature, frict",
        ),
        ("actuator = {kp = -1}", r"\[actuator\] kp: must not be negative, got -1"),
        ("actuator = {kp = {J1 = 'x'}}", r"\[actuator\] kp J1 must be a number, at most 1e\+100, got 'x'"),
    ],
)
def test_mistakes_are_named_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(HandError, match=f"hand.toml.*{message}") as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_the_urdf_must_be_clear(tmp_path: Path) -> None:
    with pytest.raises(
        HandError, match=r"one .urdf file is needed, or a hand.toml that names one; here: a.urdf, b.urdf"
    ):
        read(tmp_path, "", "a.urdf", "b.urdf")


def test_without_a_urdf_beside_it_the_user_has_to_give_one(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text("base_link = 'palm'")
    assert read_hand_toml(path) == HandToml(path, None, base_link="palm")
