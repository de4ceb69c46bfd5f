"""Procedural objects: the embedded examples, and primitives such as "box:0.06,0.05,0.09"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.pieces import Piece, box, cylinder, sphere

if TYPE_CHECKING:
    import trimesh


def mug() -> trimesh.Trimesh:
    """A mug 9 cm tall and 8 cm wide, its wall 4 mm thick, with a handle towards +x; stands on z = 0."""
    import trimesh

    solid = _lathe([[0.0, 0.0], [3.85, 0.0], [4.0, 0.15], [4.0, 9.0], [0.0, 9.0]], sections=28)
    cavity = _lathe([[0, 0.4], [3.6, 0.4], [3.6, 9.1], [0, 9.1]], sections=28)
    # An elliptic ring in the xz plane; its inner half ends in the wall and is cut off with the cavity.
    handle = trimesh.creation.torus(1, 0.25, major_sections=28, minor_sections=10)
    around, across = handle.vertices[:, :2], handle.vertices[:, 2]
    length = np.linalg.norm(around, axis=1, keepdims=True)
    path = around / length * ([2.1, 2.6] + length - 1)
    handle.vertices = np.stack([3.9 + path[:, 0], -1.6 * across, 4.6 + path[:, 1]], axis=1)
    return _in_metres(trimesh.boolean.difference([trimesh.boolean.union([solid, handle]), cavity]))


def bottle() -> trimesh.Trimesh:
    """A solid bottle 18 cm tall, its body 6 cm and its neck 2.6 cm wide; stands on z = 0."""
    turn = np.linspace(0, np.pi, 9)
    shoulder = np.stack([2.15 + 0.85 * np.cos(turn), 11 + 3 * turn / np.pi], axis=1)
    foot, top = (
        [[0, 0], [2.7, 0], [2.91, 0.09], [3, 0.3]],
        [[1.3, 16.2], [1.45, 16.3], [1.45, 17.8], [1.3, 18]],
    )
    return _in_metres(_lathe(np.concatenate([foot, shoulder, top, [[0, 18]]]), sections=48))


def bowl() -> trimesh.Trimesh:
    """A bowl 13 cm wide and 5 cm tall, its wall 4 mm thick; stands on z = 0."""
    turn = np.linspace(0, np.pi / 2, 9)
    outer = np.stack([2.5 + 4 * np.sin(turn), 5 * (1 - np.cos(turn))], axis=1)
    inner = np.stack([2.5 + 3.6 * np.sin(turn), 5 - 4.6 * np.cos(turn)], axis=1)[::-1]
    return _in_metres(_lathe(np.concatenate([[[0, 0]], outer, inner, [[0, 0.4]]]), sections=32))


def rounded_box() -> trimesh.Trimesh:
    """A box of 6 x 5 x 9 cm with edges rounded at 6 mm (convex), about the origin."""
    core = box([4.8, 3.8, 7.8])
    return _in_metres(Piece(core.vertices, core.faces, radius=0.6).mesh())


EMBEDDED: Mapping[str, Callable[[], trimesh.Trimesh]] = MappingProxyType(
    {"mug": mug, "bottle": bottle, "rounded_box": rounded_box, "bowl": bowl}
)
"""Name -> function that makes the object."""

PRIMITIVES: Mapping[str, int] = MappingProxyType({"box": 3, "sphere": 1, "cylinder": 2})
"""Kind of primitive -> number of its parameters."""


def primitive(spec: str) -> trimesh.Trimesh:
    """Return the mesh of a primitive about the origin: "box:x,y,z", "sphere:r" or "cylinder:r,h" (along z); metres.

    Raises:
        MeshError: another form, or a number that is not positive and finite.
    """
    (piece,) = primitive_pieces(spec)
    return piece.mesh()


def primitive_pieces(spec: str) -> tuple[Piece, ...]:
    """Return the exact convex piece of the primitive `spec` (see `primitive`).

    Raises:
        MeshError: another form, or a number that is not positive and finite.
    """
    kind, _, numbers = spec.partition(":")
    try:
        sizes = [float(number) for number in numbers.split(",")]
    except ValueError:
        sizes = []
    if len(sizes) != PRIMITIVES.get(kind):
        raise MeshError(f"'{spec}' is not a primitive: use box:x,y,z or sphere:r or cylinder:r,h, in metres")
    if kind == "box":
        return (box(sizes),)
    if kind == "sphere":
        return (sphere(*sizes),)
    radius, height = sizes
    return (cylinder(radius, height),)


def _lathe(profile: ArrayLike, sections: int) -> trimesh.Trimesh:
    """Surface of revolution of `profile` (N, 2), radius and height: out from the axis, up, and back to it."""
    import trimesh

    return trimesh.creation.revolve(profile, sections=sections)


def _in_metres(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Convert a mesh from centimetres, in which its triangles exceed the 1e-8 that trimesh drops, to metres."""
    import trimesh

    return trimesh.Trimesh(np.asarray(mesh.vertices) * 0.01, mesh.faces, process=False)
