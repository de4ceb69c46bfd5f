"""Links and joints of a URDF as a tree."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.shape import Geometry, MeshFile, Primitive, Shape
from grasp_refine.hands.files.tree import JointEntry, LinkEntry, Mimic, Tree
from grasp_refine.hands.files.urdf import read_urdf, read_visuals

if TYPE_CHECKING:
    import yourdfpy


def urdf_tree(path: Path) -> Tree:
    """Return the tree of links and joints in the URDF file `path`.

    Raises:
        HandError: the file cannot be read as a URDF, or its links and joints are not one tree.
    """
    robot = read_urdf(path)
    return Tree.of(path, [_link(link) for link in robot.links], [_joint(joint) for joint in robot.joints])


def urdf_visuals(path: Path) -> dict[str, list[Shape | HandError]]:
    """Return the visuals of each link in the URDF file `path`; for a broken one, its error.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    return {
        link: [visual if isinstance(visual, HandError) else _shape(visual, _color(visual)) for visual in visuals]
        for link, visuals in read_visuals(path).items()
    }


def _link(raw: yourdfpy.Link) -> LinkEntry:
    inertial = raw.inertial
    mass = None if inertial is None else inertial.mass
    inertia = None
    if mass is not None and inertial.inertia is not None:
        inertia = Inertia.about(mass, _pose(inertial.origin), inertial.inertia)
    return LinkEntry(raw.name, tuple(_shape(collision) for collision in raw.collisions), mass, inertia)


def _joint(raw: yourdfpy.Joint) -> JointEntry:
    limit, mimic = raw.limit, raw.mimic
    return JointEntry(
        name=raw.name,
        kind=raw.type,
        parent=raw.parent,
        child=raw.child,
        T_parent_child=_pose(raw.origin),
        axis=raw.axis,
        lower=None if limit is None else limit.lower,
        upper=None if limit is None else limit.upper,
        effort=None if limit is None else limit.effort,
        velocity=None if limit is None else limit.velocity,
        mimic=None if mimic is None else Mimic(mimic.joint, mimic.multiplier, mimic.offset),
    )


def _shape(raw: yourdfpy.Collision | yourdfpy.Visual, color: tuple[float, float, float] | None = None) -> Shape:
    return Shape(_geometry(raw.geometry), _pose(raw.origin), color)


def _geometry(raw: yourdfpy.Geometry) -> Geometry:
    if raw.box is not None:
        return Primitive("box", tuple(map(float, raw.box.size)))
    if raw.cylinder is not None:
        return Primitive("cylinder", (raw.cylinder.radius, raw.cylinder.length))
    if raw.sphere is not None:
        return Primitive("sphere", (raw.sphere.radius,))
    x, y, z = np.broadcast_to(1.0 if raw.mesh.scale is None else raw.mesh.scale, 3).tolist()
    return MeshFile(raw.mesh.filename, (x, y, z))


def _pose(origin: np.ndarray | None) -> np.ndarray:
    return np.eye(4) if origin is None else origin


def _color(visual: yourdfpy.Visual) -> tuple[float, float, float] | None:
    if visual.material is None or visual.material.color is None:
        return None
    red, green, blue = np.clip(visual.material.color.rgba[:3], 0.0, 1.0).tolist()
    return red, green, blue
