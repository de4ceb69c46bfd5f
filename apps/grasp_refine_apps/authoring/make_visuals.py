"""Make the visual meshes of our own hands: their collision shapes with rounded edges and hubs around the joints.

Run `python -m grasp_refine_apps.authoring.make_visuals` after a change of the collision shapes in robots/*/*.urdf. It
writes robots/HAND/visual/*.ply and names them in the URDF. Sizes come from the URDF, which has the published
kinematics; no mesh of a maker is used. Flat faces stay where the collision shape has them, so that contacts look right.
"""

from __future__ import annotations

import hashlib
import re
from itertools import product
from pathlib import Path

import numpy as np
import trimesh

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import tangents
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.shape import Primitive

Placed = tuple[Primitive, Float[np.ndarray, "4 4"]]
"""A shape and its pose (4, 4) in the link."""

HANDS = ("allegro", "leap", "shadow")
"""Names of the hands."""

BOX_FILLET_SHARE, MAX_FILLET_M = 0.28, 0.006
"""Radius of a box's edges as a share of its shortest side, and its limit in metres."""

RIM_FILLET_M = 0.0015
"""Radius in metres of the rims of cylinders."""

HUB_SHARE, HUB_LENGTH_SHARE = 0.96, 1.05
"""Diameter of a hub as a share of the box's thickness, and its length as a share of the box's width."""

HUB_WIDTH_SHARE = 1.15
"""Width of a box along the joint's axis, as a share of its thickness, below which it gets no hub."""

HUB_REACH_M = 0.002
"""Distance in metres from the joint below which a box gets a hub."""

QUARTER, SIDES = 4, 32
"""Facets of a quarter of a fillet, and of a full circle."""

TAPERED = {("shadow", "forearm"): 0.72}
"""Links whose first cylinder narrows towards the hand -> radius there, as a share."""


def rounded_box(size: Float[np.ndarray, " 3"], fillet: float) -> trimesh.Trimesh:
    """Return a box of `size` (3,) with edges of radius `fillet`, metres: the convex hull of balls in its corners."""
    angle = np.linspace(0.0, np.pi / 2, QUARTER + 1)
    up, around = (grid.ravel() for grid in np.meshgrid(angle, angle))
    octant = fillet * np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=1)
    octant += np.asarray(size) / 2 - fillet
    return _hull(np.concatenate([octant * signs for signs in product((1.0, -1.0), repeat=3)]))


def rounded_cylinder(radius: float, length: float, fillet: float, top: float | None = None) -> trimesh.Trimesh:
    """Return a cylinder along z, or a frustum with the radius `top` above, with rims of radius `fillet`, metres."""
    angle = np.linspace(0.0, np.pi / 2, QUARTER + 1)
    turn = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)
    points = []
    for sign, outer in ((-1.0, radius), (1.0, radius if top is None else top)):
        for a in angle:
            r, z = outer - fillet * (1 - np.cos(a)), sign * (length / 2 - fillet * (1 - np.sin(a)))
            points.append(np.stack([r * np.cos(turn), r * np.sin(turn), np.full(SIDES, z)], axis=1))
    return _hull(np.concatenate(points))


def ball(radius: float) -> trimesh.Trimesh:
    """Return a ball, metres, with the facets of a cylinder around it."""
    turn, up = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False), np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)
    up, turn = (grid.ravel() for grid in np.meshgrid(up, turn))
    return _hull(radius * np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=1))


def link_visual(
    shapes: list[Placed], axis: Float[np.ndarray, " 3"] | None, top: float | None = None
) -> trimesh.Trimesh:
    """Return the visual mesh of a link in its frame, without inner faces.

    Args:
        shapes: Its collision shapes, primitives.
        axis: Axis of the joint at its origin (3,); None: it does not turn.
        top: Radius above of its first cylinder, as a share.
    """
    parts = []
    round_only = all(geometry.kind != "box" for geometry, _ in shapes)
    for geometry, T_link_shape in shapes:
        if geometry.kind == "box":
            size = np.array(geometry.size)
            mesh = rounded_box(size, min(BOX_FILLET_SHARE * size.min(), MAX_FILLET_M))
        elif geometry.kind == "sphere":
            mesh = ball(geometry.size[0])
        else:
            radius, length = geometry.size
            fillet = 0.4 * radius if top is not None else min(RIM_FILLET_M, 0.3 * length)
            mesh = rounded_cylinder(radius, length, fillet, None if top is None else top * radius)
            top = None
        parts.append(mesh.apply_transform(T_link_shape))
    if round_only and len(parts) > 1 and _is_capsule(parts):
        parts = [_hull(np.concatenate([part.vertices for part in parts]))]
    if axis is not None:
        parts += _hubs(shapes, axis)
    whole = parts[0] if len(parts) == 1 else trimesh.boolean.union(parts, engine="manifold")
    whole.merge_vertices()
    return whole


def _hubs(shapes: list[Placed], axis: Float[np.ndarray, " 3"]) -> list[trimesh.Trimesh]:
    """Hub around the joint (0 or 1 cylinders) where a box reaches it."""
    for geometry, T_link_shape in shapes:
        if geometry.kind != "box":
            continue
        R, size = T_link_shape[:3, :3], np.array(geometry.size)
        joint = -R.T @ T_link_shape[:3, 3]
        if (np.abs(joint) - size / 2).max() > HUB_REACH_M:
            continue
        along = int(np.argmax(np.abs(R.T @ axis)))
        thickness = np.delete(size, along).min()
        if size[along] < HUB_WIDTH_SHARE * thickness:
            continue
        middle = np.where(np.arange(3) == along, 0.0, joint)
        hub = rounded_cylinder(HUB_SHARE * thickness / 2, HUB_LENGTH_SHARE * size[along], RIM_FILLET_M)
        T = np.eye(4)
        T[:3, :3] = np.column_stack([tangents(axis), axis])
        T[:3, 3] = R @ middle + T_link_shape[:3, 3]
        return [hub.apply_transform(T)]
    return []


def _is_capsule(parts: list[trimesh.Trimesh]) -> bool:
    """Return whether some round shapes fill their convex hull but for a few per cent."""
    hull = _hull(np.concatenate([part.vertices for part in parts]))
    return trimesh.boolean.union(parts, engine="manifold").volume > 0.93 * hull.volume


def _hull(points: Float[np.ndarray, "N 3"]) -> trimesh.Trimesh:
    return trimesh.Trimesh(points).convex_hull


def write_visuals(name: str, folder: Path) -> int:
    """Write the visual meshes of a hand and name them in its URDF; return their bytes."""
    urdf = folder / f"{name}.urdf"
    tree = read_tree(urdf)
    axis = {joint.child: joint.axis for joint in tree.joints.values() if joint.kind in ("revolute", "continuous")}
    text, out = urdf.read_text(encoding="utf-8"), folder / "visual"
    out.mkdir(exist_ok=True)
    for path in out.glob("*.ply"):
        path.unlink()
    written: dict[str, str] = {}
    for link in tree.links.values():
        shapes = [
            (shape.geometry, shape.T_link_shape) for shape in link.collisions if isinstance(shape.geometry, Primitive)
        ]
        if not shapes:
            continue
        mesh = link_visual(shapes, axis.get(link.name), TAPERED.get((name, link.name)))
        data = trimesh.exchange.ply.export_ply(_rounded(mesh), vertex_normal=False)
        digest = hashlib.sha256(data).hexdigest()
        if digest not in written:
            written[digest] = f"{link.name.replace('.', '_')}.ply"
            (out / written[digest]).write_bytes(data)
        text = _with_visual(text, link.name, f"visual/{written[digest]}")
    urdf.write_text(text, encoding="utf-8")
    return sum(path.stat().st_size for path in out.iterdir())


def _rounded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Mesh on a grid of a micrometre, so that equal links of several fingers have equal files."""
    found = mesh.copy()
    found.vertices = np.round(found.vertices, 6) + 0.0
    return found


def _with_visual(text: str, link: str, file: str) -> str:
    """Text of a URDF with one visual mesh of a link in place of all its visuals; its first material stays."""
    block = re.search(rf'<link name="{re.escape(link)}">.*?</link>', text, re.DOTALL)
    assert block is not None, link
    inside = block[0]
    visuals = re.findall(r"    <visual>.*?</visual>\n", inside, re.DOTALL)
    assert visuals, f"{link} has no visual"
    material = re.search(r"<material [^>]*/>", visuals[0])
    assert material is not None, f"the visual of {link} has no material"
    new = f'    <visual>\n      <geometry><mesh filename="{file}"/></geometry>\n      {material[0]}\n    </visual>\n'
    rest = inside.replace(visuals[0], "@", 1)
    for other in visuals[1:]:
        rest = rest.replace(other, "", 1)
    return text.replace(inside, rest.replace("@", new, 1))


def main() -> None:
    """Write the visual meshes of all hands."""
    for name in HANDS:
        print(f"{name}: {write_visuals(name, resource_dir('robots') / name) / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
