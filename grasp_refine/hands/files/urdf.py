"""Elements of a URDF file, checked one by one."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_valid

if TYPE_CHECKING:
    from lxml.etree import _Element

SHAPES = ("box", "cylinder", "sphere", "mesh")
"""Elements that a <geometry> can hold."""

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of <inertia>: the upper triangle of a symmetric matrix."""

CHILDREN_READ = {
    "robot": ("link", "joint"),
    "link": ("inertial", "collision"),
    "inertial": ("mass", "origin", "inertia"),
    "collision": ("origin", "geometry"),
    "visual": ("origin", "geometry", "material"),
    "material": ("color",),
    "geometry": SHAPES,
    "joint": ("parent", "child", "origin", "axis", "limit", "mimic"),
}
"""Children of an element that are read; the rest (visuals, transmissions, simulator extensions) cannot break a hand."""

MAX_LINKS = 1000
"""Most links or joints of a URDF; a hand has thirty, one with an arm and hundreds of tactile cells some hundreds. The
computations for pairs of joints and links take minutes for ten times as many."""

REQUIRED_CHILDREN = {"collision": ("geometry",), "visual": ("geometry",), "joint": ("parent", "child")}
"""Elements that an element must hold."""

REQUIRED_ATTRIBUTES = {
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz"),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}
"""Attributes that an element must have."""

MAX_OFFSET_M = 1e3
"""Largest coordinate of an origin, in metres: a hand, on an arm or not, is smaller."""

MAX_INERTIA = 1e9
"""Largest mass in kg, and moment of inertia in kg m^2, beyond that of any robot."""

MAX_JOINT_VALUE = 1e6
"""Largest joint value in radians or metres: no grasp has a larger one (`scene.MAX_MAGNITUDE`)."""

NUMBER_COUNTS: dict[str, dict[str, tuple[int, ...]]] = {
    "origin": {"xyz": (3,), "rpy": (3,)},
    "axis": {"xyz": (3,)},
    "limit": {"lower": (1,), "upper": (1,), "effort": (1,), "velocity": (1,)},
    "mimic": {"multiplier": (1,), "offset": (1,)},
    "mass": {"value": (1,)},
    "inertia": dict.fromkeys(MOMENTS, (1,)),
    "box": {"size": (3,)},
    "cylinder": {"radius": (1,), "length": (1,)},
    "sphere": {"radius": (1,)},
    "mesh": {"scale": (1, 3)},
    "color": {"rgba": (3, 4)},
}
"""Attributes that hold numbers, and their valid counts."""


def read_urdf(path: Path) -> _Element:
    """Return the <robot> of the URDF file `path` with its links and joints, every number finite.

    Visuals are left out, meshes are not loaded, and no external entity is ever read. Whether links and
    joints form a tree is not checked here.

    Raises:
        HandError: the file is missing, not XML, not a URDF, or has more than `MAX_LINKS` links or joints, or an
            element of it is incomplete or malformed.
    """
    robot = _read_xml(path)
    for tag in ("link", "joint"):
        if (count := len(robot.findall(tag))) > MAX_LINKS:
            raise HandError(f"{path}: has {count} {tag}s, more than the {MAX_LINKS} that a hand may have")
    _check(robot, str(path))
    return robot


def _read_xml(path: Path) -> _Element:
    from lxml import etree

    refuse_lfs_pointer(path, "URDF", HandError)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise HandError(f"{path}: cannot be read ({error.strerror or error})") from None
    safe = {
        "resolve_entities": False,
        "no_network": True,
        "load_dtd": False,
        "remove_comments": True,
        "remove_pis": True,
    }
    parser = etree.XMLParser(**safe)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError:
        for entry in parser.error_log:
            if entry.domain_name != "NAMESPACE":
                reason = f"{' '.join(entry.message.split())}, line {entry.line}, column {entry.column}"
                raise HandError(f"{path}: not XML ({reason})") from None
        # Elements and attributes of Drake have an undeclared prefix.
        root = etree.fromstring(data, etree.XMLParser(**safe, recover=True))
        for element in root.iter():
            for name in [name for name in element.attrib if ":" in name and not name.startswith("{")]:
                del element.attrib[name]
    if root.getroottree().docinfo.doctype:
        raise HandError(f"{path}: a DOCTYPE is refused, because it can pull in other files; remove it")
    if root.tag == "mujocoinclude":
        raise HandError(f"{path}: a part of an MJCF, which other files include; give one of these files")
    if root.tag != "robot":
        raise HandError(f"{path}: not a URDF, its outermost element is <{root.tag}> instead of <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise HandError(f"{path}: holds xacro macros; expand them first: xacro {path.name} > hand.urdf")
    return root


def _check(element: _Element, where: str) -> None:
    """Check `element`, drop parts that are not read, and separate its numbers by spaces."""
    tag = element.tag
    if tag in ("link", "joint") and element.get("name"):
        where = f"{where}: {tag} '{element.get('name')}'"
    for name in REQUIRED_ATTRIBUTES.get(tag, ()):
        if not element.get(name):
            raise HandError(f"{where}: <{tag}> has no '{name}'")
        if not is_valid(element.get(name)):
            raise HandError(f'{where}: <{tag} {name}="{element.get(name)}"> holds characters that no name may have')
    for name, counts in NUMBER_COUNTS.get(tag, {}).items():
        if name in element.attrib:
            element.set(name, _numbers(element, name, counts, where))
    if tag == "geometry" and [child.tag in SHAPES for child in element] != [True]:
        found = ", ".join(f"<{child.tag}>" for child in element) or "nothing"
        raise HandError(f"{where}: <geometry> holds {found}; it must hold one of {', '.join(SHAPES)}")
    for name in REQUIRED_CHILDREN.get(tag, ()):
        if element.find(name) is None:
            raise HandError(f"{where}: <{tag}> has no <{name}>")
    for child in list(element):
        if child.tag in CHILDREN_READ.get(tag, ()):
            _check(child, where)
        else:
            element.remove(child)


def _numbers(element: _Element, name: str, counts: tuple[int, ...], where: str) -> str:
    text = element.get(name)
    try:
        # Python reads 1_0 as 10.
        values = [] if "_" in text else [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) not in counts or not np.isfinite(values).all():
        wanted = "a finite number" if counts == (1,) else f"{' or '.join(map(str, counts))} finite numbers"
        raise HandError(f'{where}: <{element.tag} {name}="{text}"> must be {wanted}')
    if element.tag == "origin" and name == "xyz" and max(map(abs, values)) > MAX_OFFSET_M:
        raise HandError(f'{where}: <origin xyz="{text}"> is no place in a hand, above {MAX_OFFSET_M:g} m')
    if element.tag in ("mass", "inertia") and max(map(abs, values)) > MAX_INERTIA:
        raise HandError(f'{where}: <{element.tag} {name}="{text}"> is no mass or inertia, above {MAX_INERTIA:g}')
    if element.tag == "limit" and name in ("lower", "upper"):
        # Files write limits such as 1e16 for none.
        values = np.clip(values, -MAX_JOINT_VALUE, MAX_JOINT_VALUE).tolist()
    return " ".join(map(repr, values))


def read_visuals(path: Path) -> dict[str, list[_Element | HandError]]:
    """Return the <visual>s of each link in the URDF file `path`, which `read_urdf` leaves out; its error for a bad one.

    A visual whose material is defined elsewhere in the file gets that material, with the color in the file.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    robot = _read_xml(path)
    materials = {material.get("name"): material for material in robot.iterfind("material")}
    # A visual may name a material that is described only at another visual.
    for material in robot.iterfind("link/visual/material"):
        if material.find("color") is not None:
            materials.setdefault(material.get("name"), material)
    found: dict[str, list[_Element | HandError]] = {}
    for link in robot.iterfind("link"):
        where = f"{path}: link '{link.get('name', '')}'"
        for visual in link.findall("visual"):
            found.setdefault(link.get("name", ""), []).append(_visual(visual, materials, where))
    return found


def _visual(visual: _Element, materials: dict[str | None, _Element], where: str) -> _Element | HandError:
    material = visual.find("material")
    if material is not None and material.find("color") is None and material.get("name") in materials:
        visual.replace(material, deepcopy(materials[material.get("name")]))
    try:
        _check(visual, where)
    except HandError as error:
        return error
    return visual


def joints_fixed_and_mimicking(path: Path) -> tuple[str, ...]:
    """Names of the fixed joints in the URDF file `path` that hold a <mimic>, which has no effect there.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    joints = _read_xml(path).iterfind("joint")
    return tuple(j.get("name", "") for j in joints if j.get("type") == "fixed" and j.find("mimic") is not None)


def controlled_joints(path: Path) -> tuple[str, ...]:
    """Names of the joints that transmissions and ros2_control name in the URDF file `path`.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    robot = _read_xml(path)
    named = [one for kind in ("transmission", "ros2_control") for one in robot.iterfind(f"{kind}/joint")]
    return tuple(dict.fromkeys(one.get("name", "") for one in named))
