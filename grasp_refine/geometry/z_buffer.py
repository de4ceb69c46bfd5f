"""Z-buffer in NumPy alone: the nearest of many triangles in each pixel of a picture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.core.array_types import Float, Int

RELATIVE_SLACK = 1e-9
"""Share of its height by which a triangle is enlarged, so that no gaps open between neighbours."""
BLOCK_PIXELS = 2**16
"""Number of bounding-box pixels up to which triangles are drawn together, which bounds the memory."""


def rasterize(
    triangles: Float[np.ndarray, "F 3 3"], shape: tuple[int, int]
) -> tuple[Int[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Return the nearest triangle in each pixel, -1 for none, and its depth there, inf for none.

    Of several triangles at the same depth the first one is the nearest.

    Args:
        triangles: Corners (F, 3, 3): pixel coordinates to the right and downwards, where the centre of the first pixel
            is (0.5, 0.5), and the depth, in any unit that is linear in the picture. That is the distance in a parallel
            projection, and minus its inverse in a perspective one.
        shape: Height and width of the picture.
    """
    x, y, depth = np.moveaxis(triangles.transpose(1, 0, 2), -1, 0)
    nearest, least = np.full(shape[0] * shape[1], -1), np.full(shape[0] * shape[1], np.inf)
    for face, begin, count, start, slope in _spans(x, y, depth, shape):
        span, step = _repeat_indices(count)
        pixel, value = begin[span] + step, start[span] + slope[span] * step
        nearer = np.flatnonzero(value < least[pixel])
        span, pixel, value = span[nearer], pixel[nearer], value[nearer]
        np.minimum.at(least, pixel, value)
        # Of values assigned to the same pixel the last one stays, so that the order is reversed.
        won = np.flatnonzero(value == least[pixel])[::-1]
        nearest[pixel[won]] = face[span[won]]
    return nearest.reshape(shape), least.reshape(shape)


def _spans(
    x: np.ndarray, y: np.ndarray, depth: np.ndarray, shape: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Pixel spans of triangles, row by row: their weights are linear along a row, so a span lies between two columns.

    Args:
        x: Pixel coordinates of the corners (3, F), to the right.
        y: Pixel coordinates of the corners (3, F), downwards.
        depth: Depths of the corners (3, F).
        shape: Height and width of the picture.

    Yields:
        Face, first pixel (counted row by row), number of pixels, depth there and how much it grows from pixel to pixel;
        one for each span (S,), in order of faces, in blocks of about `BLOCK_PIXELS` pixels.
    """
    left, right = _centers(x, shape[1])
    top, bottom = _centers(y, shape[0])
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    box = (right - left) * (bottom - top)
    drawn = np.flatnonzero((box > 0) & (np.abs(area) >= 1e-9))
    block = np.cumsum(box[drawn]) // BLOCK_PIXELS
    for some in np.split(drawn, np.flatnonzero(np.diff(block)) + 1):
        (ax, bx, cx), (ay, by, cy), (a, b, c) = x[:, some], y[:, some], depth[:, some]
        # Increments of the weights of a, b and c, and so of the depth, from pixel to pixel to the right and downwards.
        to_right = np.stack([by - cy, cy - ay, ay - by]) / area[some]
        downwards = np.stack([cx - bx, ax - cx, bx - ax]) / area[some]
        depth_right, depth_down = ((b - a) * weight[1] + (c - a) * weight[2] for weight in (to_right, downwards))
        # Column, relative to a's, where a weight is zero: at + shift * (rows from a's on). A tiny slope replaces zero.
        slope = np.where(to_right == 0.0, 1e-30, to_right)
        at, shift = (-RELATIVE_SLACK - np.array([[1.0], [0.0], [0.0]])) / slope, -downwards / slope

        face, row = _repeat_indices((bottom - top)[some])
        row += top[some][face]
        below = row + 0.5 - ay[face]
        zero, rising = at[:, face] + shift[:, face] * below, (slope > 0.0)[:, face]
        begin = np.where(rising, zero, -np.inf).max(axis=0) + (ax[face] - 0.5)
        end = np.where(rising, np.inf, zero).min(axis=0) + (ax[face] + 0.5)
        low, high = left[some][face], right[some][face]
        begin, end = (np.clip(edge, low, high).astype(int) for edge in (np.ceil(begin), np.floor(end)))
        full = np.flatnonzero(begin < end)
        face, row, begin, end, below = (array[full] for array in (face, row, begin, end, below))
        start = a[face] + depth_right[face] * (begin + 0.5 - ax[face]) + depth_down[face] * below
        yield some[face], row * shape[1] + begin, end - begin, start, depth_right[face]


def _centers(corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """First and, plus one, last pixel (F,) of `size` whose centre may lie between the corners (3, F)."""
    low, high = np.ceil(corners.min(axis=0) - 0.5), np.floor(corners.max(axis=0) + 0.5)
    return np.clip(low, 0, size).astype(int), np.clip(high, 0, size).astype(int)


def _repeat_indices(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Repeat each index `count` (N,) times; return the indices, and the number 0, 1, 2 ... of each repetition."""
    index = np.repeat(np.arange(len(count)), count)
    return index, np.arange(len(index)) - (np.cumsum(count) - count)[index]
