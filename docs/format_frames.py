"""Draw the frames of the formats of grasp files into `docs/pages/figures/format-*.svg`: `python docs/format_frames.py`.

Each drawing shows the object on the left, the hand on the right with its fingers to the left, and the pose that a file
gives as an arrow from the frame in which it is told to the frame that it tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

FIGURES = Path(__file__).parent / "pages" / "figures"

STEPS = {"left": (-46, 0), "right": (46, 0), "up": (0, -46), "down": (0, 46), "out": (0, 0), "in": (0, 0)}
"""Directions on the page -> the end of an axis; out of it and into it are a dot and a cross."""
COLORS = {"x": "#c0392b", "y": "#2e8b57", "z": "#2455c3"}
VECTORS = {
    "left": (-1, 0, 0),
    "right": (1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "out": (0, 0, 1),
    "in": (0, 0, -1),
}

JAWS = (
    '<path class="a" d="M590 92 h70 v96 h-70 Z"/>'
    '<path class="a" d="M480 92 h110 v20 h-110 Z"/><path class="a" d="M480 168 h110 v20 h-110 Z"/>'
    '<path class="d" d="M500 118 v12" marker-end="url(#k)"/><path class="d" d="M500 162 v-12" marker-end="url(#k)"/>'
)
"""Two jaws that close up and down the page."""
FINGERS = (
    '<path class="a" d="M560 92 h100 v46 h-100 Z"/>'
    '<path d="M566 104 L500 108 L452 140" class="f"/><path d="M566 104 L500 108 L452 140" class="g"/>'
    '<path d="M610 136 L560 176 L500 182" class="f"/><path d="M610 136 L560 176 L500 182" class="g"/>'
)
"""A hand from its side: the palm looks down the page, a finger above, the thumb below."""


@dataclass(frozen=True)
class Drawing:
    """One format."""

    name: str
    hand: str
    """JAWS or FINGERS."""
    at: tuple[int, int]
    """Origin of the hand's frame on the page."""
    axes: tuple[str, str, str]
    """Directions of x, y and z of the hand's frame."""
    frame: str
    """Name of the hand's frame."""
    pose: str
    """Name of the arrow."""
    arrow: str = "object to hand"
    """object to hand, hand to object, or world to both."""
    thing: str = "object: mesh × scale"
    """Name of the object's frame."""
    note: str = ""


DRAWINGS = (
    Drawing("isaac_grasp", JAWS, (646, 140), ("out", "up", "left"), "panda_hand", "position, orientation",
            thing="object_frame", note="GraspGen's frame has x up the page instead, y into it"),
    Drawing("multidex", FINGERS, (636, 114), ("out", "up", "left"), "forearm", "columns 0 to 8",
            note="Shadow: the fingers along z, the palm looks along -y"),
    Drawing("dro", FINGERS, (636, 114), ("out", "up", "left"), "forearm", "columns 0 to 5",
            note="Shadow: the fingers along z, the palm looks along -y"),
    Drawing("graspqp", FINGERS, (636, 114), ("out", "left", "down"), "root link", "root_pose",
            note="Shadow and Allegro: the fingers along y, the palm looks along z"),
    Drawing("lightning_grasp", FINGERS, (636, 114), ("down", "out", "left"), "base_link", "object_pose",
            arrow="hand to object", note="Allegro: the fingers along z, the palm looks along x"),
    Drawing("hugs", FINGERS, (636, 114), ("out", "up", "left"), "rh_palm", "obj_pose, *_qpos[0:7]",
            arrow="world to both", note="Shadow: the fingers along z, the palm looks along -y"),
    Drawing("acronym", JAWS, (646, 140), ("up", "in", "left"), "gripper", "grasps/transforms",
            note="our panda_hand has the same origin and z, its y up the page"),
    Drawing("multigripper", JAWS, (646, 140), ("out", "up", "left"), "root link", "pose",
            note="franka_panda; other grippers have other axes towards the object"),
)  # fmt: skip


def svg(drawing: Drawing) -> str:
    """Return one drawing.

    Raises:
        ValueError: its axes are no right-handed frame.
    """
    x, y, z = (VECTORS[axis] for axis in drawing.axes)
    cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    if cross != z:
        raise ValueError(f"{drawing.name}: {drawing.axes} is no right-handed frame")
    hand_x, hand_y = drawing.at
    curve = {
        "object to hand": f'<path class="d" d="M150 136 Q340 20 {hand_x - 8} {hand_y - 14}" marker-end="url(#k)"/>',
        "hand to object": f'<path class="d" d="M{hand_x - 8} {hand_y - 14} Q340 20 158 132" marker-end="url(#k)"/>',
        "world to both": '<path class="d" d="M346 228 Q220 226 156 156" marker-end="url(#k)"/>'
        f'<path class="d" d="M366 224 Q520 226 {hand_x - 10} {hand_y + 14}" marker-end="url(#k)"/>'
        + _frame((354, 234), ("right", "in", "up"), "world", below=True),
    }[drawing.arrow]
    place = (340, 44) if drawing.arrow != "world to both" else (490, 262)
    height = 250 if drawing.arrow != "world to both" else 290
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 760 {height}" width="760" height="{height}">',
        "<style>text{font-family:Helvetica,Arial,sans-serif;font-size:15px;fill:#222}.s{font-size:13px;fill:#555}"
        ".a{fill:#cfe0f7;stroke:#2b5c9e;stroke-width:2}.b{fill:#f7dfc4;stroke:#a8641a;stroke-width:2}"
        ".d{stroke:#777;stroke-width:1.4;stroke-dasharray:5 4;fill:none}.f,.g{fill:none;stroke-linecap:round;"
        "stroke-linejoin:round;stroke:#2b5c9e;stroke-width:24}.g{stroke:#cfe0f7;stroke-width:20}</style>",
        '<defs><marker id="k" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0L10 5L0 10z" fill="#555"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
        '<path class="b" d="M90 96 h110 v100 h-110 Z M200 114 q44 0 44 34 t-44 34 v-14 q26 0 26 -20 t-26 -20 Z"/>',
        drawing.hand,
        _frame((145, 150), ("right", "in", "up"), ""),
        f'<text x="145" y="222" text-anchor="middle">{drawing.thing}</text>',
        _frame(drawing.at, drawing.axes, ""),
        f'<text x="{hand_x + 30}" y="222" text-anchor="middle">{drawing.frame}</text>',
        curve,
        f'<text x="{place[0]}" y="{place[1]}" text-anchor="middle">{drawing.pose}</text>',
        f'<text class="s" x="380" y="{height - 8}" text-anchor="middle">{drawing.note}</text>',
        "</svg>\n",
    ]
    return "\n".join(parts)


def _frame(at: tuple[int, int], axes: tuple[str, str, str], name: str, *, below: bool = False) -> str:
    """Three axes at a point, each with its letter."""
    parts = [f'<g transform="translate({at[0]} {at[1]})">']
    for letter, axis in zip("xyz", axes, strict=True):
        color = COLORS[letter]
        dx, dy = STEPS[axis]
        if axis in ("out", "in"):
            mark = '<circle r="3" fill="{0}"/>' if axis == "out" else '<path d="M-4 -4L4 4M-4 4L4 -4" stroke="{0}"/>'
            parts.append(f'<circle r="7" fill="#fff" stroke="{color}" stroke-width="2"/>{mark.format(color)}')
            parts.append(f'<text x="9" y="20" fill="{color}" style="fill:{color}">{letter}</text>')
        else:
            parts.append(f'<path d="M0 0L{dx} {dy}" stroke="{color}" stroke-width="3"/>')
            parts.append(f'<text x="{dx * 1.25 - 4:.0f}" y="{dy * 1.25 + 5:.0f}" style="fill:{color}">{letter}</text>')
    if name:
        parts.append(f'<text x="0" y="{34 if below else -60}" text-anchor="middle">{name}</text>')
    return "".join([*parts, "</g>"])


def main() -> None:
    """Write all drawings."""
    for drawing in DRAWINGS:
        (FIGURES / f"format-{drawing.name}.svg").write_text(svg(drawing), encoding="utf-8")


if __name__ == "__main__":
    main()
