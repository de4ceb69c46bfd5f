"""A hand of round fingertips around a small object, for which contact kinematics is exact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.scene import Scene
from made_hands import joint, link, links, made_hand, slide, solid

NONE = np.zeros((0, 3), dtype=int)

LIMITS = {"limits": (-1, 1), "effort": 3}
SHORT = {"limits": (-0.02, 0.02), "effort": 3}
PARTS = (
    link("palm", solid("sphere 0.02", "0 0 -0.2")),
    links("knuckle", "joint", "hook", "arm"),
    link("index", solid("sphere 0.012", "0 0 0.05")),
    link("ring", solid("sphere 0.009", "0 0 0.04")),
    link("thumb", solid("sphere 0.015", "0 0 0.03")),
    link("side", solid("sphere 0.01")),
    joint("I2", "palm", "knuckle", at="0.05 0 -0.06", axis="0 1 0", **LIMITS),
    joint("I1", "knuckle", "index", at="0 0 0.02", rpy="0.2 -0.1 0", axis="0.3 1 0", **LIMITS),
    joint("R3", "palm", "arm", at="-0.03 0.04 -0.07", axis="0 0 1", **LIMITS),
    joint("R2", "arm", "joint", at="0 0 0.02", axis="1 0.2 0", **LIMITS),
    joint("R1", "joint", "ring", at="0 0 0.02", axis="1 0 0.1", **LIMITS),
    slide("T2", "palm", "hook", at="-0.03 -0.04 -0.03", rpy="0.3 0 0.2", axis="0.5 1 0", **SHORT),
    joint("T1", "hook", "thumb", at="0 0 0", axis="1 -0.5 0", follow=("T2", -12, 0.05), **LIMITS),
    slide("S1", "arm", "side", at="0.03 0.01 0.075", axis="0 1 0.3", **SHORT),
)
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
    contacts = "\n".join(f'[[contact]]\nlink = "{tip}"\ngroup = "{tip}"\n' for tip in TIPS)
    hand = made_hand(folder, *PARTS, name="claw", toml=contacts + COUPLED * coupled, candidates=64)
    ends = np.array([[0.0, 0.0, 0.035], [0.003, -0.002, 0.06]])
    capsule = build_body("index", [Piece(ends, NONE, 0.012)], candidates=64)
    links = tuple(replace(link, body=capsule) if link.name == "index" else link for link in hand.links)
    return replace(hand, links=links)


def capsule() -> Object:
    """A capsule that leans, 2 cm between the centres of its caps."""
    ends = np.array([[-0.004, 0.003, -0.01], [0.004, -0.003, 0.01]])
    mesh = trimesh.creation.capsule(height=0.02, radius=0.025)
    mesh.apply_translation(-mesh.center_mass)
    return Object("capsule", mesh, convex=True, supplied=(Piece(ends, NONE, 0.025),), candidates=64)


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
