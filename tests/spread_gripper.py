"""A gripper of three fingers, two of which spread together: 8 joints, of which 4 are independent."""

from pathlib import Path

from grasp_refine.hands.hand import Hand
from made_hands import inertial, joint, link, made_hand, solid

INDEPENDENT = ("spread", "finger_1_a", "finger_2_a", "finger_3_a")

FOLLOWERS = {
    "spread_mirror": ("spread", -1.0, 0.0),
    "finger_1_b": ("finger_1_a", 0.4, 0.2),
    "finger_2_b": ("finger_2_a", 0.4, 0.2),
    "finger_3_b": ("finger_3_a", 0.4, 0.2),
}
"""Mimic joint -> what it follows, multiplier and offset."""

LIMITS = {"spread": (0.0, 1.4), "spread_mirror": (-1.2, 0.0)}
"""The follower lets the spread go to 1.2 only."""


def spread_gripper(folder: Path, *, arm: bool = False) -> Hand:
    """The gripper: fingers along z around a round palm, they bend inwards.

    Args:
        folder: Where its file is written.
        arm: Whether it is at the end of an arm of two joints, with a camera.
    """
    parts = []
    if arm:
        parts += [
            link("stand", solid("box 0.1 0.1 0.02")),
            link("upper", solid("box 0.04 0.04 0.3", (0, 0, 0.15))),
            link("flange") + link("camera", solid("box 0.02 0.02 0.02")),
            _joint("lift", "prismatic", "stand", "upper", (0, 0, 0.02), (0, 0, 1), (0, 0.2)),
            _joint("wrist", "continuous", "upper", "flange", (0, 0, 0.31), (0, 0, 1), (0, 0)),
            _joint("screw", "fixed", "flange", "palm", (0, 0, 0.02), (0, 0, 1), (0, 0)),
            _joint("mount", "fixed", "flange", "camera", (0.06, 0, 0), (0, 0, 1), (0, 0)),
        ]
    parts.append(link("palm", solid("cylinder 0.045 0.02", (0, 0, -0.01))))
    for number, (x, y) in enumerate(((0.03, 0.025), (0.03, -0.025), (-0.034, 0.0)), 1):
        carrier, place = "palm", (x, y, 0.0)
        if number < 3:
            carrier, spread = f"finger_{number}_base", "spread" if number == 1 else "spread_mirror"
            parts.append(link(carrier))
            parts.append(_joint(spread, "revolute", "palm", carrier, place, (0, 0, 1), LIMITS[spread]))
            place = (0.0, 0.0, 0.0)
        turn = -1 if number < 3 else 1
        for bone, parent, at, limits in (
            ("a", carrier, (*place[:2], 0.008), (-0.3, 1.3)),
            ("b", f"finger_{number}_a", (0, 0, 0.055), (0.0, 0.8)),
        ):
            name = f"finger_{number}_{bone}"
            length = 0.055 if bone == "a" else 0.04
            pad = solid("sphere 0.01", (0, 0, length)) if bone == "b" else ""
            rod = solid(f"box 0.014 0.016 {length}", (0, 0, length / 2))
            parts.append(link(name, rod, pad, inertial(0.03, (8e-6, 8e-6, 4e-6), (0, 0, length / 2))))
            parts.append(_joint(name, "revolute", parent, name, at, (0, turn, 0), limits))
    return made_hand(folder, *parts, name="gripper", candidates=256)


def _joint(name: str, kind: str, parent: str, child: str, at: tuple, axis: tuple, limits: tuple) -> str:
    return joint(
        name, parent, child, kind, at=at, axis=axis, limits=limits, effort=5, velocity=3, follow=FOLLOWERS.get(name)
    )
