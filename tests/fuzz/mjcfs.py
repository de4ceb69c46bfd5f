"""Hands as MJCF files: compiled by MuJoCo, and measured like any hand."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from random import Random

from fuzz.reader import Reader, written
from fuzz.urdfs import CUBE, FILES, NAMES, check
from fuzz.xml import changed_numbers, changed_xml
from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine.hands.hand import load_hand

HAND = """<mujoco model="claw">
  <compiler angle="radian" meshdir="meshes" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint damping="0.1" armature="0.001"/><geom friction="1 0.005 0.0001"/>
    <default class="tip"><geom type="sphere" size="0.01"/></default></default>
  <asset><mesh name="cube" file="cube.obj" scale="1 1 2"/><material name="grey" rgba="0.5 0.5 0.5 1"/></asset>
  <worldbody><light pos="0 0 1"/><geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="palm" pos="0 0 0.2"><inertial pos="0 0 0.01" mass="0.3" diaginertia="1e-4 1e-4 2e-4"/>
      <geom name="pad" type="box" size="0.04 0.02 0.01" material="grey"/><site name="middle" pos="0 0 0.01"/>
      <body name="left" pos="0.03 0 0.01"><joint name="close" axis="0 1 0" range="-0.5 1.2"/>
        <geom type="mesh" mesh="cube"/>
        <body name="left_tip" pos="0 0 0.04" euler="0 0.1 0"><joint name="bend" axis="0 1 0" range="-0.6 1.3"/>
          <geom class="tip"/></body></body>
      <body name="right" pos="-0.03 0 0.03" quat="1 0 0 0"><joint name="slide" type="slide" axis="1 0 0"
        range="0 0.02"/><geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.01"/></body></body></worldbody>
  <contact><exclude body1="palm" body2="left"/></contact>
  <tendon><fixed name="both"><joint joint="close" coef="1"/><joint joint="bend" coef="-1"/></fixed></tendon>
  <equality><joint joint1="bend" joint2="close" polycoef="0.01 0.9 0 0 0"/></equality>
  <actuator><position name="closer" joint="close" kp="3" ctrlrange="-0.5 1.2" forcerange="-2 2"/>
    <motor name="slider" joint="slide" gear="2" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos joint="close"/></sensor><keyframe><key qpos="0.1 0.1 0"/></keyframe>
</mujoco>
"""

ATTACHED = """<mujoco model="two"><size memory="1M"/><asset>
<texture name="checks" type="2d" builtin="checker" width="8" height="8" rgb1="0 0 0" rgb2="1 1 1"/>
<model name="claw" file="finger.xml"/></asset>
<worldbody><body name="palm"><geom size=".02"/><include file="thumb.xml"/>
<frame pos="0.03 0 0"><attach model="claw" body="finger" prefix="a_"/></frame>
<replicate count="2" euler="0 0 1" offset="0 0.03 0"><body pos="0 0.02 0.03"><joint range="0 1"/>
<geom type="box" size=".01 .01 .02"/></body></replicate></body></worldbody></mujoco>"""

FINGER = """<mujoco><worldbody><body name="finger"><joint name="turn" axis="0 1 0" range="-60 60"/>
<geom type="cylinder" size=".01 .02"/></body></worldbody></mujoco>"""

THUMB = """<mujocoinclude><body name="thumb" pos="-.04 0 .02"><joint name="thumb" type="hinge" range="0 1"/>
<geom type="ellipsoid" size=".01 .01 .02"/></body></mujocoinclude>"""

WORDS = tuple(
    b"<mujoco> </mujoco> <body <joint <geom <include <replicate count= <attach <model <composite <flexcomp <plugin "
    b"<hfield nrow= <skin <default class= childclass= file= meshdir= builtin= <freejoint/> <equality> <tendon> "
    b"<!DOCTYPE <!ENTITY &x; <![CDATA[ ]]> &#10; &#0; nuser_body= maxhullvert= <!-- -->".split()
)
KINDS = ("hinge", "slide", "ball", "free", "mesh", "plane", "hfield", "sdf", "ellipsoid", "box", "fixed", "auto")
KEYS = (
    "name",
    "class",
    "childclass",
    "joint",
    "joint1",
    "joint2",
    "body",
    "body1",
    "body2",
    "mesh",
    "material",
    "type",
)


def seeds() -> list[tuple[str, bytes]]:
    """A claw with elements of all sections, and a hand of several files."""
    return [("claw.xml", HAND.encode()), ("two.mjcf", ATTACHED.encode())]


def prepare(folder: Path) -> None:
    """The meshes and the other models."""
    written(folder, {"meshes/cube.obj": CUBE, "finger.xml": FINGER, "thumb.xml": THUMB})


def attribute(random: Random, key: str, value: str) -> str:
    """Return a changed value of an attribute."""
    if key in KEYS:
        return random.choice((*NAMES, *KINDS))
    return random.choice((*FILES, "finger.xml", "claw.xml")) if key == "file" else changed_numbers(random, value)


def read(path: Path) -> Hashable:
    """The hand, as MuJoCo compiles it."""
    hand = load_hand(path, candidates=16, hull_limit=math.inf)
    check(hand)
    return len(hand.links), len(hand.joints), len(hand.coupled), len(hand.notes)


READER = Reader(
    "mjcf",
    seeds,
    read,
    changed_xml(attribute, "mujoco", "body"),
    WORDS,
    prepare,
    # An MJCF may name meshes and models anywhere, as a URDF may.
    beyond=lambda path: path.suffix.lower() in (*SUFFIXES, ".dae", ".xml", ".mjcf"),
    starts_programs=True,
)
