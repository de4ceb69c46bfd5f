"""URDF, SRDF and meshes of bodies."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from math import isfinite
from pathlib import Path

import numpy as np

from grasp_refine.core.json_files import save_text
from grasp_refine.core.rpy_poses import rpy_from_transform
from grasp_refine.export.bodies import Bodies, BodyLink, Hull
from grasp_refine.hands.files.inertia import Inertia

ROOT = "hand_start"
"""Link at which the root stands still, above its joints."""

ROOT_JOINTS = ("root_x", "root_y", "root_z", "root_roll", "root_pitch", "root_yaw")
"""Joints that move the hand: along the axes of its start, then about x, y and z in turn; see `root_values`."""

CARRIER = Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
"""Mass of the links between them, which keeps their drives well-conditioned."""

UNLIMITED = 1e4
"""Effort (N, N m) and speed (m/s, rad/s) of joints that have no limit of them; URDF demands numbers."""


def save_urdf(bodies: Bodies, folder: Path) -> None:
    """Write `hand.urdf` with `hand.srdf`, `object.urdf` and `meshes/`, one convex piece a file."""
    hand = ET.Element("robot", name="hand")
    _add_root(hand, bodies.links[0].name)
    for link in bodies.links:
        _add_link(hand, link, folder)
        if link.parent:
            _add_joint(hand, link)
    _save(hand, folder / "hand.urdf")
    srdf = ET.Element("robot", name="hand")
    for pair in sorted(map(sorted, bodies.separate)):
        ET.SubElement(srdf, "disable_collisions", link1=pair[0], link2=pair[1], reason="Never")
    _save(srdf, folder / "hand.srdf")
    thing = ET.Element("robot", name="object")
    _add_link(thing, bodies.object, folder)
    _save(thing, folder / "object.urdf")


def _add_root(robot: ET.Element, root: str) -> None:
    names = [ROOT, *(f"carrier_{number}" for number in range(1, 6)), root]
    for number, name in enumerate(names[:-1]):
        node = ET.SubElement(robot, "link", name=name)
        if number:
            _add_inertia(node, CARRIER)
    for number, (joint, parent, child) in enumerate(zip(ROOT_JOINTS, names[:-1], names[1:], strict=True)):
        turns, axis = divmod(number, 3)
        node = ET.SubElement(robot, "joint", name=joint, type="revolute" if turns else "prismatic")
        ET.SubElement(node, "parent", link=parent)
        ET.SubElement(node, "child", link=child)
        ET.SubElement(node, "axis", xyz=_numbers(np.eye(3)[axis]))
        ET.SubElement(
            node, "limit", lower=f"{-10 if not turns else -7}", upper=f"{10 if not turns else 7}",
            effort=str(UNLIMITED), velocity=str(UNLIMITED),
        )  # fmt: skip


def _add_link(robot: ET.Element, link: BodyLink, folder: Path) -> None:
    node = ET.SubElement(robot, "link", name=link.name)
    _add_inertia(node, link.inertia)
    for number, hull in enumerate(link.hulls):
        name = f"meshes/{link.name.replace('/', '_')}_{number}.obj"
        save_obj(folder / name, hull)
        for kind in ("visual", "collision"):
            geometry = ET.SubElement(ET.SubElement(node, kind), "geometry")
            ET.SubElement(geometry, "mesh", filename=name)


def _add_inertia(node: ET.Element, inertia: Inertia) -> None:
    inner = ET.SubElement(node, "inertial")
    ET.SubElement(inner, "origin", xyz=_numbers(inertia.centre), rpy="0 0 0")
    ET.SubElement(inner, "mass", value=repr(float(inertia.mass)))
    axes, pairs = "xyz", [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    moments = {f"i{axes[a]}{axes[b]}": repr(float(inertia.matrix[a, b])) for a, b in pairs}
    ET.SubElement(inner, "inertia", moments)


def _add_joint(robot: ET.Element, link: BodyLink) -> None:
    node = ET.SubElement(robot, "joint", name=link.joint, type=link.kind)
    x, y, z, *degrees = rpy_from_transform(link.T_parent_link)
    ET.SubElement(node, "origin", xyz=_numbers((x, y, z)), rpy=_numbers(np.deg2rad(degrees)))
    ET.SubElement(node, "parent", link=link.parent)
    ET.SubElement(node, "child", link=link.name)
    if link.kind == "fixed":
        return
    ET.SubElement(node, "axis", xyz=_numbers(link.axis))
    effort = float(link.force_limit) if isfinite(link.force_limit) else UNLIMITED
    limit = {"effort": repr(effort), "velocity": str(UNLIMITED)}
    if link.kind != "continuous":
        low, high = (value if isfinite(value) else np.copysign(UNLIMITED, value) for value in link.limits)
        limit |= {"lower": repr(float(low)), "upper": repr(float(high))}
    ET.SubElement(node, "limit", limit)
    ET.SubElement(node, "dynamics", damping=repr(link.damping), friction="0")
    if link.leader is not None:
        leader, multiplier, offset = link.leader
        ET.SubElement(node, "mimic", joint=leader, multiplier=repr(multiplier), offset=repr(offset))


def save_obj(path: Path, hull: Hull) -> None:
    """Write a convex piece as Wavefront OBJ, metres."""
    lines = [f"v {_numbers(vertex)}" for vertex in hull.vertices]
    lines += [f"f {' '.join(str(corner + 1) for corner in face)}" for face in hull.faces.tolist()]
    save_text(path, "\n".join([*lines, ""]))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def _save(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    save_text(path, ET.tostring(root, encoding="unicode") + "\n")
