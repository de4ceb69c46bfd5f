"""Candidates: completed clouds of a scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.scans.isometries import axes_of_revolution, half_turn, images_of, inversion, mirror, revolution
from grasp_refine.scans.view_frame import DEEPEST, EVIDENCE, MIN_POINTS, ViewFrame
from grasp_refine.scans.voxels import outermost, split

OPEN = 0.3
"""Fraction of the hull of the seen points that is free where the object is surely hollow."""

THICKNESS = (1.2, 1.7, 2.2, 2.7, 3.2)
"""Thicknesses of a solid object over the distance to the edge of the silhouette: quantiles of 40 objects."""

WALLS = (0.1, 0.2, 0.3)
"""Thicknesses of the wall of a hollow object over the largest distance to the edge of the silhouette, of 20 objects."""

KEPT = 8
"""Candidates of a kind that are kept."""

ALONG = 0.9
"""Cosine between an axis of revolution and the line of sight above which the axis says nothing about the far side."""

IMAGES = 5000
"""Images of seen points, about; the outermost are the corners of a hull."""

FEWEST_CELLS = 8
"""Fewest cells of a solid that is split."""

NO_SYMMETRY = np.zeros((0, 4, 4))
"""Isometries of a solid that has none."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A completed cloud in the view frame."""

    kind: str
    """Name, see `completion.PRIORS`."""
    points: np.ndarray
    """Outermost completed points (M, 3)."""
    symmetry: np.ndarray
    """Isometries (G, 4, 4) that map the solid to itself."""
    log_weight: float
    """Logarithm of the likelihood."""
    smooth: bool = False
    """Whether it closes smoothly where there are neither points nor images."""
    wall: np.ndarray | float = np.inf
    """Largest depth (x, y) of each column of the grid behind the seen surface, metres."""


def filled(frame: ViewFrame, candidate: Candidate, cells: np.ndarray) -> np.ndarray:
    """Mask (n,) of the cells (n,) in the hull of a candidate that are neither free nor images of free ones."""
    normals, offsets = hull(candidate.points).planes
    centers, free = frame.grid.centers[cells], frame.free[cells]
    wall = np.broadcast_to(np.asarray(candidate.wall)[..., None], frame.grid.shape).ravel()[cells]
    result = (free <= frame.margin) & (free >= -wall)
    result[result] = ((centers[result] @ normals.T) <= offsets).all(axis=1)
    if len(candidate.symmetry):
        free_images = frame.free_at(images_of(candidate.symmetry, centers[result])).max(axis=0)
        result[result] = (free_images <= frame.margin) | frame.near[cells[result]]
    return result & frame.closed(candidate.symmetry)[cells] if candidate.smooth else result


def pieces_of(frame: ViewFrame, candidate: Candidate) -> list[Piece]:
    """Convex pieces of a candidate."""
    solid = filled(frame, candidate, np.arange(len(frame.free)))
    if solid.sum() < FEWEST_CELLS:
        return [hull(candidate.points)]
    images = images_of(candidate.symmetry, _some(frame, candidate.symmetry)).reshape(-1, 3)
    surface = np.concatenate([frame.points, candidate.points, images])
    return split(frame.grid, solid.reshape(frame.grid.shape), surface)


def _of_symmetry(frame: ViewFrame, kind: str, symmetry: np.ndarray) -> Candidate:
    """Candidate of the seen points and of their images that are not in free space."""
    images = images_of(symmetry, _some(frame, symmetry))
    kept = images[frame.free_at(images) <= frame.margin]
    points = np.concatenate([frame.outer, outermost(kept)]) if len(kept) else frame.outer
    log_weight = float(frame.log_likelihood(symmetry[None])[0])
    return Candidate(kind, points, symmetry, log_weight, smooth=kind != "revolved")


def _some(frame: ViewFrame, symmetry: np.ndarray) -> np.ndarray:
    """Points with about `IMAGES` images."""
    return frame.points[:: len(frame.points) * len(symmetry) // IMAGES + 1]


def _symmetric(
    frame: ViewFrame, kind: str, symmetry: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, steps: np.ndarray
) -> Iterator[Candidate]:
    """Candidates of a kind, drawn from even parameters (N, n) by their probabilities, then improved."""
    isometries = symmetry(starts)
    log_weight = frame.log_likelihood(isometries) + frame.log_prior(isometries)
    kept = starts[_drawn(np.exp(log_weight - log_weight.max()), KEPT)]
    for parameters in _climb(frame, symmetry, kept, steps):
        yield _of_symmetry(frame, kind, symmetry(parameters[None])[0])


def _drawn(weight: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) at even steps of the cumulated weights."""
    ladder = weight.cumsum()
    return np.searchsorted(ladder, (np.arange(count) + 0.5) / count * ladder[-1])


def _climb(
    frame: ViewFrame, symmetry: Callable[[np.ndarray], np.ndarray], kept: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Parameters (N, n) that are likelier: the best of random steps, of ever smaller size."""
    for size in 0.6 ** np.arange(6):
        tries = kept[:, None] + size * steps * frame.rng.standard_normal((len(kept), 12, kept.shape[1]))
        tries[:, 0] = kept
        likely = frame.log_likelihood(symmetry(tries.reshape(-1, kept.shape[1]))).reshape(tries.shape[:2])
        kept = tries[np.arange(len(kept)), likely.argmax(axis=1)]
    return kept


def _centers(frame: ViewFrame, count: int) -> np.ndarray:
    """Places (count,) of centres along the line of sight."""
    front, back = frame.points[:, 2].min(), frame.points[:, 2].max()
    return np.linspace((front + back) / 2, (front + back + DEEPEST * frame.excess) / 2, count)


def _product(*axes: np.ndarray) -> np.ndarray:
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _mirrored(frame: ViewFrame) -> Iterator[Candidate]:
    tilt = np.tan(np.deg2rad([-65.0, -50.0, -35.0, -17.0, 0.0, 17.0, 35.0, 50.0, 65.0]))
    starts = _product(tilt, tilt, _centers(frame, 16))
    return _symmetric(frame, "mirrored", mirror, starts, np.array([0.1, 0.1, 0.05 * frame.excess]))


def _inverted(frame: ViewFrame) -> Iterator[Candidate]:
    middle, extent = (frame.points.min(axis=0) + frame.points.max(axis=0)) / 2, np.ptp(frame.points, axis=0)
    across = np.linspace(-0.1, 0.1, 5)
    starts = _product(middle[0] + across * extent[0], middle[1] + across * extent[1], _centers(frame, 16))
    return _symmetric(frame, "inverted", inversion, starts, np.full(3, 0.05 * frame.excess))


def _half_turned(frame: ViewFrame) -> Iterator[Candidate]:
    angle, across = np.pi * np.arange(12) / 12, np.linspace(-0.1, 0.1, 3) * np.ptp(frame.points[:, 1])
    starts = _product(angle, across, _centers(frame, 16))
    return _symmetric(frame, "half-turned", half_turn, starts, np.array([0.1, *np.full(2, 0.05 * frame.excess)]))


def _revolved(frame: ViewFrame) -> Iterator[Candidate]:
    starts = []
    for _ in range(8):
        chosen = frame.rng.permutation(len(frame.points))[: max(MIN_POINTS, len(frame.points) // 4)]
        starts.append(axes_of_revolution(frame.points[chosen], frame.normals[chosen])[:2])
    # Noise of the normals draws the axis to the surface: try farther ones as well.
    farther = np.array([0.0, 0.05, 0.1, 0.15])[:, None, None] * frame.excess * np.eye(6)[5]
    axes = (np.concatenate(starts) + farther).reshape(-1, 6)
    axes = axes[np.abs(axes[:, 2]) < ALONG]
    steps = np.array([0.05, 0.05, 0.05, *np.full(3, 0.05 * frame.excess)])
    return _symmetric(frame, "revolved", revolution, axes, steps) if len(axes) else iter(())


def _extruded(frame: ViewFrame) -> Iterator[Candidate]:
    back = frame.points[:, 2].max()
    # Even quantiles of the exponential distribution with mean 1.
    for excess in frame.excess * -np.log1p(-(np.arange(KEPT) + 0.5) / KEPT):
        moved = frame.above(np.column_stack([frame.outer[:, :2], np.full(len(frame.outer), back + excess)]))
        log_weight = -EVIDENCE * float(frame.misfit(moved).mean())
        points = np.concatenate([frame.outer, moved])
        yield Candidate("extruded", points, NO_SYMMETRY, log_weight, smooth=True)


def _standing(frame: ViewFrame) -> Iterator[Candidate]:
    if frame.table is not None:
        moved = frame.outer - frame.height(frame.outer)[:, None] * frame.table[1]
        log_weight = -EVIDENCE * float(frame.misfit(moved).mean())
        yield Candidate("standing", np.concatenate([frame.outer, moved]), NO_SYMMETRY, log_weight, smooth=True)


def _inflated(frame: ViewFrame) -> Iterator[Candidate]:
    column = frame.grid.cells(frame.points) // frame.grid.shape[2]
    for share in THICKNESS:
        wall = np.maximum(share * frame.edge_distance, frame.grid.size)
        moved = frame.above(frame.points + wall.ravel()[column][:, None] * [0.0, 0.0, 1.0])
        log_weight = -EVIDENCE * float(frame.misfit(moved[:: len(moved) // 200 + 1]).mean())
        points = np.concatenate([frame.outer, outermost(moved)])
        yield Candidate("inflated", points, NO_SYMMETRY, log_weight, smooth=True, wall=wall)


def _shell(frame: ViewFrame) -> Iterator[Candidate]:
    normals, offsets = hull(frame.outer).planes
    free = frame.free[((frame.grid.centers @ normals.T) <= offsets).all(axis=1)]
    concave = min(float((free > frame.margin).sum()) / max(len(free), 1) / OPEN, 1.0)
    for share in WALLS:
        wall = max(share * float(frame.edge_distance.max()), frame.grid.size)
        yield Candidate("shell", frame.outer, NO_SYMMETRY, float(np.log(max(concave, 1e-9))), wall=wall)


def _hull(frame: ViewFrame) -> Iterator[Candidate]:
    yield Candidate("hull", frame.outer, NO_SYMMETRY, 0.0, smooth=True)


KINDS: tuple[Callable[[ViewFrame], Iterator[Candidate]], ...] = (
    _mirrored,
    _inverted,
    _half_turned,
    _revolved,
    _extruded,
    _inflated,
    _shell,
    _hull,
    _standing,
)
