"""View frame: a scan, and what is free, on a grid along the mean line of sight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.scans.isometries import images_of
from grasp_refine.scans.scan import Plane, Scan
from grasp_refine.scans.space import Space
from grasp_refine.scans.voxels import Grid, indicator, outermost

MIN_POINTS = 20
"""Fewest points of a scan."""

MAX_POINTS = 20_000
"""Points that are used; more are thinned."""

CELLS = 50_000
"""Cells of the grid, about."""

EXCESS = 0.6
"""Mean extent of an object behind its seen points along the line of sight, over the narrower extent across it.

It is distributed about exponentially: 61 objects have the quartiles 0.13, 0.25, 0.43 from 20 to 60 degrees above, 0.13,
0.28, 0.50 from random views, and 0.18, 0.45, 0.76 along their principal axes (of an exponential: 0.17, 0.42, 0.83).
"""

DEEPEST = 2.0
"""Largest extent behind the seen points, over its mean."""

EVIDENCE = 5.0
"""Number of independent points that the free space is worth."""

AGREEMENT = 0.2
"""Logarithm of the odds of an image on the seen surface, if a symmetry is true."""

ALIKE = 0.7
"""Least cosine between the normals of an image and of the seen surface."""

WORST = 2.0
"""Largest penalty of one point in free space: points of parts that do not follow a symmetry."""

COMPARED = 4000
"""Cells, about, by which solids are compared."""

SMOOTHED = 20_000
"""Images, about, that make a smooth solid."""


@dataclass(frozen=True, eq=False)
class ViewFrame:
    """A scan in a frame whose z axis is the mean line of sight."""

    T_object_view: np.ndarray
    """Pose (4, 4) in the frame of the object."""
    points: np.ndarray
    """Smoothed points (P, 3)."""
    normals: np.ndarray
    """Outward normals (P, 3)."""
    sample: np.ndarray
    """Some of the points (S, 3)."""
    sample_normals: np.ndarray
    """Their normals (S, 3)."""
    margin: float
    """Depth in metres up to which a cell in free space may be on the surface."""
    grid: Grid
    """Cells that the solids are made of."""
    free: np.ndarray
    """Depth (cells,) of the cells in free space; inf at the border of the grid."""
    table: Plane | None
    """Plane on which the object stands, this frame; None: it is not known."""
    excess: float
    """Mean extent behind the seen points, metres."""
    rng: np.random.Generator
    """Source of the random steps of a search."""

    @classmethod
    def of(cls, scan: Scan, seed: int, table: Plane | None) -> ViewFrame:
        """Return the frame of a scan and a table.

        Raises:
            MeshError: the scan has too few points, points that are not finite, or no solid is seen.
        """
        rng = np.random.default_rng(seed)
        scan = _smoothed(_thinned(scan, rng))
        T = _view_frame(scan)
        R, t = T[:3, :3], T[:3, 3]
        points, normals = (scan.points - t) @ R, scan.normals @ R
        low, high = points.min(axis=0), points.max(axis=0)
        excess = EXCESS * float((high - low)[:2].min())
        pad = 0.1 * (high - low).max()
        high[2] += DEEPEST * excess
        grid = Grid.around(low - pad, high + pad, CELLS)
        space = Space(scan, table)
        free = np.full(grid.shape, np.inf)
        depth = space.free_depth(grid.centers @ R.T + t).reshape(grid.shape)
        free[1:-1, 1:-1, 1:-1] = depth[1:-1, 1:-1, 1:-1]
        sample = rng.permutation(len(points))[:200]
        return cls(
            T,
            points,
            normals,
            points[sample],
            normals[sample],
            max(space.margin, grid.size),
            grid,
            free.ravel(),
            None if table is None else ((table[0] - t) @ R, table[1] @ R),
            excess,
            rng,
        )

    def free_at(self, points: np.ndarray) -> np.ndarray:
        """Depth (...) of points (..., 3) in free space."""
        return self.free[self.grid.cells(points)]

    def height(self, points: np.ndarray) -> np.ndarray:
        """Height (...) of points (..., 3) above the table, which is known, metres."""
        assert self.table is not None
        return np.asarray((points - self.table[0]) @ self.table[1])

    def above(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3); points below the table are moved to it, along the line of sight."""
        if self.table is None:
            return points
        slope = self.table[1][2]
        down = np.minimum(self.height(points), 0.0) / min(slope, -0.1)
        return points - down[..., None] * [0.0, 0.0, 1.0]

    @cached_property
    def facing(self) -> np.ndarray:
        """Normals (cells, 3) of the seen surface in each cell; 0 elsewhere."""
        from scipy.spatial import cKDTree

        reach = 1.5 * self.grid.size
        nearest = cKDTree(self.points).query(self.grid.centers, distance_upper_bound=reach)[1]
        return np.append(self.normals, np.zeros((1, 3)), axis=0)[nearest]

    @cached_property
    def near(self) -> np.ndarray:
        """Mask (cells,) of the cells at the seen points."""
        return np.asarray(self.facing.any(axis=1))

    @cached_property
    def edge_distance(self) -> np.ndarray:
        """Distance (x, y) of each column of the grid to the edge of the silhouette, metres."""
        from scipy.ndimage import distance_transform_edt

        silhouette = self.near.reshape(self.grid.shape).any(axis=2)
        result: np.ndarray = distance_transform_edt(silhouette) * self.grid.size
        return result

    @cached_property
    def outer(self) -> np.ndarray:
        """Outermost points (M, 3), and half a cell behind them, so that no cloud is flat."""
        return outermost(np.concatenate([self.points, self.points + [0.0, 0.0, 0.5 * self.grid.size]]))

    def log_likelihood(self, symmetries: np.ndarray) -> np.ndarray:
        """Logarithm (N,) of the likelihoods of symmetries (N, G, 4, 4): images in free space, and on the surface."""
        images = images_of(symmetries, self.sample)
        facing = self.sample_normals @ np.swapaxes(symmetries[..., :3, :3], -1, -2)
        cells = self.grid.cells(images)
        depth = self.free[cells] / self.margin
        alike = np.asarray(np.einsum("...i,...i->...", facing, self.facing[cells]) > ALIKE)
        fit = AGREEMENT * alike * np.maximum(1.0 - depth**2, 0.0) - self.misfit(images)
        result: np.ndarray = EVIDENCE * fit.mean(axis=tuple(range(1, fit.ndim)))
        return result

    def log_prior(self, symmetries: np.ndarray) -> np.ndarray:
        """Logarithm (N,) of the densities of symmetries (N, G, 4, 4), from the extent behind the seen points."""
        images = images_of(symmetries, self.sample)
        inside = np.where(self.free_at(images) <= self.margin, images[..., 2], -np.inf)
        back = inside.max(axis=tuple(range(1, inside.ndim)))
        return -np.maximum(back - self.points[:, 2].max(), 0.0) / self.excess

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """Penalties (...) of points (..., 3) in free space."""
        return np.minimum(0.5 * np.maximum(self.free_at(points) / self.margin, 0.0) ** 2, WORST)

    @cached_property
    def possible(self) -> np.ndarray:
        """Some of the cells that are not free."""
        cells = np.flatnonzero(self.free <= self.margin)
        return cells[:: len(cells) // COMPARED + 1]

    def closed(self, symmetry: np.ndarray) -> np.ndarray:
        """Mask (cells,) of the smooth solid of the points and their images (G, 4, 4) beside them."""
        return self._closed if not len(symmetry) else self._smooth_solid(symmetry)

    @cached_property
    def _closed(self) -> np.ndarray:
        return self._smooth_solid(np.zeros((0, 4, 4)))

    def _smooth_solid(self, symmetry: np.ndarray) -> np.ndarray:
        some = slice(None, None, len(self.points) * len(symmetry) // SMOOTHED + 1)
        images = images_of(symmetry, self.points[some])
        facing = self.normals[some] @ np.swapaxes(symmetry[:, :3, :3], 1, 2)
        new = (self.free_at(images) <= self.margin) & ~self.near[self.grid.cells(images)]
        points, normals = np.concatenate([self.points, images[new]]), np.concatenate([self.normals, facing[new]])
        return indicator(self.grid, points, normals).ravel() > 0.0


def _thinned(scan: Scan, rng: np.random.Generator) -> Scan:
    """Scan of at most `MAX_POINTS` points, checked."""
    if len(scan.points) < MIN_POINTS:
        raise MeshError(f"a scan needs at least {MIN_POINTS} points, got {len(scan.points)}")
    if not (np.isfinite(scan.points).all() and np.isfinite(scan.normals).all()):
        raise MeshError("points and normals of a scan must be finite")
    if np.abs(np.linalg.norm(scan.normals, axis=1) - 1.0).max() > 1e-3:
        raise MeshError("normals of a scan must be unit vectors")
    kept = np.sort(rng.permutation(len(scan.points))[:MAX_POINTS])
    scan = replace(scan, points=scan.points[kept], normals=scan.normals[kept], view=scan.view[kept])
    spread = np.linalg.svd(scan.points - scan.points.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-3 * spread[0]:
        raise MeshError(f"the {len(scan.points)} points of the scan lie on a line: no solid is seen")
    if not len(scan.origins) and spread[2] <= 1e-3 * spread[0]:
        raise MeshError("the points of the scan lie in a plane: name the origin of its sensor")
    return scan


def _smoothed(scan: Scan) -> Scan:
    """Scan whose points lie on planes fitted to their neighbours, moved along the normals by at most 3 deviations."""
    from scipy.spatial import cKDTree

    if scan.noise_m <= 0.0:
        return scan
    near = cKDTree(scan.points).query(scan.points, min(20, len(scan.points)))[1]
    alike = np.einsum("pki,pi->pk", scan.normals[near], scan.normals) > 0.7
    weight = alike / alike.sum(axis=1, keepdims=True)
    middle = np.einsum("pk,pki->pi", weight, scan.points[near])
    step = np.einsum("pi,pi->p", middle - scan.points, scan.normals).clip(-3.0 * scan.noise_m, 3.0 * scan.noise_m)
    return replace(scan, points=scan.points + step[:, None] * scan.normals)


def _view_frame(scan: Scan) -> np.ndarray:
    """Frame (4, 4) at the middle of the points: z along the mean line of sight, x the longest extent across it."""
    middle = scan.points.mean(axis=0)
    toward = -scan.normals.mean(axis=0)
    if len(scan.origins):
        rays = scan.points - scan.origins[scan.view]
        toward = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).mean(axis=0)
    across = scan.points - middle
    if np.linalg.norm(toward) < 0.1:
        toward = np.linalg.svd(across, full_matrices=False)[2][2]
    z = toward / np.linalg.norm(toward)
    x = np.linalg.svd(across - np.outer(across @ z, z), full_matrices=False)[2][0]
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), middle
    return T
