"""hand.toml: every key, and every way to get one wrong."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.hand_toml import Contact, Coupled, HandToml, read_hand_toml
from refusals import refused


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
    assert (toml.file, toml.mjcf, toml.base_link) == (tmp_path / "a.urdf", tmp_path / "a.xml", "palm")
    assert (toml.collision, toml.mjcf_joints) == ("mjcf", {"J1": "rh_J1"})
    assert toml.rest_pose == {"J1": 1.0, "J2": -0.5}
    assert toml.contacts[0] == Contact("tip", "tip", None, None)
    assert toml.contacts[1].group == "thumb" and toml.contacts[1].point == (0.0, 0.01, 0.0)
    np.testing.assert_allclose(toml.contacts[1].normal, [0, 0.6, 0.8])
    assert toml.coupled == (Coupled(("J1", "J2"), (1.0, 1.0)), Coupled(("J3", "J4"), (1.0, -0.5)))
    assert toml.actuator == {"kp": {"default": 3.0}, "force_limit": {"default": 2.0, "J1": 10.0}}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("urdf = ", ("TOML",)),
        (
            "urfd = 'x'",
            ("urfd", "name, urdf, base_link, mjcf, mjcf_joints, collision, patches, rest_pose, contact, "),
        ),
        ("urdf = 'none.urdf'", ("urdf = 'none.urdf'", "/none.urdf")),
        ("urdf = 1", ("urdf", "text", "1")),
        (f"urdf = '{'a' * 300}'", (f"urdf = '{'a' * 20}",)),
        ("x = " + "[" * 5000, ("TOML", "nested")),
        ("x" + ".a" * 100 + " = 1", ("TOML", "64")),
        ("x = " + "9" * 5000, ("TOML", "Exceeds the limit")),
        ('name = "a\\u001b[2J"', ("name", r"a\x1b[2J")),
        ('"a\\nb" = 1', ("'a b'", "name, urdf")),
        (f"rest_pose = {{J1 = {10**400}}}", ("[rest_pose] J1", "number", "1e+100", "1000", "...0")),
        (f"rest_pose = {{J1 = 0x{'f' * 9000}}}", ("J1", "number", "1e+100", "integer")),
        ("actuator = {kp = 1e200}", ("[actuator] kp default", "number", "1e+100", "1e+200")),
        ("base_link = ''", ("base_link", "text", "''")),
        ("mjcf = 'none.xml'", ("mjcf = 'none.xml'",)),
        ("collision = 'mesh'", ("collision = 'mesh'", "'urdf', 'mjcf'")),
        ("patches = 1", ("patches must be", "true or false", "1")),
        ("mjcf_joints = 'x'", ("[mjcf_joints]", "table", "'x'")),
        ("mjcf_joints = {J1 = 1}", ("[mjcf_joints] J1", "text", "1")),
        ("rest_pose = 1", ("[rest_pose]", "table", "1")),
        ("rest_pose = {J1 = 'x'}", ("[rest_pose] J1", "number", "1e+100", "'x'")),
        ("rest_pose = {J1 = nan}", ("[rest_pose] J1", "number", "1e+100", "nan")),
        ("rest_pose = {J1 = true}", ("[rest_pose] J1", "number", "1e+100", "True")),
        ("contact = {link = 'a'}", ("[[contact]]", "list")),
        ("contact = ['a']", ("[[contact]] 1", "table", "'a'")),
        ("contact = [{link = 'a'}, {group = 'a'}]", ("[[contact]] 2 link", "text", "None")),
        ("contact = [{lnk = 'a'}]", ("[[contact]] 1", "lnk", "link, group, point, normal")),
        ("contact = [{link = 'a', point = [1, 2]}]", ("[[contact]] 1 point", "3 numbers", "2")),
        ("contact = [{link = 'a', point = 1}]", ("[[contact]] 1 point", "list", "1")),
        ("contact = [{link = 'a', normal = [0, 0, 0]}]", ("[[contact]] 1 normal",)),
        ("coupled = [{joints = ['a']}]", ("[[coupled]] 1", "joints")),
        ("coupled = [{joints = ['a', 'a']}]", ("[[coupled]] 1", "joints")),
        ("coupled = [{joints = ['a', 'b'], ratio = [1]}]", ("[[coupled]] 1", "ratio")),
        ("coupled = [{joints = ['a', 'b'], ratio = [1, 0]}]", ("[[coupled]] 1", "ratio", "0")),
        ("coupled = [{joint = ['a', 'b']}]", ("'joint'", "joints, ratio")),
        ("actuator = {kd = 1}", ("[actuator]", "kd", "kp, force_limit, damping, armature, frict")),
        ("actuator = {kp = -1}", ("[actuator] kp", "negative", "-1")),
        ("actuator = {kp = {J1 = 'x'}}", ("[actuator] kp J1", "number", "1e+100", "'x'")),
    ],
)
def test_mistakes_are_named_in_one_line(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    with refused(HandError, "hand.toml", *named):
        read(tmp_path, text)


def test_the_urdf_must_be_clear(tmp_path: Path) -> None:
    with refused(HandError, "hand.toml", "a.urdf, b.urdf"):
        read(tmp_path, "", "a.urdf", "b.urdf")


def test_without_a_urdf_beside_it_the_user_has_to_give_one(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text("base_link = 'palm'")
    assert read_hand_toml(path) == HandToml(path, None, base_link="palm")
