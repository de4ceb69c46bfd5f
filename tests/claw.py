"""A hand of round fingertips around a small object, for which contact kinematics is exact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.scene import Scene

LIMIT = '<limit lower="-1" upper="1" effort="3" velocity="1"/>'
NONE = np.zeros((0, 3), dtype=int)

URDF = f"""<robot name="claw">
  <link name="palm"><collision><origin xyz="0 0 -0.2"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <link name="knuckle"/><link name="joint"/><link name="hook"/><link name="arm"/>
  <link name="index"><collision><origin xyz="0 0 0.05"/><geometry><sphere radius="0.012"/></geometry></collision></link>
  <link name="ring"><collision><origin xyz="0 0 0.04"/><geometry><sphere radius="0.009"/></geometry></collision></link>
  <link name="thumb"><collision><origin xyz="0 0 0.03"/><geometry><sphere radius="0.015"/></geometry></collision></link>
  <link name="side"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <joint name="I2" type="revolute">
    <parent link="palm"/><child link="knuckle"/><origin xyz="0.05 0 -0.06"/><axis xyz="0 1 0"/>{LIMIT}
  </joint>
  <joint name="I1" type="revolute">
    <parent link="knuckle"/><child link="index"/><origin xyz="0 0 0.02" rpy="0.2 -0.1 0"/><axis xyz="0.3 1 0"/>{LIMIT}
  </joint>
  <joint name="R3" type="revolute">
    <parent link="palm"/><child link="arm"/><origin xyz="-0.03 0.04 -0.07"/><axis xyz="0 0 1"/>{LIMIT}
  </joint>
  <joint name="R2" type="revolute">
    <parent link="arm"/><child link="joint"/><origin xyz="0 0 0.02"/><axis xyz="1 0.2 0"/>{LIMIT}
  </joint>
  <joint name="R1" type="revolute">
    <parent link="joint"/><child link="ring"/><origin xyz="0 0 0.02"/><axis xyz="1 0 0.1"/>{LIMIT}
  </joint>
  <joint name="T2" type="prismatic">
    <parent link="palm"/><child link="hook"/><origin xyz="-0.03 -0.04 -0.03" rpy="0.3 0 0.2"/><axis xyz="0.5 1 0"/>
    <limit lower="-0.02" upper="0.02" effort="3" velocity="1"/>
  </joint>
  <joint name="T1" type="revolute">
    <parent link="hook"/><child link="thumb"/><origin xyz="0 0 0"/><axis xyz="1 -0.5 0"/>
    <mimic joint="T2" multiplier="-12" offset="0.05"/>{LIMIT}
  </joint>
  <joint name="S1" type="prismatic">
    <parent link="arm"/><child link="side"/><origin xyz="0.03 0.01 0.075"/><axis xyz="0 1 0.3"/>
    <limit lower="-0.02" upper="0.02" effort="3" velocity="1"/>
  </joint>
</robot>"""
"""Hinges in a row, a slide with a hinge that follows it, and a slide beside two hinges on the same turning arm."""

TIPS = ("index", "ring", "thumb", "side")

COUPLED = """
[[coupled]]
joints = ["I2", "I1"]
ratio = [1.0, 1.0]

[[coupled]]
joints = ["R3", "R2", "R1"]
ratio = [0.5, 1.0, 0.8]
"""
"""Tendons over two hinges and over three."""


def claw(folder: Path, *, coupled: bool = False) -> Hand:
    """The hand, its tips as contacts; the index has a capsule for a tip."""
    (folder / "claw.urdf").write_text(URDF)
    contacts = "\n".join(f'[[contact]]\nlink = "{tip}"\ngroup = "{tip}"\n' for tip in TIPS)
    (folder / "hand.toml").write_text('urdf = "claw.urdf"\n' + contacts + (COUPLED if coupled else ""))
    hand = load_hand(folder, candidates=64)
    ends = np.array([[0.0, 0.0, 0.035], [0.003, -0.002, 0.06]])
    capsule = build_body("index", [Piece(ends, NONE, 0.012)], candidates=64)
    links = tuple(replace(link, body=capsule) if link.name == "index" else link for link in hand.links)
    return replace(hand, links=links)


def capsule() -> Object:
    """A capsule that leans, 2 cm between the centres of its caps."""
    ends = np.array([[-0.004, 0.003, -0.01], [0.004, -0.003, 0.01]])
    mesh = trimesh.creation.capsule(height=0.02, radius=0.025)
    mesh.apply_translation(-mesh.center_mass)
    return Object("capsule", mesh, convex=True, given=(Piece(ends, NONE, 0.025),), candidates=64)


def around(hand: Hand, obj: Object, count: int, seed: int) -> Scene:
    """Random claws near an object of 3 cm, fingers straight but for a little."""
    rng = np.random.default_rng(seed)
    T = exp_se3(rng.normal(size=(count, 6)) * [0.003, 0.003, 0.003, 0.2, 0.2, 0.2])
    q = rng.uniform(-0.15, 0.15, (count, len(hand.joint_names)))
    slides = [hand.joints_by_name[name].kind == "prismatic" for name in hand.joint_names]
    return Scene(hand, obj, T, np.where(slides, 0.05 * q, q))


def objects() -> dict[str, Object]:
    """Objects that contact kinematics knows exactly, while the features stay the same."""
    return {
        "sphere": load_object("sphere:0.03", candidates=64),
        "box": load_object("box:0.055,0.05,0.06", candidates=64),
        "capsule": capsule(),
    }
