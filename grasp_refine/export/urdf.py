"""URDF, SRDF and meshes of bodies."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from math import isfinite
from pathlib import Path

import numpy as np

from grasp_refine.export.bodies import Bodies, BodyLink
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.urdf_text import UNLIMITED, add_ends, add_inertia, numbers, save_obj, save_xml

ROOT = "hand_start"
"""Link at which the root stands still, above its joints."""

ROOT_JOINTS = ("root_x", "root_y", "root_z", "root_roll", "root_pitch", "root_yaw")
"""Joints that move the hand: along the axes of its start, then about x, y and z in turn; see `root_values`."""

CARRIER = Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
"""Mass of the links between them, which keeps their drives well-conditioned."""


def save_urdf(bodies: Bodies, speed_limits: Mapping[str, float], folder: Path) -> None:
    """Write `hand.urdf` with `hand.srdf`, `object.urdf` and `meshes/`, one convex piece a file.

    Args:
        bodies: Hand and object.
        speed_limits: Speed limits of joints that have one, rad/s or m/s, by name.
        folder: The folder.
    """
    hand = ET.Element("robot", name="hand")
    _add_root(hand, bodies.links[0].name)
    for link in bodies.links:
        _add_link(hand, link, folder)
        if link.parent:
            _add_joint(hand, link, speed_limits.get(link.joint, UNLIMITED))
    save_xml(hand, folder / "hand.urdf")
    srdf = ET.Element("robot", name="hand")
    for pair in sorted(map(sorted, bodies.separate)):
        ET.SubElement(srdf, "disable_collisions", link1=pair[0], link2=pair[1], reason="Never")
    save_xml(srdf, folder / "hand.srdf")
    thing = ET.Element("robot", name="object")
    _add_link(thing, bodies.object, folder)
    save_xml(thing, folder / "object.urdf")


def _add_root(robot: ET.Element, root: str) -> None:
    names = [ROOT, *(f"carrier_{number}" for number in range(1, 6)), root]
    for number, name in enumerate(names[:-1]):
        node = ET.SubElement(robot, "link", name=name)
        if number:
            add_inertia(node, CARRIER)
    for number, (joint, parent, child) in enumerate(zip(ROOT_JOINTS, names[:-1], names[1:], strict=True)):
        turns, axis = divmod(number, 3)
        node = ET.SubElement(robot, "joint", name=joint, type="revolute" if turns else "prismatic")
        ET.SubElement(node, "parent", link=parent)
        ET.SubElement(node, "child", link=child)
        ET.SubElement(node, "axis", xyz=numbers(np.eye(3)[axis]))
        ET.SubElement(
            node, "limit", lower=f"{-10 if not turns else -7}", upper=f"{10 if not turns else 7}",
            effort=str(UNLIMITED), velocity=str(UNLIMITED),
        )  # fmt: skip


def _add_link(robot: ET.Element, link: BodyLink, folder: Path) -> None:
    node = ET.SubElement(robot, "link", name=link.name)
    add_inertia(node, link.inertia)
    for number, hull in enumerate(link.hulls):
        name = f"meshes/{link.name.replace('/', '_')}_{number}.obj"
        save_obj(folder / name, hull.vertices, hull.faces)
        for kind in ("visual", "collision"):
            geometry = ET.SubElement(ET.SubElement(node, kind), "geometry")
            ET.SubElement(geometry, "mesh", filename=name)


def _add_joint(robot: ET.Element, link: BodyLink, speed: float) -> None:
    node = ET.SubElement(robot, "joint", name=link.joint, type=link.kind)
    add_ends(node, link.parent, link.name, link.T_parent_link)
    if link.kind == "fixed":
        return
    ET.SubElement(node, "axis", xyz=numbers(link.axis))
    effort = float(link.force_limit) if isfinite(link.force_limit) else UNLIMITED
    limit = {"effort": repr(effort), "velocity": repr(float(speed))}
    if link.kind != "continuous":
        low, high = (value if isfinite(value) else np.copysign(UNLIMITED, value) for value in link.limits)
        limit |= {"lower": repr(float(low)), "upper": repr(float(high))}
    ET.SubElement(node, "limit", limit)
    ET.SubElement(node, "dynamics", damping=repr(link.damping), friction="0")
    if link.leader is not None:
        leader, multiplier, offset = link.leader
        ET.SubElement(node, "mimic", joint=leader, multiplier=repr(multiplier), offset=repr(offset))
