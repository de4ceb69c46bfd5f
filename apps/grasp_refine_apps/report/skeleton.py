"""Drawable surfaces of hands and objects.

Convex pieces are drawn with fewer corners than they have, which is invisible in a picture and bounds the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.visuals import load_visuals
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.report.drawing import CONTACT_COLOR, LINK_COLOR, OBJECT_COLOR
from grasp_refine_apps.report.rasterizer import Model

if TYPE_CHECKING:
    import trimesh

MAX_FACES = 4000
"""Maximum number of triangles of an object drawn by its mesh; of a finer one, the convex pieces are drawn."""
MAX_LINK_FACES = 2500
"""Maximum number of triangles of a link drawn by its visual meshes."""
MERGE_SHARE = 0.012
"""Share of the whole size within which corners of a convex piece are merged."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Drawable surfaces of a hand, link by link, in link frames."""

    chain: Chain
    """Forward kinematics of the links that have geometry."""
    models: tuple[Model, ...]
    """Surfaces of the links."""
    touching: tuple[bool, ...]
    """True for contact links."""

    @classmethod
    def of(cls, hand: Hand, *, visual: bool = False) -> Skeleton:
        """Make the drawable surfaces of a hand.

        Args:
            hand: The hand.
            visual: Whether links are drawn by their visual meshes, if they have any that are not too fine; takes half
                as long again as convex pieces do.
        """
        links = [link for link in hand.links if link.body is not None]
        chain = Chain(hand, [link.name for link in links])
        resting = chain(np.eye(4)[None], hand.rest[None]).T_world_link[0]
        points = [transform_points(T, link.solid.candidates.points) for T, link in zip(resting, links, strict=True)]
        grid = MERGE_SHARE * np.ptp(np.concatenate(points), axis=0).max()
        touching = tuple(link.name in {contact.link for contact in hand.contacts} for link in links)
        visuals: dict[str, list[trimesh.Trimesh]] = {}
        for found in load_visuals(hand.urdf, hand.links_by_name) if visual else ():
            visuals.setdefault(found.link, []).append(found.mesh)
        models = []
        for link, touches in zip(links, touching, strict=True):
            color, meshes = CONTACT_COLOR if touches else LINK_COLOR, visuals.get(link.name, [])
            coarse = 0 < sum(len(mesh.faces) for mesh in meshes) <= MAX_LINK_FACES
            models.append(Model.of(meshes, color) if coarse else _pieces(link.solid, color, grid))
        return cls(chain, tuple(models), touching)

    def posed(self, T_world_root: Float[np.ndarray, "4 4"], q: Float[np.ndarray, " n"]) -> list[Model]:
        """Return the surfaces of the links in the world frame, at a pose (4, 4) of the hand and joint values (n,)."""
        T = self.chain(T_world_root[None], q[None]).T_world_link[0]
        return [model.moved(pose) for model, pose in zip(self.models, T, strict=True)]


def object_model(obj: Object, opacity: float) -> Model:
    """Return the drawable surface of an object: its mesh, or its pieces if that is too fine."""
    if len(obj.mesh.faces) <= MAX_FACES:
        return Model.of(obj.mesh, OBJECT_COLOR, opacity=opacity)
    return _pieces(obj.body, OBJECT_COLOR, MERGE_SHARE * obj.body.diagonal, opacity)


def _pieces(body: Body, color: tuple[float, float, float], grid: float, opacity: float = 1.0) -> Model:
    """Convex pieces of a body, with corners merged within `grid` metres."""
    return Model.of([_simplified(piece, grid).mesh() for piece in body.pieces], color, opacity=opacity)


def _simplified(piece: Piece, grid: float) -> Piece:
    """Reduce the corners of a convex piece."""
    corners = np.asarray(piece.mesh().vertices)
    _, first = np.unique(np.round((corners - corners.mean(0)) / grid), axis=0, return_index=True)
    try:
        return hull(corners[np.sort(first)])
    except MeshError:
        # A thin one has lost its thickness.
        return piece
