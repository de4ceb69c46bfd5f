"""Nodes that tint the surface of an object where hands may touch it, and where not."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import viser

from grasp_refine.core.array_types import Float, Int
from grasp_refine.objects.region import ContactRegions
from grasp_refine_apps.viewer.drawing.colors import Color
from grasp_refine_apps.viewer.drawing.scene_nodes import Meshes
from grasp_refine_apps.viewer.drawing.shapes import Shape, raised

TOUCH_COLOR, AVOID_COLOR = (70, 175, 90), (215, 65, 55)
"""Colours of the faces where hands may touch, and of the others."""

OPACITY = 0.5
"""Opacity of these faces: the object, and contacts behind it, are seen through them."""

EDGE_SHARE = 0.04
"""Longest edge of the faces, as a share of the diagonal of the object."""


class RegionNodes:
    """Tinted faces of one object, made anew for other regions."""

    def __init__(self, scene: viser.SceneApi, name: str, surface: Shape) -> None:
        """Start without faces; they will be nodes below `name`.

        Args:
            scene: Scene of the nodes.
            name: Name of their parent, which is in the object's frame.
            surface: Surface of the object.
        """
        self._scene, self._name, self._surface = scene, name, surface
        self._drawn: ContactRegions | None = None
        self.meshes: list[Meshes] = []
        """Faces where hands may touch, and the others; none without regions."""

    def draw(self, regions: ContactRegions | None) -> None:
        """Tint the faces by their centres; None: none."""
        if regions is self._drawn:
            return
        self._drawn = regions
        while self.meshes:
            self.meshes.pop().remove()
        if regions is None:
            return
        vertices, faces = self._fine
        allowed = regions.signed_distance(vertices[faces].mean(axis=1))[0] <= 0.0
        for part, color, name in ((allowed, TOUCH_COLOR, "touch"), (~allowed, AVOID_COLOR, "avoid")):
            shapes = [_part(self._surface_lifted, faces[part], color)] if part.any() else []
            self.meshes.append(
                Meshes(self._scene, f"{self._name}/{name}", shapes, opacity=OPACITY, shadow=False, side="front")
            )

    @cached_property
    def _fine(self) -> tuple[Float[np.ndarray, "V 3"], np.ndarray]:
        """Vertices (V, 3) and triangles (F, 3) of the surface, small enough for the border of a region."""
        vertices = self._surface.vertices.astype(float)
        edge = EDGE_SHARE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        vertices, faces = bisected(vertices, self._surface.faces.astype(np.int64), edge)
        # Walls are drawn before objects behind them, which does not shine through some of their triangles then.
        away = np.linalg.norm(vertices[faces].mean(axis=1) - vertices.mean(axis=0), axis=1)
        return vertices, faces[np.argsort(-away)]

    @cached_property
    def _surface_lifted(self) -> Float[np.ndarray, "V 3"]:
        """The vertices (V, 3) in front of the surface."""
        return raised(*self._fine)


def bisected(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], edge: float
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Return a mesh whose triangles are cut in two at the middle of their longest edge while that is over `edge`.

    Of thin triangles only the length is cut, so that they stay few.
    """
    while True:
        first, second = faces, np.roll(faces, -1, axis=1)
        length = np.linalg.norm(vertices[first] - vertices[second], axis=-1)
        long = np.flatnonzero(length.max(axis=1, initial=0.0) > edge)
        if not len(long):
            return vertices, faces
        turn = (length[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[long], turn, axis=1).T
        ends, at = np.unique(np.sort(np.stack([a, b], axis=1), axis=1), axis=0, return_inverse=True)
        middle = len(vertices) + at.reshape(-1)
        vertices = np.concatenate([vertices, vertices[ends].mean(axis=1)])
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        faces = np.concatenate([np.delete(faces, long, axis=0), *halves])


def _part(vertices: Float[np.ndarray, "V 3"], faces: np.ndarray, color: Color) -> Shape:
    """Return some triangles of a surface as a shape."""
    used, index = np.unique(faces, return_inverse=True)
    return Shape(vertices[used].astype(np.float32), index.reshape(-1, 3).astype(np.uint32), color)
