"""Hands as URDF files: made, seen and measured like any hand."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from random import Random

import numpy as np

from fuzz.reader import Reader, plain, written
from fuzz.xml import changed_numbers, changed_xml
from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine.hands.files.description import joints_fixed_and_mimicking, links_with_visuals
from grasp_refine.hands.files.visuals import load_visuals
from grasp_refine.hands.hand import Hand, load_hand

CUBE = """v 0 0 0\nv .02 0 0\nv .02 .02 0\nv 0 .02 0\nv 0 0 .02\nv .02 0 .02\nv .02 .02 .02\nv 0 .02 .02
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"""

HAND = """<?xml version="1.0"?>
<robot name="claw">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="palm">
    <inertial><mass value="0.3"/><origin xyz="0 0 0.01" rpy="0 0.1 0"/>
      <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="2e-4"/></inertial>
    <visual><origin xyz="0 0 0"/><geometry><box size="0.08 0.04 0.02"/></geometry><material name="grey"/></visual>
    <collision><origin xyz="0 0 0" rpy="0 0 0"/><geometry><box size="0.08 0.04 0.02"/></geometry></collision>
  </link>
  <link name="left"><collision><geometry><mesh filename="meshes/cube.obj" scale="1 1 2"/></geometry></collision>
    <visual><geometry><mesh filename="package://claw/meshes/cube.obj"/></geometry></visual></link>
  <link name="left_tip"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <link name="right"><collision><geometry><cylinder radius="0.01" length="0.04"/></geometry></collision></link>
  <link name="frame"/>
  <joint name="close" type="revolute"><parent link="palm"/><child link="left"/><origin xyz="0.03 0 0.01" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-0.5" upper="1.2" effort="2" velocity="3"/></joint>
  <joint name="bend" type="revolute"><parent link="left"/><child link="left_tip"/><origin xyz="0 0 0.04"/>
    <axis xyz="0 1 0"/><limit lower="-0.6" upper="1.3"/><mimic joint="close" multiplier="0.9" offset="0.01"/></joint>
  <joint name="slide" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="-0.03 0 0.03"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.02" effort="10"/></joint>
  <joint name="fixed" type="fixed"><parent link="palm"/><child link="frame"/></joint>
</robot>
"""

ARM = """<robot name="arm"><link name="world"/><link name="base"/><link name="wrist"/>
<link name="palm"><collision><geometry><box size=".1 .1 .02"/></geometry></collision></link>
<link name="a"><collision><geometry><box size=".02 .02 .05"/></geometry></collision></link>
<link name="b"><collision><geometry><box size=".02 .02 .05"/></geometry></collision></link>
<joint name="fix" type="fixed"><parent link="world"/><child link="base"/></joint>
<joint name="turn" type="continuous"><parent link="base"/><child link="wrist"/><axis xyz="0 0 1"/></joint>
<joint name="flange" type="fixed"><parent link="wrist"/><child link="palm"/></joint>
<joint name="fa" type="revolute"><parent link="palm"/><child link="a"/><limit lower="0" upper="1"/></joint>
<joint name="fb" type="continuous"><parent link="palm"/><child link="b"/><mimic joint="fa" multiplier="-1"/></joint>
</robot>"""

WORDS = tuple(
    b"<robot> </robot> <link <joint name= type= <mimic <mesh filename= <!DOCTYPE <!ENTITY &x; <![CDATA[ ]]> <?xml ?> "
    b"xmlns:xacro= <xacro:macro &#10; &#0; &#x9b; floating planar continuous <!-- -->".split()
)
NAMES = ("palm", "left", "close", "bend", "", "a\nb", "x" * 300, "\x9b2J", "../outside/secret.stl", "\u202e")
FILES = ("meshes/cube.obj", "../outside/secret.stl", "/etc/passwd", "file:///etc/passwd", "a" * 300)
FILES += (
    "package://x/y.stl",
    "http://127.0.0.1:9/x.stl",
    "meshes",
    "",
    "package://",
    "file://",
    "x/" * 3000,
    "/dev/zero",
)


def seeds() -> list[tuple[str, bytes]]:
    """A claw with everything in it, and one on an arm."""
    return [("claw.urdf", HAND.encode()), ("arm.urdf", ARM.encode())]


def prepare(folder: Path) -> None:
    """The meshes."""
    written(folder, {"meshes/cube.obj": CUBE})


def attribute(random: Random, key: str, value: str) -> str:
    """Return a changed value of an attribute."""
    if key in ("name", "link", "joint", "type"):
        return random.choice((*NAMES, "revolute", "fixed", "prismatic", "continuous", "floating"))
    return random.choice(FILES) if key == "filename" else changed_numbers(random, value)


change = changed_xml(attribute, "robot", "link")


def read(path: Path) -> Hashable:
    """The hand, what it shows, and words about it."""
    hand = load_hand(path, candidates=16, hull_limit=math.inf)
    check(hand)
    said: list[str] = []
    shown = load_visuals(path, [link.name for link in hand.links], said.append)
    assert all(np.isfinite(visual.mesh.vertices).all() for visual in shown)
    for line in said:
        plain(line)
    return (
        len(hand.links),
        len(hand.joints),
        len(shown),
        len(links_with_visuals(path)),
        len(joints_fixed_and_mimicking(path)),
    )


def check(hand: Hand) -> None:
    """A hand that came out is one that the rest of the program can use."""
    n = len(hand.joint_names)
    assert hand.lower.shape == hand.upper.shape == hand.rest.shape == (n,)
    assert (hand.lower <= hand.rest).all() and (hand.rest <= hand.upper).all() and np.isfinite(hand.rest).all()
    matrix, offset, _ = hand.mimic_map()
    assert np.isfinite(matrix).all() and np.isfinite(offset).all()
    for joint in hand.joints:
        assert np.isfinite(joint.T_parent_child).all() and np.isfinite(joint.axis).all(), joint.name
    for link in hand.links:
        assert link.mass is None or np.isfinite(link.mass)
        assert link.inertia is None or np.isfinite(link.inertia.matrix).all()
        if link.body is not None:
            for piece in link.body.pieces:
                assert np.isfinite(piece.vertices).all() and np.isfinite(piece.radius)
    for text in (hand.name, hand.base_link, *hand.joint_names, *hand.notes, *(link.name for link in hand.links)):
        plain(text)
    for actuator in (hand.actuator.kp, hand.actuator.damping, hand.actuator.armature, hand.actuator.frictionloss):
        assert np.isfinite(actuator).all() and (actuator >= 0).all()


def meshes_anywhere(path: Path) -> bool:
    """A URDF may name meshes in other folders, as those of ROS do; what else it names is not opened."""
    return path.suffix.lower() in (*SUFFIXES, ".dae")


READER = Reader("urdf", seeds, read, change, WORDS, prepare, beyond=meshes_anywhere)
