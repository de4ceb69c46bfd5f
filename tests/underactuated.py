"""An underactuated hand of five fingers: 12 joints, of which 6 are independent; and its mirror image."""

from pathlib import Path

import numpy as np
import trimesh

from grasp_refine.hands.hand import Hand
from made_hands import inertial, joint, link, made_hand, solid

FINGERS = {"index": 0.033, "middle": 0.011, "ring": -0.011, "little": -0.033}
"""Finger -> its place across the palm, in metres."""

INDEPENDENT = ("thumb_yaw", "thumb_1", "index_1", "middle_1", "ring_1", "little_1")

FOLLOWERS = {
    "thumb_2": ("thumb_1", 0.8, 0.0),
    "thumb_3": ("thumb_2", 1.25, 0.1),  # thumb_1 + 0.1, by way of thumb_2
    "index_2": ("index_1", 0.9, 0.1),
    "middle_2": ("middle_1", 0.9, 0.1),
    "ring_2": ("ring_1", -0.9, -0.1),  # its axis points the other way
    "little_2": ("little_1", 1.1, 0.0),  # at most 1.1, so that little_1 ends at 1 before its own 1.5
}
"""Mimic joint -> what it follows, multiplier and offset."""

UPPER = {"thumb_yaw": 0.6, "thumb_1": 0.9, "thumb_2": 1.0, "thumb_3": 1.2, "little_2": 1.1, "ring_2": 0.2}
LOWER = {"thumb_yaw": -0.6, "thumb_1": -0.3, "thumb_2": -0.5, "thumb_3": -0.5, "ring_2": -1.6}


def underactuated(folder: Path, *, left: bool = False, toml: bool = True) -> Hand:
    """The hand: fingers along z beside each other, they bend towards y; the thumb comes from below along y.

    Args:
        folder: Where its files are written.
        left: Whether it is mirrored at x = 0: frames and axes, and the palm's mesh by a negative scale.
        toml: Whether a hand.toml says its rest pose; otherwise the URDF is bare.
    """
    folder.mkdir(exist_ok=True)
    trimesh.Trimesh(*_wedge()).export(folder / "palm.stl")
    sign = -1.0 if left else 1.0
    scale = 'palm.stl" scale="-1 1 1' if left else "palm.stl"
    parts = [f'<link name="palm"><collision><geometry><mesh filename="{scale}"/></geometry></collision></link>']
    skeleton = [("thumb_yaw", "palm", "thumb_base", (0.028, 0.018, -0.03), (0, 0, 1), None)]
    skeleton += [
        ("thumb_1", "thumb_base", "thumb_a", (0, 0.008, 0), (1, 0, 0), ((0, 1, 0), 0.034)),
        ("thumb_2", "thumb_a", "thumb_b", (0, 0.034, 0), (1, 0, 0), ((0, 1, 0), 0.028)),
        ("thumb_3", "thumb_b", "thumb_c", (0, 0.028, 0), (1, 0, 0), ((0, 1, 0), 0.022)),
    ]
    for finger, x in FINGERS.items():
        turn = 1 if finger == "ring" else -1
        skeleton += [
            (f"{finger}_1", "palm", f"{finger}_a", (x, 0, 0.045), (-1, 0, 0), ((0, 0, 1), 0.045)),
            (f"{finger}_2", f"{finger}_a", f"{finger}_b", (0, 0, 0.045), (turn, 0, 0), ((0, 0, 1), 0.034)),
        ]
    for name, parent, child, (x, y, z), (ax, ay, az), bone in skeleton:
        last = name in ("thumb_3", *(f"{finger}_2" for finger in FINGERS))
        parts.append(link(child, "" if bone is None else _bone(*bone, last)))
        # A mirrored turn goes the other way round the mirrored axis.
        place, turn = (sign * x, y, z), (ax, sign * ay, sign * az)
        limits = LOWER.get(name, 0.0), UPPER.get(name, 1.5)
        follow = FOLLOWERS.get(name)
        parts.append(
            joint(name, parent, child, at=place, axis=turn, limits=limits, effort=2, velocity=3, follow=follow)
        )
    rest = "\n".join(f"{name} = {0.0 if 'thumb' in name else 0.4}" for name in INDEPENDENT)
    written = f"[rest_pose]\n{rest}\n[actuator]\nkp = 3.0\n" if toml else None
    return made_hand(folder, *parts, name="underactuated", toml=written, candidates=256)


def _bone(direction: tuple[int, int, int], length: float, last: bool) -> str:
    """A rod with a mass of 15 g, with a ball at its end where it is the last one."""
    rpy = "0 0 0" if direction[2] else "-1.5707963267948966 0 0"
    middle, end = (" ".join(str(share * length * d) for d in direction) for share in (0.5, 1.0))
    rod = solid(f"cylinder 0.007 {length}", middle, rpy)
    return inertial(0.015, (3e-6, 3e-6, 3e-6), middle) + rod + solid("sphere 0.009", end) * last


def _wedge() -> tuple[np.ndarray, np.ndarray]:
    """A palm that is thicker at the side of the thumb, so that its mirror image is another."""
    corners = np.array(
        [[x, y, z] for x, thick in ((0.042, 0.012), (-0.042, 0.007)) for y in (-thick, thick) for z in (-0.045, 0.04)]
    )
    hull = trimesh.convex.convex_hull(corners)
    return hull.vertices, hull.faces
