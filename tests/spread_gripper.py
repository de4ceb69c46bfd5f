"""A gripper of three fingers, two of which spread together: 8 joints, of which 4 are independent."""

from __future__ import annotations

from pathlib import Path

from grasp_refine.hands.hand import Hand, load_hand

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
    folder.mkdir(exist_ok=True)
    parts = []
    if arm:
        parts += [
            '<link name="stand">' + _collision('<box size="0.1 0.1 0.02"/>') + "</link>",
            '<link name="upper">' + _collision('<box size="0.04 0.04 0.3"/>', (0, 0, 0.15)) + "</link>",
            '<link name="flange"/><link name="camera">' + _collision('<box size="0.02 0.02 0.02"/>') + "</link>",
            _joint("lift", "prismatic", "stand", "upper", (0, 0, 0.02), (0, 0, 1), (0, 0.2)),
            _joint("wrist", "continuous", "upper", "flange", (0, 0, 0.31), (0, 0, 1), (0, 0)),
            _joint("screw", "fixed", "flange", "palm", (0, 0, 0.02), (0, 0, 1), (0, 0)),
            _joint("mount", "fixed", "flange", "camera", (0.06, 0, 0), (0, 0, 1), (0, 0)),
        ]
    parts.append(
        '<link name="palm">' + _collision('<cylinder radius="0.045" length="0.02"/>', (0, 0, -0.01)) + "</link>"
    )
    for number, (x, y) in enumerate(((0.03, 0.025), (0.03, -0.025), (-0.034, 0.0)), 1):
        carrier, place = "palm", (x, y, 0.0)
        if number < 3:
            carrier, spread = f"finger_{number}_base", "spread" if number == 1 else "spread_mirror"
            parts.append(f'<link name="{carrier}"/>')
            parts.append(_joint(spread, "revolute", "palm", carrier, place, (0, 0, 1), LIMITS[spread]))
            place = (0.0, 0.0, 0.0)
        turn = -1 if number < 3 else 1
        for bone, parent, at, limits in (
            ("a", carrier, (*place[:2], 0.008), (-0.3, 1.3)),
            ("b", f"finger_{number}_a", (0, 0, 0.055), (0.0, 0.8)),
        ):
            name = f"finger_{number}_{bone}"
            length = 0.055 if bone == "a" else 0.04
            pad = _collision('<sphere radius="0.01"/>', (0, 0, length)) if bone == "b" else ""
            rod = _collision(f'<box size="0.014 0.016 {length}"/>', (0, 0, length / 2))
            parts.append(f'<link name="{name}">{rod}{pad}<inertial><origin xyz="0 0 {length / 2}"/>')
            parts.append('<mass value="0.03"/><inertia ixx="8e-6" ixy="0" ixz="0" iyy="8e-6" iyz="0" izz="4e-6"/>')
            parts.append("</inertial></link>")
            parts.append(_joint(name, "revolute", parent, name, at, (0, turn, 0), limits))
    (folder / "gripper.urdf").write_text(f'<robot name="gripper">{"".join(parts)}</robot>')
    return load_hand(folder / "gripper.urdf", candidates=256)


def _collision(shape: str, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    return f'<collision><origin xyz="{at[0]} {at[1]} {at[2]}"/><geometry>{shape}</geometry></collision>'


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    at: tuple[float, float, float],
    axis: tuple[float, float, float],
    limits: tuple[float, float],
) -> str:
    follow = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*FOLLOWERS[name]) if name in FOLLOWERS else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at[0]} {at[1]} {at[2]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{follow}'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="5" velocity="3"/></joint>'
    )
