"""Voxels: solids on a grid, and their few convex pieces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.geometry.sphere_points import on_sphere

MAX_PIECES = 16
"""Most convex pieces of a solid."""

HOLLOW = 0.05
"""Fraction of a solid by which the hulls of its pieces may be larger, without the steps of its surface."""

STEPS = 0.3
"""Mean height in cells of the hull of a convex solid above its steps."""

MOST_STEPS = 0.22
"""Largest share of the steps in the volume of a hull: thin walls are more than their steps."""

CUTS = 5
"""Places of a cut along each axis."""

SUPPORTS = on_sphere(160)
"""Directions (D, 3); a hull keeps the outermost points along them."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Cubic cells along the axes."""

    low: Float[np.ndarray, 3]
    """Lower corner, metres."""
    size: float
    """Edge of a cell, metres."""
    shape: tuple[int, int, int]
    """Numbers of cells."""

    @classmethod
    def around(cls, low: np.ndarray, high: np.ndarray, cells: int) -> Grid:
        """Grid of about as many cells over a box."""
        size = float((np.prod(high - low) / cells) ** (1 / 3))
        x, y, z = np.ceil((high - low) / size).astype(int).tolist()
        return cls(low, size, (x, y, z))

    @cached_property
    def centers(self) -> Float[np.ndarray, "n 3"]:
        """Centres of all cells, metres."""
        return self.low + (np.indices(self.shape).reshape(3, -1).T + 0.5) * self.size

    def cells(self, points: Float[np.ndarray, "... 3"]) -> Int[np.ndarray, ...]:
        """Indices of the cells that hold the points; outside the grid the nearest ones."""
        index = ((points - self.low) / self.size).astype(int)
        x, y, z = (index[..., axis].clip(0, self.shape[axis] - 1) for axis in range(3))
        flat: np.ndarray = (x * self.shape[1] + y) * self.shape[2] + z
        return flat


_Part = tuple[Bool[np.ndarray, "x y z"], float, float]
"""Cells of a part, the volume of its hull and by how much that is larger, in cells."""


def outermost(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Outermost points (m, 3) of `points` (n, 3) in each of the directions `SUPPORTS`."""
    return points[np.unique((SUPPORTS @ points.T).argmax(axis=1))]


def indicator(
    grid: Grid, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "x y z"]:
    """Return a function (x, y, z) of the cells that is positive in the solid of points (n, 3) with outward normals.

    Its gradient is nearest to the inward normals: it solves a Poisson equation, here by Fourier transform, and is 0 on
    average at the points. Where there are none, the solid closes smoothly (Kazhdan, "Reconstruction of Solid Models
    from Oriented Point Sets", 2005).
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    cell = grid.cells(points)
    # Each cell of the surface counts once, however many points it has.
    count = np.maximum(np.bincount(cell, minlength=int(np.prod(grid.shape))), 1)
    means = [-np.bincount(cell, n, len(count)) / count for n in normals.T]
    field = np.fft.rfftn([gaussian_filter(mean.reshape(grid.shape), 1.0) for mean in means], axes=(1, 2, 3))
    x, y = (2.0 * np.pi * np.fft.fftfreq(n) for n in grid.shape[:2])
    waves = np.stack(np.meshgrid(x, y, 2.0 * np.pi * np.fft.rfftfreq(grid.shape[2]), indexing="ij"))
    squared = (waves**2).sum(axis=0)
    squared.flat[0] = 1.0
    inside = np.fft.irfftn(-1j * (waves * field).sum(axis=0) / squared, s=grid.shape, axes=(0, 1, 2))
    places = ((points - grid.low) / grid.size - 0.5).T
    result: np.ndarray = inside - map_coordinates(inside, places, order=1, mode="nearest").mean()
    return result


def split(grid: Grid, solid: Bool[np.ndarray, "x y z"], surface: Float[np.ndarray, "n 3"]) -> list[Piece]:
    """Return convex pieces that cover a solid of cells, and the points (n, 3) on its surface.

    Cuts run along planes of the grid, through the part whose hull is most hollow, until all hulls together are
    larger than the solid by at most `HOLLOW`.
    """
    from scipy.spatial import cKDTree

    coarse = _blocks(solid)
    parts = [(coarse, *_hollow(coarse))]
    while len(parts) < MAX_PIECES and sum(hollow for _, _, hollow in parts) > HOLLOW * coarse.sum():
        parts += _best_cut(parts.pop(max(range(len(parts)), key=lambda index: parts[index][2])))
    centers = grid.centers
    filled = np.flatnonzero(solid)
    distance, nearest = cKDTree(centers[filled]).query(surface)
    surface, nearest = surface[distance < grid.size], filled[nearest[distance < grid.size]]
    pieces = []
    for blocks, _, _ in parts:
        part = solid & blocks.repeat(2, 0).repeat(2, 1).repeat(2, 2)[tuple(map(slice, solid.shape))]
        touching = (_grown(part) & solid).ravel()
        points = np.concatenate([centers[touching], surface[part.ravel()[nearest]]])
        try:
            pieces.append(hull(outermost(points)))
        except MeshError:  # a flat part: one layer of cells
            corners = points[:, None] + 0.5 * grid.size * SUPPORTS[::20]
            pieces.append(hull(outermost(corners.reshape(-1, 3))))
    return pieces


def _blocks(solid: np.ndarray) -> np.ndarray:
    """Blocks of 2 x 2 x 2 cells with a cell of a solid: cuts run between them."""
    even = np.pad(solid, [(0, n % 2) for n in solid.shape])
    x, y, z = np.array(even.shape) // 2
    return np.asarray(even.reshape(x, 2, y, 2, z, 2).any(axis=(1, 3, 5)))


def _best_cut(part: _Part) -> list[_Part]:
    """Two sides of a part, whose hulls are the smallest together; the part itself where nothing can be cut."""
    sides = [[(side, *_hollow(side)) for side in cut] for cut in _cuts(part[0])]
    return min(sides, key=lambda cut: cut[0][1] + cut[1][1], default=[(*part[:2], 0.0)])


def _cuts(part: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of sides of a part."""
    for axis in range(3):
        layers = np.flatnonzero(part.any(axis=tuple({0, 1, 2} - {axis})))
        places = np.unique(np.linspace(layers[0], layers[-1] + 1, CUTS + 2).astype(int)[1:-1])
        for place in places[(places > layers[0]) & (places <= layers[-1])]:
            one, other = part.copy(), part.copy()
            lead = (slice(None),) * axis
            one[(*lead, slice(place, None))] = False
            other[(*lead, slice(None, place))] = False
            yield one, other


def _hollow(part: np.ndarray) -> tuple[float, float]:
    """Volume in cells of the hull of a part, and by how much it is larger than the part without its steps."""
    from scipy.spatial import ConvexHull

    corners = np.zeros(np.array(part.shape) + 1, dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        corners[tuple(slice(c, c + n) for c, n in zip(corner, part.shape, strict=True))] |= part
    columns = np.argwhere(corners.any(axis=2))
    rows = corners[columns[:, 0], columns[:, 1]]
    low, high = rows.argmax(axis=1), corners.shape[2] - 1 - rows[:, ::-1].argmax(axis=1)
    whole = ConvexHull(np.concatenate([np.column_stack([columns, low]), np.column_stack([columns, high])]))
    return float(whole.volume), max(
        float(whole.volume - part.sum() - min(STEPS * whole.area, MOST_STEPS * whole.volume)), 0.0
    )


def _grown(part: np.ndarray) -> np.ndarray:
    """Cells of a part and their neighbours across a face."""
    grown = part.copy()
    for axis in range(3):
        lead = (slice(None),) * axis
        after, before = (*lead, slice(1, None)), (*lead, slice(None, -1))
        grown[after] |= part[before]
        grown[before] |= part[after]
    return grown
