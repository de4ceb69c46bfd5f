"""Text of URDF files that are written: numbers that are read back exactly, frames, inertias, and meshes beside them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.json_files import save_text
from grasp_refine.core.rpy_poses import rpy_from_transform
from grasp_refine.hands.files.inertia import Inertia

UNLIMITED = 1e4
"""Effort (N, N m) and speed (m/s, rad/s) of joints that have no limit of them; URDF demands numbers."""


def numbers(values: Iterable[float]) -> str:
    """Return numbers with all digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def add_inertia(link: ET.Element, inertia: Inertia) -> None:
    """Add the `inertial` element of a link."""
    inner = ET.SubElement(link, "inertial")
    ET.SubElement(inner, "origin", xyz=numbers(inertia.centre), rpy="0 0 0")
    ET.SubElement(inner, "mass", value=repr(float(inertia.mass)))
    axes, pairs = "xyz", [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    moments = {f"i{axes[a]}{axes[b]}": repr(float(inertia.matrix[a, b])) for a, b in pairs}
    ET.SubElement(inner, "inertia", moments)


def add_ends(joint: ET.Element, parent: str, child: str, T_parent_child: Float[np.ndarray, "4 4"]) -> None:
    """Add the links of a joint, and the pose of the child where it is 0."""
    x, y, z, *degrees = rpy_from_transform(T_parent_child)
    ET.SubElement(joint, "origin", xyz=numbers((x, y, z)), rpy=numbers(np.deg2rad(degrees)))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)


def save_obj(path: Path, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
    """Write a mesh as Wavefront OBJ, metres."""
    lines = [f"v {numbers(vertex)}" for vertex in vertices]
    lines += [f"f {' '.join(str(corner + 1) for corner in face)}" for face in faces.tolist()]
    save_text(path, "\n".join([*lines, ""]))


def save_xml(root: ET.Element, path: Path) -> None:
    """Write an indented XML file."""
    ET.indent(root)
    save_text(path, ET.tostring(root, encoding="unicode") + "\n")
