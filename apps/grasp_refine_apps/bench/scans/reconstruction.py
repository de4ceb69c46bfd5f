"""Plain reconstruction of a scan, with no thought of what the sensor saw to be free."""

from __future__ import annotations

import numpy as np

from grasp_refine.geometry.pieces import Piece
from grasp_refine.scans.scan import Scan
from grasp_refine.scans.voxels import Grid, indicator, split

CELLS = 100_000
"""Cells of the grid, about."""

PAD = 0.4
"""Space around the scan, over its largest extent: the solid may close in it."""


def reconstruct(scan: Scan) -> list[Piece]:
    """Return convex pieces of the Poisson reconstruction of a scan, without parts on which nothing was seen.

    Raises:
        MeshError: there is no solid.
    """
    from scipy.ndimage import label

    low, high = scan.points.min(axis=0), scan.points.max(axis=0)
    pad = PAD * (high - low).max()
    grid = Grid.around(low - pad, high + pad, CELLS)
    parts, _ = label(indicator(grid, scan.points, scan.normals) > 0.0)
    seen = np.bincount(parts.flat[grid.cells(scan.points)])
    seen[0] = 0
    return split(grid, parts == seen.argmax(), scan.points)
