"""URDF files as elements: what is read, what is left out, and what a malformed file says."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from running_processes import PATIENCE_S

from grasp_refine.description.urdf import read_urdf
from grasp_refine.errors import HandError

JOINT = '<joint name="a" type="revolute"><parent link="base"/><child link="tip"/>{}</joint>'
COLLISION = "<collision>{}</collision>"


def robot(joint: str = '<limit lower="0" upper="1"/>', link: str = "") -> str:
    return f'<robot name="r"><link name="base"/><link name="tip">{link}</link>{JOINT.format(joint)}</robot>'


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "hand.urdf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_only_what_matters_is_read(tmp_path: Path) -> None:
    link = """<!-- a comment --><visual><geometry><teapot/></geometry></visual>
      <inertial><origin xyz="1,0 0"/><mass value="0.5"/><inertia ixx="2" iyy="3" izz="4" iyz="-1"/><x/></inertial>
      <collision name="c"><origin xyz="0.1, 0.2 0.3"/><geometry><!-- here --><box size="1, 2, 3"/></geometry>
      <contact_coefficients/></collision>"""
    text = robot('<axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="3"/><dynamics damping="x"/>', link)
    text = text.replace("</robot>", '<material name="m"><color rgba="x"/></material><gazebo/></robot>')
    read = read_urdf(write(tmp_path, '<?xml version="1.0" encoding="utf-8"?>' + text))
    tip = read.links[1]
    assert read.name == "r" and [x.name for x in read.links] == ["base", "tip"]
    assert tip.visuals == [] and tip.inertial.mass == 0.5
    np.testing.assert_array_equal(tip.inertial.inertia, [[2, 0, 0], [0, 3, -1], [0, -1, 4]])
    np.testing.assert_array_equal(tip.inertial.origin[:3, 3], [1, 0, 0])
    np.testing.assert_array_equal(tip.collisions[0].geometry.box.size, [1, 2, 3])
    np.testing.assert_array_equal(tip.collisions[0].origin[:3, 3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(read.joints[0].axis, [0, 0, 2])


def test_roll_pitch_yaw_is_about_fixed_axes(tmp_path: Path) -> None:
    text = robot('<origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/><limit lower="0" upper="1"/>')
    (cr, cp, cy), (sr, sp, sy) = np.cos([0.3, -0.4, 0.5]), np.sin([0.3, -0.4, 0.5])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    origin = read_urdf(write(tmp_path, text)).joints[0].origin
    np.testing.assert_allclose(origin[:3, :3], about_z @ about_y @ about_x, atol=1e-15)
    np.testing.assert_array_equal(origin[:3, 3], [1, 2, 3])


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(HandError, match=r"none\.urdf: cannot be read \(No such file or directory\)"):
        read_urdf(tmp_path / "none.urdf")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"not XML"),
        ("hand", r"not XML \(Start tag expected"),
        ('<robot name="r"><link name="a">', r"not XML"),
        (b"\xff\xfe\x00garbage", r"not XML"),
        (b"<robot>\x00</robot>", r"not XML \(Invalid character: Char 0x0 out of allowed range"),
        ('<mujoco model="r"/>', r"not a URDF, its outermost element is <mujoco> instead of <robot>"),
        (
            '<robot xmlns:xacro="http://ros.org/xacro"><xacro:finger/></robot>',
            r"expand them first: xacro hand.urdf",
        ),
        ("<robot><link/></robot>", r"urdf: <link> has no 'name'"),
        ('<robot><link name="a&#10;b"/></robot>', r"link 'a b': <link name=\"a b\"> holds letters that no name has"),
        ('<robot><link name="\x9b2J"/></robot>', r"<link name=\"\\x9b2J\"> holds letters that no name has"),
        (robot('<mimic joint="a&#10;b"/>'), r"<mimic joint=\"a b\"> holds letters that no name has"),
        ('<robot><link name=""/></robot>', r"urdf: <link> has no 'name'"),
        ('<robot><joint type="fixed"/></robot>', r"urdf: <joint> has no 'name'"),
        ('<robot><joint name="a"/></robot>', r"joint 'a': <joint> has no 'type'"),
        (
            '<robot><joint name="a" type="fixed"><child link="x"/></joint></robot>',
            r"joint 'a': <joint> has no <parent>",
        ),
        (
            '<robot><joint name="a" type="fixed"><parent link="x"/></joint></robot>',
            r"joint 'a': <joint> has no <child>",
        ),
        (
            '<robot><joint name="a" type="fixed"><parent/><child/></joint></robot>',
            r"joint 'a': <parent> has no 'link'",
        ),
        (robot('<axis xyz="0 0 x"/>'), r"joint 'a': <axis xyz=\"0 0 x\"> must be 3 finite numbers"),
        (robot('<axis xyz="0 1"/>'), r"joint 'a': <axis xyz=\"0 1\"> must be 3 finite numbers"),
        (robot('<origin xyz="0 nan 0"/>'), r"joint 'a': <origin xyz=\"0 nan 0\"> must be 3 finite numbers"),
        (robot('<origin rpy="0 0 inf"/>'), r"joint 'a': <origin rpy=\"0 0 inf\"> must be 3 finite numbers"),
        (
            robot('<limit lower="-inf" upper="1"/>'),
            r"joint 'a': <limit lower=\"-inf\"> must be a finite number",
        ),
        (robot('<limit lower="0" upper="${pi}"/>'), r"<limit upper=\"\$\{pi\}\"> must be a finite number"),
        (robot('<mimic multiplier="1"/>'), r"joint 'a': <mimic> has no 'joint'"),
        (robot('<mimic joint="b" offset="1 2"/>'), r"<mimic offset=\"1 2\"> must be a finite number"),
        (
            robot(link='<inertial><mass value="heavy"/></inertial>'),
            r"link 'tip': <mass value=\"heavy\"> must be",
        ),
        (
            robot(link='<inertial><mass value="1"/><inertia ixx="nan" iyy="1" izz="1"/></inertial>'),
            r"link 'tip': <inertia ixx=\"nan\"> must be a finite number",
        ),
        (
            robot(link='<inertial><mass value="1"/><origin xyz="a b c"/></inertial>'),
            r"link 'tip': <origin xyz=\"a b c\"> must be 3 finite numbers",
        ),
        (
            robot(link='<inertial><mass value="1"/><inertia ixx="1" iyy="1"/></inertial>'),
            r"link 'tip': <inertia> has no 'izz'",
        ),
        (robot(link="<inertial><mass/></inertial>"), r"link 'tip': <mass> has no 'value'"),
        (robot(link="<collision/>"), r"link 'tip': <collision> has no <geometry>"),
        (
            robot(link="<collision><geometry/></collision>"),
            r"link 'tip': <geometry> holds nothing; it must hold one",
        ),
        (
            robot(link='<collision><geometry><capsule radius="1"/></geometry></collision>'),
            r"link 'tip': <geometry> holds <capsule>; it must hold one of box, cylinder, sphere, mesh",
        ),
        (
            robot(link='<collision><geometry><sphere radius="1"/><sphere radius="2"/></geometry></collision>'),
            r"link 'tip': <geometry> holds <sphere>, <sphere>; it must hold one of",
        ),
        (
            robot(link="<collision><geometry><box/></geometry></collision>"),
            r"link 'tip': <box> has no 'size'",
        ),
        (
            robot(link='<collision><geometry><cylinder radius="1"/></geometry></collision>'),
            r"link 'tip': <cylinder> has no 'length'",
        ),
        (robot(link="<collision><geometry><sphere/></geometry></collision>"), r"<sphere> has no 'radius'"),
        (robot(link="<collision><geometry><mesh/></geometry></collision>"), r"<mesh> has no 'filename'"),
        (
            robot(link='<collision><geometry><mesh filename="m.stl" scale="1 2"/></geometry></collision>'),
            r"<mesh scale=\"1 2\"> must be 1 or 3 finite numbers",
        ),
    ],
)
def test_malformed_files_say_what_is_wrong_in_one_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(HandError, match=message) as caught:
        read_urdf(write(tmp_path, text))
    assert "\n" not in str(caught.value) and "hand.urdf" in str(caught.value)


@pytest.mark.parametrize("kind", ["entity", "parameter entity", "dtd"])
def test_what_a_urdf_points_to_is_not_even_opened(tmp_path: Path, kind: str) -> None:
    """A pipe that nobody writes to would hold up whoever opened it for reading."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    doctype = {
        "entity": f'<!DOCTYPE robot [<!ENTITY e SYSTEM "file://{pipe}">]>',
        "parameter entity": f'<!DOCTYPE robot [<!ENTITY % e SYSTEM "file://{pipe}"> %e;]>',
        "dtd": f'<!DOCTYPE robot SYSTEM "file://{pipe}">',
    }[kind]
    inside = "&e;" if kind == "entity" else ""
    path = tmp_path / "hand.urdf"
    path.write_text(f'{doctype}<robot name="r"><link name="a"/>{inside}</robot>')
    refused: list[str] = []

    def read() -> None:
        try:
            read_urdf(path)
        except HandError as error:
            refused.append(str(error))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(timeout=PATIENCE_S)
    assert not reader.is_alive(), "the pipe was opened"
    assert len(refused) == 1 and "a DOCTYPE is refused, because it can pull in other files" in refused[0]


@pytest.mark.parametrize(("tag", "count"), [("link", 1001), ("joint", 1002)])
def test_more_links_or_joints_than_a_hand_can_have_are_refused_before_any_is_read(
    tmp_path: Path, tag: str, count: int
) -> None:
    """A URDF of 20,000 links once kept `hands --check` busy for minutes; these have no names, which nobody sees."""
    path = write(tmp_path, f"<robot name='r'>{f'<{tag}/>' * count}</robot>")
    with pytest.raises(HandError, match=rf"hand\.urdf: has {count} {tag}s, more than the 1000 "):
        read_urdf(path)
    links = "".join(f"<link name='{number}'/>" for number in range(1000))
    path = write(tmp_path, f"<robot name='r'>{links}</robot>")
    assert len(read_urdf(path).links) == 1000


def test_a_doctype_is_refused_and_no_entity_is_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("do not read")
    doctype = f'<!DOCTYPE robot [<!ENTITY e SYSTEM "file://{secret}">]>'
    text = f'{doctype}<robot name="r"><link name="a">&e;</link></robot>'
    with pytest.raises(HandError, match="a DOCTYPE is refused") as caught:
        read_urdf(write(tmp_path, text))
    assert "do not read" not in str(caught.value)


def test_a_bomb_of_entities_is_refused(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    text = f'<!DOCTYPE robot [<!ENTITY e0 "boom">{entities}]><robot name="&e9;"><link name="a"/></robot>'
    with pytest.raises(HandError, match="DOCTYPE is refused|not XML"):
        read_urdf(write(tmp_path, text))
