"""URDF files as elements: what is read, what is left out, and what a malformed file says."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.shape import Primitive
from grasp_refine.hands.files.urdf import read_urdf
from grasp_refine.hands.files.urdf_tree import urdf_tree
from grasp_refine.scene.scene import MAX_MAGNITUDE
from refusals import assert_names, refused
from running_processes import PATIENCE_S

JOINT = '<joint name="a" type="revolute"><parent link="base"/><child link="tip"/>{}</joint>'
SHAPES = "box, cylinder, sphere, mesh"


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
    tree = urdf_tree(write(tmp_path, '<?xml version="1.0" encoding="utf-8"?>' + text))
    tip = tree.links["tip"]
    assert list(tree.links) == ["base", "tip"] and tip.mass == 0.5
    np.testing.assert_array_equal(tip.inertia.matrix, [[2, 0, 0], [0, 3, -1], [0, -1, 4]])
    np.testing.assert_array_equal(tip.inertia.centre, [1, 0, 0])
    [box] = tip.collisions
    assert box.geometry == Primitive("box", (1.0, 2.0, 3.0))
    np.testing.assert_array_equal(box.T_link_shape[:3, 3], [0.1, 0.2, 0.3])
    joint = tree.joints["a"]
    np.testing.assert_array_equal(joint.axis, [0, 0, 2])
    assert (joint.lower, joint.upper, joint.effort, joint.velocity) == (-1.0, 1.0, 3.0, None)


def test_roll_pitch_yaw_is_about_fixed_axes(tmp_path: Path) -> None:
    text = robot('<origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/><limit lower="0" upper="1"/>')
    (cr, cp, cy), (sr, sp, sy) = np.cos([0.3, -0.4, 0.5]), np.sin([0.3, -0.4, 0.5])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    origin = urdf_tree(write(tmp_path, text)).joints["a"].T_parent_child
    np.testing.assert_allclose(origin[:3, :3], about_z @ about_y @ about_x, atol=1e-15)
    np.testing.assert_array_equal(origin[:3, 3], [1, 2, 3])


def test_elements_of_drake_need_no_declared_prefix(tmp_path: Path) -> None:
    drake = '<drake:collision_filter_group name="g"><drake:member link="tip"/></drake:collision_filter_group>'
    tree = urdf_tree(write(tmp_path, robot().replace("</robot>", drake + "</robot>")))
    assert list(tree.links) == ["base", "tip"]
    with refused(HandError, "hand.urdf", "not XML", "robot", "line 1"):
        read_urdf(write(tmp_path, robot().replace("</robot>", drake)))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with refused(HandError, "none.urdf", "No such file or directory"):
        read_urdf(tmp_path / "none.urdf")


def shape(text: str) -> str:
    return robot(link=f"<collision><geometry>{text}</geometry></collision>")


def inertial(text: str) -> str:
    return robot(link=f'<inertial><mass value="1"/>{text}</inertial>')


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ("XML",)),
        ("hand", ("XML", "Start tag expected")),
        ('<robot name="r"><link name="a">', ("XML",)),
        (b"\xff\xfe\x00garbage", ("XML",)),
        (b"<robot>\x00</robot>", ("XML", "Invalid character: Char 0x0 out of allowed range")),
        ('<mujoco model="r"/>', ("URDF", "<mujoco>", "<robot>")),
        ('<robot xmlns:xacro="http://ros.org/xacro"><xacro:finger/></robot>', ("xacro hand.urdf",)),
        ("<robot><link/></robot>", ("<link>", "'name'")),
        ('<robot><link name="a&#10;b"/></robot>', ("'a b'", '<link name="a b">')),
        ('<robot><link name="\x9b2J"/></robot>', ('<link name="\\x9b2J">',)),
        ('<robot><joint name="a"/></robot>', ("'a'", "<joint>", "'type'")),
        ('<robot><joint name="a" type="fixed"><child link="x"/></joint></robot>', ("'a'", "<joint>", "<parent>")),
        ('<robot><joint name="a" type="fixed"><parent link="x"/></joint></robot>', ("'a'", "<joint>", "<child>")),
        ('<robot><joint name="a" type="fixed"><parent/><child/></joint></robot>', ("'a'", "<parent>", "'link'")),
        (robot('<axis xyz="0 0 x"/>'), ("'a'", '<axis xyz="0 0 x">', "3")),
        (robot('<axis xyz="0 1"/>'), ("'a'", '<axis xyz="0 1">', "3")),
        (robot('<origin xyz="0 nan 0"/>'), ("'a'", '<origin xyz="0 nan 0">', "3")),
        (robot('<origin xyz="0 1e300 0"/>'), ("'a'", '<origin xyz="0 1e300 0">', "1000 m")),
        (robot('<origin rpy="0 0 inf"/>'), ("'a'", '<origin rpy="0 0 inf">', "3")),
        (robot('<limit lower="-inf" upper="1"/>'), ("'a'", '<limit lower="-inf">')),
        (robot('<limit lower="1_0" upper="20"/>'), ("'a'", '<limit lower="1_0">')),
        (robot('<limit lower="0" upper="${pi}"/>'), ('<limit upper="${pi}">',)),
        (robot('<mimic multiplier="1"/>'), ("'a'", "<mimic>", "'joint'")),
        (robot('<mimic joint="b" offset="1 2"/>'), ('<mimic offset="1 2">',)),
        (robot(link='<inertial><mass value="heavy"/></inertial>'), ("'tip'", '<mass value="heavy">')),
        (inertial('<inertia ixx="nan" iyy="1" izz="1"/>'), ("'tip'", '<inertia ixx="nan">')),
        (inertial('<origin xyz="a b c"/>'), ("'tip'", '<origin xyz="a b c">', "3")),
        (inertial('<inertia ixx="1" iyy="1"/>'), ("'tip'", "<inertia>", "'izz'")),
        (robot(link="<inertial><mass/></inertial>"), ("'tip'", "<mass>", "'value'")),
        (robot(link="<collision/>"), ("'tip'", "<collision>", "<geometry>")),
        (shape(""), ("'tip'", "<geometry>", SHAPES)),
        (shape('<capsule radius="1"/>'), ("'tip'", "<geometry>", "<capsule>", SHAPES)),
        (shape('<sphere radius="1"/><sphere radius="2"/>'), ("'tip'", "<geometry>", "<sphere>, <sphere>", SHAPES)),
        (shape("<box/>"), ("'tip'", "<box>", "'size'")),
        (shape('<cylinder radius="1"/>'), ("'tip'", "<cylinder>", "'length'")),
        (shape("<sphere/>"), ("<sphere>", "'radius'")),
        (shape("<mesh/>"), ("<mesh>", "'filename'")),
        (shape('<mesh filename="m.stl" scale="1 2"/>'), ('<mesh scale="1 2">', "1 or 3")),
    ],
)
def test_malformed_files_say_what_is_wrong_in_one_line(tmp_path: Path, text: str | bytes, named: tuple[str, ...]):
    with refused(HandError, "hand.urdf", *named):
        read_urdf(write(tmp_path, text))


@pytest.mark.parametrize("none", ["1e16", "1e300"])
def test_limits_that_stand_for_none_are_as_large_as_joint_values_can_be(tmp_path: Path, none: str) -> None:
    text = robot(f'<limit lower="-{none}" upper="{none}"/>')
    joint = urdf_tree(write(tmp_path, text)).joints["a"]
    assert (joint.lower, joint.upper) == (-MAX_MAGNITUDE, MAX_MAGNITUDE)


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
    told: list[str] = []

    def read() -> None:
        try:
            read_urdf(path)
        except HandError as error:
            told.append(str(error))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(timeout=PATIENCE_S)
    assert not reader.is_alive(), "the pipe was opened"
    assert len(told) == 1
    assert_names(told[0], "DOCTYPE")


@pytest.mark.parametrize(("tag", "count"), [("link", 1001), ("joint", 1002)])
def test_more_links_or_joints_than_a_hand_can_have_are_refused_before_any_is_read(
    tmp_path: Path, tag: str, count: int
) -> None:
    """A URDF of 20,000 links once kept `hands --check` busy for minutes; these have no names, which nobody sees."""
    path = write(tmp_path, f"<robot name='r'>{f'<{tag}/>' * count}</robot>")
    with refused(HandError, "hand.urdf", f"{count} {tag}s", "1000"):
        read_urdf(path)
    links = "".join(f"<link name='{number}'/>" for number in range(1000))
    path = write(tmp_path, f"<robot name='r'>{links}</robot>")
    assert len(read_urdf(path).findall("link")) == 1000
