"""hand.toml beside a URDF, read as the hand that it describes."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path

from fuzz.reader import Reader, plain, written
from fuzz.toml import WORDS, changed_toml, toml
from fuzz.urdfs import CUBE, HAND, check
from grasp_refine.hands.hand import load_hand

WHOLE = {
    "name": "claw",
    "urdf": "claw.urdf",
    "base_link": "palm",
    "mjcf": "claw.xml",
    "mjcf_joints": {"close": "c"},
    "collision": "urdf",
    "rest_pose": {"close": 0.1, "slide": 0},
    "actuator": {"kp": 3, "force_limit": {"default": 2.0, "slide": 20.0}, "damping": 0.1},
    "contact": [
        {"link": "left_tip", "group": "left", "point": [0.0, 0.0, 0.01], "normal": [0, 0, 2]},
        {"link": "right"},
    ],
    "coupled": [{"joints": ["close", "slide"], "ratio": [1, -0.5]}],
}


def seeds() -> list[tuple[str, bytes]]:
    """Everything, and next to nothing."""
    return [("hand.toml", toml(WHOLE)), ("hand.toml", b'urdf = "claw.urdf"\n[[contact]]\nlink = "left_tip"\n')]


def prepare(folder: Path) -> None:
    """What it names."""
    written(folder, {"claw.urdf": HAND, "meshes/cube.obj": CUBE, "claw.xml": "<mujoco/>"})


def read(path: Path) -> Hashable:
    """The hand."""
    hand = load_hand(path, candidates=16, hull_limit=math.inf)
    check(hand)
    for text in (*hand.mjcf_joints.values(), *(contact.group for contact in hand.contacts)):
        plain(text)
    return len(hand.contacts), len(hand.coupled), hand.collision, hand.mjcf is None, hand.contacts_guessed


READER = Reader(
    "hand.toml",
    seeds,
    read,
    changed_toml(("palm", "left", "close", "slide", "bend", "fixed", "claw.urdf", "meshes", "hand.toml", "mjcf")),
    WORDS,
    prepare,
    # A hand.toml is of who uses it: it may name a URDF wherever that lies, of any ending.
    beyond=lambda path: True,
)
