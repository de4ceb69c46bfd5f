"""Pictures of triangle meshes in NumPy alone: a z-buffer, one light with a shadow, dark outlines, translucent bodies.

It needs neither a screen nor a graphics driver, so that pictures and films can be made on any machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.z_buffer import rasterize

if TYPE_CHECKING:
    import trimesh

DIRECTIONAL_SHARE = 0.5
"""Share of the directional light; the rest comes from all sides, more of it from above."""
SHINE_SQUARINGS = 5
"""Times that the cosine of a reflection is squared, which makes highlights small."""
SHADOW_BIAS = 0.006
"""Distance behind the depth of the shadow map from which a point lies in shadow, in heights of the picture."""
CREASE_DEG = 35.0
"""Angle above which edges are shaded as sharp, degrees."""
OUTLINE_STEP, CREASE_STEP = 0.03, 0.0025
"""Depth step between neighbouring pixels that is drawn as an outline, in heights of the picture: in a model, between
two models."""


@dataclass(frozen=True, eq=False)
class Model:
    """A coloured mesh in world coordinates."""

    vertices: Float[np.ndarray, "V 3"]
    """Vertices (V, 3), world frame, metres."""
    normals: Float[np.ndarray, "V 3"]
    """Unit normals (V, 3) of the vertices; shading is smooth between them."""
    faces: Int[np.ndarray, "F 3"]
    """Vertex indices (F, 3)."""
    color: tuple[float, float, float]
    """Red, green and blue in [0, 1]."""
    opacity: float = 1.0
    """Opacity; opaque models show through models below 1."""

    @staticmethod
    def of(
        meshes: trimesh.Trimesh | Sequence[trimesh.Trimesh], color: tuple[float, float, float], opacity: float = 1.0
    ) -> Model:
        """Make one model of meshes with smooth shading, except across edges sharper than `CREASE_DEG`."""
        import trimesh

        mesh = trimesh.util.concatenate(meshes)
        assert isinstance(mesh, trimesh.Trimesh)
        smooth = trimesh.graph.smooth_shade(mesh, angle=np.radians(CREASE_DEG))
        vertices, normals = np.asarray(smooth.vertices), np.asarray(smooth.vertex_normals)
        return Model(vertices, normals, np.asarray(smooth.faces), color, opacity)

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Model:
        """Return the model moved by a pose (4, 4)."""
        return replace(self, vertices=transform_points(T, self.vertices), normals=self.normals @ T[:3, :3].T)


@dataclass(frozen=True, eq=False)
class Camera:
    """A parallel projection."""

    direction: np.ndarray
    """Direction from the target to the camera (3,), of any length, world frame."""
    target: np.ndarray
    """Target point (3,), world frame, metres; lies in the middle of the picture."""
    width: int
    """Width of the picture, pixels."""
    height: int
    """Height of the picture, pixels."""
    extent: float
    """Visible height, metres."""

    @classmethod
    def fitted(
        cls, direction: np.ndarray, points: Float[np.ndarray, "N 3"], width: int, height: int, margin: float = 0.08
    ) -> Camera:
        """Return the camera in a `direction` (3,) in whose picture points (N, 3) just fit.

        Args:
            direction: Direction towards the camera (3,), world frame.
            points: Points to be seen, metres.
            width: Width of the picture, pixels.
            height: Height of the picture, pixels.
            margin: Free share of the picture.
        """
        camera = cls(direction, np.zeros(3), width, height, 1.0)
        at = points @ camera.axes.T
        low, high = at.min(axis=0), at.max(axis=0)
        right, down, _ = high - low
        extent = (1.0 + margin) * max(down, right * height / width)
        return replace(camera, target=(low + high) / 2 @ camera.axes, extent=float(extent))

    @cached_property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Unit vectors to the right, down and forward, as rows, world frame; world z is up in the picture."""
        forward = -self.direction / np.linalg.norm(self.direction)
        # Straight up or down, y is up in the picture.
        right = np.cross(forward, [0.0, 0.0, 1.0] if abs(forward[2]) < 0.999 else [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    @property
    def _scale(self) -> np.ndarray:
        """Pixels in a metre to the right and down, and 1 for the depth."""
        return np.array([self.height / self.extent, self.height / self.extent, 1.0])

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Pixel coordinates x (right) and y (down), and depth behind the target in metres, of world points."""
        return (points - self.target) @ self.axes.T * self._scale + [0.5 * self.width, 0.5 * self.height, 0.0]

    def lift(self, pixels: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """World points at pixel coordinates and depths in metres; undoes `project`."""
        return (pixels - [0.5 * self.width, 0.5 * self.height, 0.0]) / self._scale @ self.axes + self.target


def render(models: Sequence[Model], camera: Camera, light: np.ndarray) -> Float[np.ndarray, "H W 4"]:
    """Render `models`: red, green, blue in [0, 1], times the opacity, and the opacity, 0 where there is no model.

    Args:
        models: Shown models; surfaces seen from behind are lit as from the front. Translucent ones hide each other.
        camera: Camera; render at twice the final size and average for smooth edges.
        light: Direction towards the light (3,), world frame.
    """
    scene = _Scene(models, camera, np.asarray(light, dtype=float) / np.linalg.norm(light))
    opacity = np.array([model.opacity for model in models])
    solid = scene.rasterize(opacity[scene.owner] == 1.0)
    glass = scene.rasterize(opacity[scene.owner] < 1.0)
    nearer = glass[1] < solid[1]
    face, depth = np.where(nearer, glass[0], solid[0]), np.where(nearer, glass[1], solid[1])
    share = np.where(nearer, opacity[scene.owner[face]], 1.0)[..., None]
    return share * scene.shade(face, depth) + (1.0 - share) * scene.shade(*solid, nearer)


def count_owners(models: Sequence[Model], camera: Camera) -> Int[np.ndarray, " M"]:
    """Return the number of pixels (M,) in which each model is the nearest."""
    scene = _Scene(models, camera, np.zeros(3))
    face, _ = scene.rasterize(np.ones(len(scene.faces), dtype=bool))
    return np.bincount(scene.owner[face[face >= 0]], minlength=len(models))


class _Scene:
    """Triangles of all models, seen by a camera."""

    def __init__(self, models: Sequence[Model], camera: Camera, light: Float[np.ndarray, " 3"]) -> None:
        self.models, self.camera, self.light = models, camera, light
        self.vertices = np.concatenate([model.vertices for model in models])
        self.normals = np.concatenate([model.normals for model in models])
        starts = np.cumsum([0, *(len(model.vertices) for model in models)])
        self.faces = np.concatenate([model.faces + start for model, start in zip(models, starts[:-1], strict=True)])
        self.owner = np.repeat(np.arange(len(models)), [len(model.faces) for model in models])

    def rasterize(self, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest of the faces that are `drawn` (F,), and its depth, as `_rasterize`."""
        number = np.flatnonzero(drawn)
        nearest, depth = _rasterize(self.vertices, self.faces[number], self.camera)
        return np.append(number, -1)[nearest], depth

    def shade(
        self,
        face: Int[np.ndarray, "H W"],
        depth: Float[np.ndarray, "H W"],
        wanted: Bool[np.ndarray, "H W"] | None = None,
    ) -> Float[np.ndarray, "H W 4"]:
        """Colours of the faces seen, and 1, with dark outlines; 0 where there is none, or where none is `wanted`."""
        camera = self.camera
        pixel = np.flatnonzero((face >= 0) if wanted is None else (face >= 0) & wanted)
        seen = face.ravel()[pixel]
        x, y = pixel % camera.width + 0.5, pixel // camera.width + 0.5
        point, view = camera.lift(np.stack([x, y, depth.ravel()[pixel]], axis=-1)), -camera.axes[2]
        corners = self.faces[seen].T
        weight = _weights(self._on_screen[:, 0][corners], self._on_screen[:, 1][corners], x, y)
        normal = sum(part[:, None] * self.normals[corner] for part, corner in zip(weight, corners, strict=True))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal *= np.where(normal @ view < 0, -1.0, 1.0)[:, None]
        lit = np.clip(normal @ self.light, 0.0, 1.0)
        facing = np.flatnonzero(lit)
        lit[facing] *= self._unshadowed(point[facing], normal[facing])
        mirrored = np.clip(normal @ (view + self.light) / max(np.linalg.norm(view + self.light), 1e-12), 0.0, 1.0)
        for _ in range(SHINE_SQUARINGS):
            mirrored *= mirrored
        shine = 0.12 * lit * mirrored
        brightness = DIRECTIONAL_SHARE * lit + (1.0 - DIRECTIONAL_SHARE) * (0.95 + 0.2 * normal[:, 2])
        colors = np.array([model.color for model in self.models])[self.owner[seen]]
        image = np.zeros((*face.shape, 4))
        image.reshape(-1, 4)[pixel, :3] = np.clip(colors * brightness[:, None] + shine[:, None], 0.0, 1.0)
        image.reshape(-1, 4)[pixel, 3] = 1.0
        image[_outline(np.where(face >= 0, self.owner[face], -1), depth / camera.extent), :3] *= 0.45
        return image

    @cached_property
    def _on_screen(self) -> Float[np.ndarray, "V 3"]:
        return self.camera.project(self.vertices)

    @cached_property
    def _shadow_map(self) -> tuple[Camera, Float[np.ndarray, "S S"]]:
        """Camera that looks along the light at all models, and the depths that it sees."""
        center = self.vertices.mean(axis=0)
        reach = float(np.linalg.norm(self.vertices - center, axis=1).max())
        size = self.camera.height
        camera = Camera(self.light, center, size, size, 2.0 * reach)
        return camera, _rasterize(self.vertices, self.faces, camera)[1]

    def _unshadowed(self, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Share of the light that reaches each point, 0 to 1."""
        camera, depths = self._shadow_map
        # No less than two pixels of the map.
        bias = max(SHADOW_BIAS * self.camera.extent, 2.0 * camera.extent / camera.height)
        farthest, size = depths.ravel() + bias, camera.height
        x, y, depth = camera.project(point + bias * normal).T
        # Nine neighbours soften the edge.
        columns, rows = ([np.clip(at + d, 0, size - 1).astype(int) for d in (-1.5, 0.0, 1.5)] for at in (x, y))
        reached = np.zeros(len(point))
        for row in rows:
            for column in columns:
                reached += depth < farthest[row * size + column]
        return reached / 9.0


def _rasterize(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Nearest face (H, W), -1 for none, and depth (H, W) in metres; of several at the same depth the first face."""
    return rasterize(camera.project(vertices)[faces], (camera.height, camera.width))


def _weights(corner_x: np.ndarray, corner_y: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric weights (3, N) of the corners (3, N) at pixel coordinates x (N,) and y (N,)."""
    (ax, bx, cx), (ay, by, cy) = corner_x, corner_y
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    u = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area  # of b
    v = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area  # of c
    return np.stack([1.0 - u - v, u, v])


def _outline(owner: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Mask (H, W) of the nearer pixels at steps in depth; a smaller step suffices where two models meet."""
    mask = np.zeros(owner.shape, dtype=bool)
    # The second view is transposed, so that the pixel below becomes the one to the right.
    for owners, depths, marked in ((owner, depth, mask), (owner.T, depth.T, mask.T)):
        needed = np.where(owners[:, 1:] == owners[:, :-1], OUTLINE_STEP, CREASE_STEP)
        with np.errstate(invalid="ignore"):
            step = depths[:, 1:] - depths[:, :-1]
        marked[:, :-1] |= step > needed
        marked[:, 1:] |= -step > needed
    return mask
