"""Shapes of a hand and an object for display: coloured triangle meshes in their own frames, and poses of the links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from grasp_refine.core.array_types import Float, Float32, Int, UInt32
from grasp_refine.core.errors import HandError
from grasp_refine.geometry.pieces import Piece, joined_mesh
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.visuals import load_visuals
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.viewer.drawing.colors import Color

if TYPE_CHECKING:
    import trimesh

LINK_COLOR, CONTACT_COLOR, OBJECT_COLOR = (189, 194, 204), (242, 184, 102), (168, 199, 237)
"""Colours of links, of links that should touch, and of the object."""

PIECE_COLORS = (
    (168, 199, 237),
    (186, 222, 196),
    (214, 196, 232),
    (240, 220, 170),
    (170, 219, 222),
    (236, 196, 202),
    (205, 214, 158),
    (190, 190, 226),
)
"""Colours of the convex pieces of the object; neighbours differ."""

URDF_COLOR_SHARE = 0.3
"""Share of the colour that the URDF gives a link; the rest is `LINK_COLOR`, so that black links show on black."""

CREASE_ANGLE_DEG = 35.0
"""Angle in degrees above which an edge is drawn sharp; the rest is smooth."""

MAX_FACES = 20_000
"""Maximum faces of a drawn mesh; larger ones are decimated."""

MAX_KEPT_HANDS = 4
"""Hands whose visual shapes are kept in memory."""

LIFT_M = 1.5e-4
"""Height in metres over a surface at which a drawing on it is in front of it."""

CELL_GROWTH = 1.25
"""Factor from one size of the cells of decimation to the next."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A coloured triangle mesh; vertices are doubled at sharp edges, so that smooth shading shows these."""

    vertices: Float32[np.ndarray, "V 3"]
    """Vertices (V, 3) in metres, in the frame of the link or object."""
    faces: UInt32[np.ndarray, "F 3"]
    """Triangles (F, 3), counter-clockwise seen from outside."""
    color: Color
    """Red, green and blue, 0 to 255."""
    link: str = ""
    """Name of the link; empty for objects."""
    faded: bool = False
    """Whether it is drawn faded: a forearm, or an arm, which takes no part in a grasp."""


def visual_shapes(hand: Hand, say: Callable[[str], None] = lambda line: None) -> tuple[Shape, ...]:
    """Return the visual shapes of a hand, one per link, in the order of `hand.links`.

    A link without a readable <visual> has its collision geometry, if any. `say` is called with a line about each
    <visual> that cannot be read.
    """
    shapes, unread = _read_shapes(hand)
    for line in unread:
        say(line)
    return shapes


@lru_cache(MAX_KEPT_HANDS)
def _read_shapes(hand: Hand) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    """Return the visual shapes of a hand, and lines about shapes that cannot be read; each page draws them again."""
    unread: list[str] = []
    try:
        visuals = load_visuals(hand.urdf, hand.links_by_name, unread.append)
    except HandError as error:
        unread.append(str(error))
        visuals = []
    shapes = []
    for link in hand.links:
        own = [visual for visual in visuals if visual.link == link.name]
        if own:
            color = next((visual.color for visual in own if visual.color is not None), None)
            shapes.append(_link_shape(hand, link.name, [visual.mesh for visual in own], color))
        elif link.body is not None:
            shapes.append(_link_shape(hand, link.name, [piece.mesh() for piece in link.body.pieces]))
    behind = forearm(hand)
    return tuple(replace(shape, faded=shape.link in behind) for shape in shapes), tuple(unread)


def forearm(hand: Hand) -> frozenset[str]:
    """Return the links behind the palm, such as a forearm: all links that touch hang on them, through a further one."""
    above = {joint.child: joint.parent for joint in hand.joints}

    def chain(link: str) -> list[str]:
        """Links from the base to this one."""
        found = [link]
        while found[-1] in above:
            found.append(above[found[-1]])
        return found[::-1]

    chains = [chain(link) for link in dict.fromkeys(contact.link for contact in hand.contacts)]
    if len(chains) < 2:
        return frozenset()
    shared = [links[0] for links in zip(*chains, strict=False) if len(set(links)) == 1]
    moving = {joint.child for joint in hand.joints if joint.kind != "fixed"}
    # What is fixed to the palm is part of it.
    last = max((at for at, link in enumerate(shared) if link in moving), default=0)
    return frozenset(shared[:last])


def collision_shapes(hand: Hand) -> tuple[Shape, ...]:
    """Return the collision shapes of a hand: all convex pieces of a link as one, in the order of `hand.links`."""
    return tuple(
        _link_shape(hand, link.name, [piece.mesh() for piece in link.body.pieces])
        for link in hand.links
        if link.body is not None
    )


def object_shapes(obj: Object, kind: Literal["mesh", "pieces"]) -> tuple[Shape, ...]:
    """Return the surface of an object as one shape, or its convex pieces, a shape each in its own colour."""
    if kind == "mesh":
        return (Shape(*_arrays(obj.mesh), OBJECT_COLOR),)
    return tuple(
        Shape(*_arrays(piece.mesh()), PIECE_COLORS[number % len(PIECE_COLORS)])
        for number, piece in enumerate(obj.body.pieces)
    )


def pieces_shape(pieces: Sequence[Piece], color: Color) -> Shape:
    """Return convex pieces as one shape."""
    return Shape(*_arrays(joined_mesh(pieces)), color)


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Poses of all links of a hand; built once for a hand, then called for each pose."""

    chain: Chain
    """Kinematics of all links."""

    @staticmethod
    def of(hand: Hand) -> LinkPoses:
        """Build the kinematics of a hand."""
        return LinkPoses(Chain(hand, [link.name for link in hand.links]))

    def __call__(
        self, T_object_root: Float[np.ndarray, "4 4"], q: Float[np.ndarray, " n"]
    ) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return the pose (4, 4) of each link, including links without a shape, in the object's frame, by name."""
        return dict(zip(self.chain.links, self.chain(T_object_root[None], q[None]).T_world_link[0], strict=True))


def _link_shape(
    hand: Hand, link: str, meshes: Sequence[trimesh.Trimesh], color: tuple[float, float, float] | None = None
) -> Shape:
    """Shape of some meshes together; `color` (red, green and blue in [0, 1]) is that of the URDF."""
    import trimesh

    whole = trimesh.util.concatenate(list(meshes))
    assert isinstance(whole, trimesh.Trimesh)
    vertices, faces = _arrays(whole)
    if any(contact.link == link for contact in hand.contacts):
        return Shape(vertices, faces, CONTACT_COLOR, link)
    if color is None:
        return Shape(vertices, faces, LINK_COLOR, link)
    red, green, blue = (
        round(255 * URDF_COLOR_SHARE * own + (1 - URDF_COLOR_SHARE) * quiet)
        for own, quiet in zip(color, LINK_COLOR, strict=True)
    )
    return Shape(vertices, faces, (red, green, blue), link)


def _arrays(mesh: trimesh.Trimesh) -> tuple[Float32[np.ndarray, "V 3"], UInt32[np.ndarray, "F 3"]]:
    """Vertices and faces of a mesh for browsers: decimated, and with sharp edges kept sharp."""
    import trimesh

    small = decimate(mesh, MAX_FACES)
    shown = trimesh.graph.smooth_shade(small, angle=np.radians(CREASE_ANGLE_DEG))
    return np.asarray(shown.vertices, dtype=np.float32), np.asarray(shown.faces, dtype=np.uint32)


def decimate(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """Return a mesh of at most `max_faces` triangles; the input if it has no more.

    All vertices in one cell of a grid are merged at their mean (Rossignac and Borrel 1993, "Multi-resolution 3D
    approximations"), so that no vertex moves by more than the diagonal of a cell; the cells are about as small as
    `max_faces` allows. Duplicate and degenerate triangles are dropped.
    """
    import trimesh

    if len(mesh.faces) <= max_faces:
        return mesh
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces)
    low = vertices.min(axis=0)
    # A surface of area A has about A / size^2 cells, and two triangles in each.
    size = np.sqrt(mesh.area / max_faces)
    while True:
        place = np.floor((vertices - low) / size).astype(np.int64)
        _, cell, count = np.unique(
            np.ravel_multi_index(place.T, place.max(axis=0) + 1), return_inverse=True, return_counts=True
        )
        joined = cell[faces]
        a, b, c = joined.T
        joined = joined[(a != b) & (b != c) & (c != a)]
        first = np.unique(np.sort(joined, axis=1), axis=0, return_index=True)[1]
        if len(first) <= max_faces:
            break
        size *= CELL_GROWTH
    means = np.stack([np.bincount(cell, vertices[:, axis]) for axis in range(3)], axis=1) / count[:, None]
    return trimesh.Trimesh(means, joined[np.sort(first)], process=False)


def raised(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Return the vertices (V, 3) of a surface `LIFT_M` over it, along their normals."""
    import trimesh

    return vertices + LIFT_M * np.asarray(trimesh.Trimesh(vertices, faces, process=False).vertex_normals)
