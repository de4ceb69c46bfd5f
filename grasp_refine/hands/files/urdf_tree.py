"""Links and joints of a URDF as a tree."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.shape import Geometry, MeshFile, Primitive, Shape
from grasp_refine.hands.files.tree import JointEntry, LinkEntry, Mimic, Tree
from grasp_refine.hands.files.urdf import MOMENTS, read_urdf, read_visuals

if TYPE_CHECKING:
    from lxml.etree import _Element


def urdf_tree(path: Path) -> Tree:
    """Return the tree of links and joints in the URDF file `path`.

    Raises:
        HandError: the file cannot be read as a URDF, or its links and joints are not one tree.
    """
    robot = read_urdf(path)
    links = [_link(link) for link in robot.iterfind("link")]
    return Tree.of(path, links, [_joint(joint) for joint in robot.iterfind("joint")])


def urdf_visuals(path: Path) -> dict[str, list[Shape | HandError]]:
    """Return the visuals of each link in the URDF file `path`; for a broken one, its error.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    return {
        link: [visual if isinstance(visual, HandError) else _shape(visual, _color(visual)) for visual in visuals]
        for link, visuals in read_visuals(path).items()
    }


def _link(link: _Element) -> LinkEntry:
    mass = _number(link.find("inertial/mass"), "value")
    moments = link.find("inertial/inertia")
    inertia = None
    if mass is not None and moments is not None:
        inertia = Inertia.about(mass, _pose(link.find("inertial")), _matrix(moments))
    return LinkEntry(
        link.get("name"), tuple(_shape(collision) for collision in link.iterfind("collision")), mass, inertia
    )


def _matrix(inertia: _Element) -> Float[np.ndarray, "3 3"]:
    xx, xy, xz, yy, yz, zz = (float(inertia.get(moment, 0.0)) for moment in MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _joint(joint: _Element) -> JointEntry:
    limit, mimic = joint.find("limit"), joint.find("mimic")
    return JointEntry(
        name=joint.get("name"),
        kind=joint.get("type"),
        parent=joint.find("parent").get("link"),
        child=joint.find("child").get("link"),
        T_parent_child=_pose(joint),
        axis=_numbers(joint.find("axis"), "xyz", "1 0 0"),
        lower=_number(limit, "lower"),
        upper=_number(limit, "upper"),
        effort=_number(limit, "effort"),
        velocity=_number(limit, "velocity"),
        mimic=None
        if mimic is None
        else Mimic(mimic.get("joint"), float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))),
    )


def _shape(element: _Element, color: tuple[float, float, float] | None = None) -> Shape:
    return Shape(_geometry(element.find("geometry")[0]), _pose(element), color)


def _geometry(shape: _Element) -> Geometry:
    if shape.tag == "box":
        return Primitive("box", tuple(_numbers(shape, "size", "").tolist()))
    if shape.tag == "cylinder":
        return Primitive("cylinder", (float(shape.get("radius")), float(shape.get("length"))))
    if shape.tag == "sphere":
        return Primitive("sphere", (float(shape.get("radius")),))
    x, y, z = np.broadcast_to(_numbers(shape, "scale", "1"), 3).tolist()
    return MeshFile(shape.get("filename"), (x, y, z))


def _pose(element: _Element) -> Float[np.ndarray, "4 4"]:
    """Return the pose (4, 4) in the <origin> of an element: Rz(yaw) Ry(pitch) Rx(roll), then xyz."""
    T = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        (sr, sp, sy), (cr, cp, cy) = (turn(_numbers(origin, "rpy", "0 0 0")).tolist() for turn in (np.sin, np.cos))
        T[:3, :3] = [
            [cp * cy, sp * (sr * cy) - cr * sy, sp * (cr * cy) + sr * sy],
            [cp * sy, sp * (sr * sy) + cr * cy, sp * (cr * sy) - sr * cy],
            [-sp, cp * sr, cp * cr],
        ]
        T[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return T + 0.0  # no negative zeros


def _number(element: _Element | None, name: str) -> float | None:
    return None if element is None or name not in element.attrib else float(element.get(name))


def _numbers(element: _Element | None, name: str, default: str) -> Float[np.ndarray, " n"]:
    text = default if element is None else element.get(name, default)
    return np.array([float(number) for number in text.split()])


def _color(visual: _Element) -> tuple[float, float, float] | None:
    color = visual.find("material/color")
    if color is None:
        return None
    red, green, blue = np.clip(_numbers(color, "rgba", "1 1 1")[:3], 0.0, 1.0).tolist()
    return red, green, blue
