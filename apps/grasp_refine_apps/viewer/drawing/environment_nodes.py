"""Nodes of the bodies around an object: tables, bins, walls and other objects of its scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.scene.environment import Environment
from grasp_refine_apps.viewer.drawing.colors import Color, tinted
from grasp_refine_apps.viewer.drawing.scene_nodes import Meshes, place
from grasp_refine_apps.viewer.drawing.shapes import pieces_shape

FIXED_COLOR, MOVABLE_COLOR = (200, 190, 175), (176, 198, 160)
"""Colours of fixed bodies, and of bodies that a simulation may push."""

OPACITY = 0.55
"""Opacity of bodies beside the object, so that bins and shelves do not hide the hand."""

BASE_M = 0.005
"""Height in metres above the lowest point of the object up to which pieces of bodies are below it: they are opaque."""


class EnvironmentNodes:
    """Bodies around an object, in the object's frame."""

    def __init__(self, scene: viser.SceneApi, name: str, environment: Environment, obj: Body) -> None:
        """Make nodes for each body, below the node `name`; `obj` is the object."""
        self._environment = environment
        up = environment.up
        base = min(_heights(piece, up).min() for piece in obj.pieces) + BASE_M
        self.lowest = np.inf
        """Height in metres of the lowest point of all bodies over the object's origin."""
        self.frames: list[viser.FrameHandle] = []
        """Frame of each body."""
        self.meshes: list[Meshes] = []
        """Meshes of each body: below the object, and beside it."""
        self._opaque: list[list[Any]] = []
        for k, (body, T) in enumerate(zip(environment.bodies, environment.T_object_body, strict=True)):
            below: list[Piece] = []
            beside: list[Piece] = []
            for piece in body.body.pieces:
                heights = _heights(piece.transformed(T), up)
                (below if heights.max() < base else beside).append(piece)
                self.lowest = min(self.lowest, float(heights.min()))
            color = MOVABLE_COLOR if body.movable else FIXED_COLOR
            shapes = [pieces_shape(pieces, color) for pieces in (below, beside) if pieces]
            self.frames.append(scene.add_frame(f"{name}/{k}", show_axes=False))
            meshes = Meshes(scene, f"{name}/{k}/mesh", shapes, opacity=OPACITY)
            self.meshes.append(meshes)
            self._opaque.append(meshes.nodes[:1] if below else [])
        self.move({})
        self.tint((), FIXED_COLOR)

    def move(self, T_object_body: Mapping[str, Float[np.ndarray, "4 4"]]) -> None:
        """Put bodies at poses (4, 4) in the object's frame, by name, and all others where the scene has them."""
        for frame, body, T in zip(self.frames, self._environment.bodies, self._environment.T_object_body, strict=True):
            place(frame, T_object_body.get(body.name, T))

    def tint(self, bodies: Collection[str], color: Color) -> None:
        """Tint some bodies with a colour, and show the others in their own."""
        for meshes, body in zip(self.meshes, self._environment.bodies, strict=True):
            for shape, node in zip(meshes.shapes, meshes.nodes, strict=True):
                node.color = tinted(shape.color, color) if body.name in bodies else shape.color
        for nodes, body in zip(self._opaque, self._environment.bodies, strict=True):
            for node in nodes:
                # What is in a body is seen in it.
                node.opacity = OPACITY if body.name in bodies else None


def _heights(piece: Piece, up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " V"]:
    """Heights (V,) of the corners of a piece along `up` (3,), metres."""
    return np.asarray(piece.mesh().vertices) @ up
