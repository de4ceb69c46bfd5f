"""Faces of an object that are seen in a rectangle of a picture, painted as faces to touch or to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions, Faces, Region
from grasp_refine.objects.region_spec import numbered_faces
from grasp_refine_apps.viewer.model.names import file_stem

Brush = Literal["off", "touch", "avoid", "erase"]
"""Kind of region to which painted faces are added; erase: they are taken out of both; off: the mouse does not paint."""

SEPARATOR = ";"
"""Sign between the specifications of several regions in one line of text."""

BEHIND_SHARE = 1e-5
"""Share of its distance from the camera by which a point is behind a face that hides it."""

MAX_CELLS = 256
"""Cells of the picture along each side, in which faces are looked for that hide others."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera, and a rectangle of its picture."""

    T_world_camera: Float[np.ndarray, "4 4"]
    """Pose (4, 4): x to the right, y down, z forward."""
    fov: float
    """Vertical opening in radians."""
    aspect: float
    """Width of its picture over the height."""
    low: tuple[float, float]
    """Upper left corner of the rectangle, 0 to 1 from left to right and from top to bottom."""
    high: tuple[float, float]
    """Lower right corner."""


@dataclass(frozen=True, eq=False)
class PaintedFaces:
    """Faces of the mesh of an object."""

    obj: Object
    """The object."""
    triangles: Float[np.ndarray, "F 3 3"]
    """Corners (F, 3, 3) of its triangles, object frame, metres."""
    face: Int[np.ndarray, " F"]
    """Numbers (F,) of their faces in the file of the mesh."""

    @staticmethod
    def of(obj: Object) -> PaintedFaces:
        """Return the faces of an object.

        Raises:
            MeshError: its file cannot be read any more.
        """
        return PaintedFaces(obj, *numbered_faces(obj))

    def stroke(self, regions: ContactRegions, brush: Brush, hit: Bool[np.ndarray, " F"]) -> ContactRegions:
        """Return regions with the faces of the triangles `hit` (F,) painted.

        Faces that were painted, or given by number or colour, are one region then; a face is in one of the two kinds.
        """
        hit = np.isin(self.face, self.face[hit])
        return ContactRegions(
            self._painted(regions.touch, "touch", hit, brush), self._painted(regions.avoid, "avoid", hit, brush)
        )

    def _painted(self, regions: Sequence[Region], verb: str, hit: np.ndarray, brush: Brush) -> tuple[Region, ...]:
        """Return the regions of a kind after a stroke."""
        before = self._of_faces(regions)
        chosen = np.any([np.zeros_like(hit), *(region.chosen for region in before)], axis=0)
        after = chosen | hit if brush == verb else chosen & ~hit
        if np.array_equal(after, chosen):
            return tuple(regions)
        others = tuple(region for region in regions if region not in before)
        spec = f"faces:{faces_file(self.obj, verb)}"
        return (*others, Faces(spec, self.triangles, after)) if after.any() else others

    def text(self, regions: Sequence[Region]) -> str:
        """Return the numbers of the faces of some regions, a line each, as `faces:FILE` reads them; empty: none."""
        chosen = np.any([np.zeros(len(self.face), dtype=bool), *(r.chosen for r in self._of_faces(regions))], axis=0)
        return "".join(f"{number}\n" for number in np.unique(self.face[chosen]))

    def _of_faces(self, regions: Sequence[Region]) -> list[Faces]:
        """Return the regions that are faces of this mesh."""
        return [region for region in regions if isinstance(region, Faces) and len(region.chosen) == len(self.face)]


def faces_file(obj: Object, verb: str) -> str:
    """Return the name of the file of painted faces of an object."""
    return f"{file_stem(obj.name)}_{verb}.txt"


def seen_faces(
    triangles: Float[np.ndarray, "F 3 3"], T_world_object: Float[np.ndarray, "4 4"], camera: Camera
) -> Bool[np.ndarray, " F"]:
    """Return True for the triangles (F,) whose centres are seen in the rectangle of a camera.

    A centre is seen where no other triangle is in front of it. Whether triangles face the camera does not matter:
    triangles at the back of a closed surface are hidden by its front.

    Args:
        triangles: Corners (F, 3, 3) of all triangles of a surface, its frame.
        T_world_object: Pose (4, 4) of the surface.
        camera: The camera.
    """
    corners = transform_points(inverse(camera.T_world_camera) @ T_world_object, triangles.reshape(-1, 3))
    corners = corners.reshape(-1, 3, 3)
    centre = corners.mean(axis=1)
    half = np.tan(camera.fov / 2) * np.array([camera.aspect, 1.0])
    low, high = ((2.0 * np.array(corner) - 1.0) * half for corner in (camera.low, camera.high))
    before = centre[:, 2] > 0.0
    image = centre[:, :2] / np.where(before, centre[:, 2], 1.0)[:, None]
    seen: np.ndarray = before & ((low <= image) & (image <= high)).all(axis=1)
    inside = np.flatnonzero(seen)
    if len(inside):
        seen[inside[_hidden(image[inside], centre[inside, 2], corners[(corners[..., 2] > 0.0).all(axis=1)])]] = False
    return seen


def _hidden(
    image: Float[np.ndarray, "P 2"], depth: Float[np.ndarray, " P"], corners: Float[np.ndarray, "F 3 3"]
) -> Bool[np.ndarray, " P"]:
    """Return True for points (P,) at these places of a picture, and depths in metres, that are behind a triangle."""
    flat = corners[..., :2] / corners[..., 2:]
    # Triangles are looked for in cells of the picture that cover all points.
    count = int(np.clip(np.sqrt(len(corners)), 1, MAX_CELLS))
    low = image.min(axis=0)
    size = np.maximum(np.ptp(image, axis=0), 1e-9) / count
    cell = np.minimum((image - low) // size, count - 1).astype(np.int64)
    first = np.floor((flat.min(axis=1) - low) / size)
    last = np.floor((flat.max(axis=1) - low) / size)
    over = np.flatnonzero(((first < count) & (last >= 0)).all(axis=1))
    first, last = (np.clip(end[over], 0, count - 1).astype(np.int64) for end in (first, last))
    # Triangle by triangle, the cells that its bounding box covers.
    width = last - first + 1
    at, k = _ranges(np.zeros(len(over), dtype=np.int64), width.prod(axis=1))
    covered = (first[at, 0] + k % width[at, 0]) * count + first[at, 1] + k // width[at, 0]
    order = np.argsort(covered, kind="stable")
    covered, triangle = covered[order], over[at[order]]
    # Point by point, the triangles of its cell.
    key = cell[:, 0] * count + cell[:, 1]
    start, end = (np.searchsorted(covered, key, side=side) for side in ("left", "right"))
    point, k = _ranges(start, end - start)
    pair = triangle[k]
    a, b, c = np.moveaxis(flat[pair], 1, 0)
    p = image[point]
    parts = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    area = parts.sum(axis=1)
    solid = np.abs(area) > 0.0
    share = parts / np.where(solid, area, 1.0)[:, None]
    # The inverse of the depth is linear in the picture.
    nearness = (share / corners[pair][..., 2]).sum(axis=1)
    hides = solid & (share >= 0.0).all(axis=1) & (nearness * depth[point] > 1.0 + BEHIND_SHARE)
    hidden = np.zeros(len(image), dtype=bool)
    hidden[point[hides]] = True
    return hidden


def _ranges(start: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all numbers of ranges (R,) from `start`, as many as `count` each, and before them the ranges' numbers."""
    at = np.repeat(np.arange(len(start)), count)
    return at, np.arange(len(at)) - np.repeat(np.cumsum(count) - count, count) + start[at]


def _cross(first: Float[np.ndarray, "N 2"], second: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, " N"]:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def specs_text(regions: Sequence[Region]) -> str:
    """Return the specifications of regions in one line."""
    return f"{SEPARATOR} ".join(region.spec for region in regions)


def given_regions(text: str, known: Sequence[Region]) -> tuple[str | Region, ...]:
    """Return the regions of a line of specifications; known ones, such as painted regions, unchanged."""
    by_spec = {region.spec: region for region in known}
    specs = (part.strip() for part in text.split(SEPARATOR))
    return tuple(by_spec.get(spec, spec) for spec in specs if spec)
