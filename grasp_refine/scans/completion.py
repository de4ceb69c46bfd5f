"""Completion: the solids that a scanned object may be, with their probabilities.

A symmetry is a set of isometries. It maps the seen points to unseen ones, and the free space to space that must be
free as well: the solid is the hull of all points without what is free. So the inside of a bowl stays free all around
when a part of its wall was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.geometry.sphere_points import on_sphere
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan
from grasp_refine.scans.space import Plane, Space
from grasp_refine.scans.voxels import Grid, indicator, outermost, split

MIN_POINTS = 20
"""Fewest points of a scan."""

MAX_POINTS = 20_000
"""Points that are used; more are thinned."""

CELLS = 50_000
"""Cells of the grid, about."""

EXCESS = 0.5
"""Mean extent of an object behind its seen points along the line of sight, over the narrower extent across it.

It is distributed exponentially: 61 objects, 6 random views each and 6 along their principal axes, have the quartiles
0.13, 0.29, 0.47 and 0.18, 0.43, 0.75 (exponential: 0.14, 0.35, 0.69).
"""

DEEPEST = 2.0
"""Largest extent behind the seen points, over its mean."""

OPEN = 0.3
"""Fraction of the hull of the seen points that is free where the object is surely hollow."""

THICKNESS = (1.2, 1.7, 2.2, 2.7, 3.2)
"""Thicknesses of a solid object over the distance to the edge of the silhouette: quantiles of 40 objects."""

WALLS = (0.1, 0.2, 0.3)
"""Thicknesses of the wall of a hollow object over the largest distance to the edge of the silhouette, of 20 objects."""

EVIDENCE = 20.0
"""Number of independent points that the free space is worth."""

AGREEMENT = 0.1
"""Logarithm of the odds of an image on the seen surface, if a symmetry is true."""

ALIKE = 0.7
"""Least cosine between the normals of an image and of the seen surface."""

WORST = 2.0
"""Largest penalty of one point in free space: points of parts that do not follow a symmetry."""

PRIORS = {
    "mirrored": 0.15,
    "inverted": 0.2,
    "half-turned": 0.1,
    "revolved": 0.2,
    "extruded": 0.1,
    "smooth": 0.15,
    "inflated": 0.15,
    "shell": 0.15,
    "hull": 0.05,
}
"""Probability of each kind before the scan is looked at."""

KEPT = 12
"""Candidates of a kind that are kept."""

CONVEX = 0.05
"""Fraction of a hull that is left although it is free."""

ALONG = 0.9
"""Cosine between an axis of revolution and the line of sight above which the axis says nothing about the far side."""

IMAGES = 5000
"""Images of seen points, about, of which the outermost are the corners of a hull."""

SMOOTHED = 20_000
"""Images, about, of which a smooth solid is made."""

FEWEST_CELLS = 8
"""Fewest cells of a solid that is split."""

TURNS = 16
"""Rotations about an axis of revolution."""


def complete(scan: Scan, *, count: int = 8, seed: int = 0, table: Plane | None = None) -> tuple[Hypothesis, ...]:
    """Return at most `count` solids that the object of a scan may be, the most probable first; weights sum to 1.

    Candidates of several kinds (`PRIORS`) are weighed by the seen points that they put into free space and by their
    thickness. The hypotheses are those candidates that stand for all others at the least distance, with their
    weights. All but the first are shifted along the line of sight by the noise of the sensor.

    Args:
        scan: points on the seen surface, with outward normals.
        count: most hypotheses.
        seed: number that the thinning and the shifts are drawn by.
        table: point (3,) and unit normal (3,) of the plane on which the object stands; nothing lies below it.

    Raises:
        MeshError: `count` is below 1; there are too few points, they are not finite, or they lie on a line, or in a
            plane and the sensor is not known.
    """
    if count < 1:
        raise MeshError(f"the number of completions must be at least 1, got {count}")
    frame = _Frame.of(scan, seed, table)
    candidates = [one for kind in _KINDS for one in kind(frame)]
    chosen = _representatives(candidates, count)
    shifts = _shifts(len(chosen), scan.noise_m, seed)
    found = []
    for (candidate, weight), shift in zip(chosen, shifts, strict=True):
        T = frame.T_object_view.copy()
        T[:3, 3] += shift * T[:3, 2]
        pieces = tuple(piece.transformed(T) for piece in frame.pieces(candidate))
        found.append(Hypothesis(candidate.kind, _above(pieces, table), weight))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A completed cloud."""

    kind: str
    points: np.ndarray
    """Outermost completed points (M, 3)."""
    symmetry: np.ndarray
    """Isometries (G, 4, 4)."""
    log_weight: float
    smooth: bool = False
    """Whether it closes smoothly where there are neither points nor images."""
    wall: np.ndarray | float = np.inf
    """Largest depth (x, y) of each column of the grid behind the seen surface, metres."""


@dataclass(frozen=True, eq=False)
class _Frame:
    """A scan in a frame whose z axis is the mean line of sight."""

    T_object_view: np.ndarray
    points: np.ndarray
    """Smoothed points (P, 3)."""
    normals: np.ndarray
    sample: np.ndarray
    """Some of the points (S, 3)."""
    sample_normals: np.ndarray
    margin: float
    grid: Grid
    free: np.ndarray
    """Depth (cells,) of the cells in free space; inf at the border of the grid."""
    excess: float
    """Mean extent behind the seen points, metres."""
    rng: np.random.Generator

    @classmethod
    def of(cls, scan: Scan, seed: int, table: Plane | None) -> _Frame:
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
            excess,
            rng,
        )

    def free_at(self, points: np.ndarray) -> np.ndarray:
        """Depth (...) of points (..., 3) in free space."""
        return self.free[self.grid.cells(points)]

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
        result: np.ndarray = self.facing.any(axis=1)
        return result

    @cached_property
    def edge_distance(self) -> np.ndarray:
        """Distance (x, y) of each column of the grid to the edge of the silhouette, metres."""
        from scipy.ndimage import distance_transform_edt

        silhouette = self.near.reshape(self.grid.shape).any(axis=2)
        result: np.ndarray = distance_transform_edt(silhouette) * self.grid.size
        return result

    @cached_property
    def outer(self) -> np.ndarray:
        return outermost(self.points)

    def candidate(self, kind: str, symmetry: np.ndarray) -> _Candidate:
        """Candidate of the seen points and of their images that are not in free space."""
        images = _apply(symmetry, self.points[:: len(self.points) * len(symmetry) // IMAGES + 1])
        kept = images[self.free_at(images) <= self.margin]
        points = np.concatenate([self.outer, outermost(kept)]) if len(kept) else self.outer
        log_weight = float(self.log_likelihood(symmetry[None])[0])
        return _Candidate(kind, points, np.concatenate([np.eye(4)[None], symmetry]), log_weight, kind != "revolved")

    def log_likelihood(self, symmetries: np.ndarray) -> np.ndarray:
        """Logarithm (N,) of the likelihoods of symmetries (N, G, 4, 4): images in free space, and on the surface."""
        images = _apply(symmetries, self.sample)
        facing = self.sample_normals @ np.swapaxes(symmetries[..., :3, :3], -1, -2)
        alike = np.einsum("...i,...i->...", facing, self.facing[self.grid.cells(images)]) > ALIKE
        fit = AGREEMENT * alike - self.misfit(images)
        result: np.ndarray = EVIDENCE * fit.mean(axis=tuple(range(1, fit.ndim)))
        return result

    def log_prior(self, symmetries: np.ndarray) -> np.ndarray:
        """Logarithm (N,) of the densities of symmetries (N, G, 4, 4), from the extent behind the seen points."""
        images = _apply(symmetries, self.sample)
        inside = np.where(self.free_at(images) <= self.margin, images[..., 2], -np.inf)
        back = inside.max(axis=tuple(range(1, inside.ndim)))
        return -np.maximum(back - self.points[:, 2].max(), 0.0) / self.excess

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """Penalties (...) of points (..., 3) in free space."""
        return np.minimum(0.5 * np.maximum(self.free_at(points) / self.margin, 0.0) ** 2, WORST)

    def solid(self, candidate: _Candidate) -> tuple[np.ndarray, float]:
        """Mask (cells,) of the hull of a candidate without the free space and its images, and its share of the hull."""
        normals, offsets = hull(candidate.points).planes
        centers = self.grid.centers
        inside = np.flatnonzero(((centers @ normals.T) <= offsets).all(axis=1))
        wall = np.broadcast_to(np.asarray(candidate.wall)[..., None], self.grid.shape).ravel()[inside]
        kept = inside[(self.free[inside] <= self.margin) & (self.free[inside] >= -wall)]
        if len(candidate.symmetry) > 1:
            images = _apply(candidate.symmetry[1:], centers[kept])
            kept = kept[(self.free_at(images).max(axis=0) <= self.margin) | self.near[kept]]
        if candidate.smooth:
            kept = kept[self.closed(candidate.symmetry[1:])[kept]]
        solid = np.zeros(len(centers), dtype=bool)
        solid[kept] = True
        return solid, len(kept) / max(len(inside), 1)

    def closed(self, symmetry: np.ndarray) -> np.ndarray:
        """Mask (cells,) of the smooth solid of the points and their images (G, 4, 4) beside them."""
        some = slice(None, None, len(self.points) * len(symmetry) // SMOOTHED + 1)
        images = _apply(symmetry, self.points[some])
        facing = self.normals[some] @ np.swapaxes(symmetry[:, :3, :3], 1, 2)
        new = (self.free_at(images) <= self.margin) & ~self.near[self.grid.cells(images)]
        points, normals = np.concatenate([self.points, images[new]]), np.concatenate([self.normals, facing[new]])
        return indicator(self.grid, points, normals).ravel() > 0.0

    def pieces(self, candidate: _Candidate) -> list[Piece]:
        """Convex pieces of a candidate."""
        solid, share = self.solid(candidate)
        if share > 1.0 - CONVEX or solid.sum() < FEWEST_CELLS:
            return [hull(candidate.points)]
        return split(self.grid, solid.reshape(self.grid.shape), np.concatenate([self.points, candidate.points]))


def _thinned(scan: Scan, rng: np.random.Generator) -> Scan:
    """Scan of at most `MAX_POINTS` points, checked."""
    if len(scan.points) < MIN_POINTS:
        raise MeshError(f"a scan needs at least {MIN_POINTS} points, got {len(scan.points)}")
    if not (np.isfinite(scan.points).all() and np.isfinite(scan.normals).all()):
        raise MeshError("points and normals of a scan must be finite")
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


def _apply(isometries: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Images (..., n, 3) of points (n, 3)."""
    return points @ np.swapaxes(isometries[..., :3, :3], -1, -2) + isometries[..., None, :3, 3]


def _about(R: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Isometries (..., 4, 4) with linear parts R (..., 3, 3) that keep centres (..., 3)."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], centers.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., 3, 3] = R, 1.0
    T[..., :3, 3] = centers - np.einsum("...ij,...j->...i", T[..., :3, :3], centers)
    return T


def _mirror(parameters: np.ndarray) -> np.ndarray:
    """Reflections (N, 1, 4, 4) about planes through points on z with normals (x, y, 1): parameters x, y, z (N, 3)."""
    normal = parameters * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    R = np.eye(3) - 2.0 * normal[:, :, None] * normal[:, None]
    return _about(R, parameters * [0.0, 0.0, 1.0])[:, None]


def _inversion(parameters: np.ndarray) -> np.ndarray:
    """Inversions (N, 1, 4, 4) about centres (N, 3)."""
    return _about(-np.eye(3), parameters)[:, None]


def _half_turn(parameters: np.ndarray) -> np.ndarray:
    """Half-turns (N, 1, 4, 4) about axes across z: parameters angle, place across and z (N, 3)."""
    angle, across, z = parameters.T
    axis = np.stack([np.cos(angle), np.sin(angle), 0.0 * z], axis=1)
    R = 2.0 * axis[:, :, None] * axis[:, None] - np.eye(3)
    return _about(R, np.stack([-np.sin(angle) * across, np.cos(angle) * across, z], axis=1))[:, None]


def _revolution(parameters: np.ndarray) -> np.ndarray:
    """Rotations (N, TURNS - 1, 4, 4) about axes: parameters direction and point (N, 6)."""
    axis, centers = parameters[:, :3] / np.linalg.norm(parameters[:, :3], axis=1, keepdims=True), parameters[:, 3:]
    angle = (2.0 * np.pi * np.arange(1, TURNS) / TURNS)[:, None, None]
    cross = np.cross(np.eye(3), axis[:, None])[:, None]
    outer = (axis[:, :, None] * axis[:, None])[:, None]
    R = np.cos(angle) * np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * outer
    return _about(R, centers[:, None])


def _symmetric(
    frame: _Frame, kind: str, symmetry: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, steps: np.ndarray
) -> Iterator[_Candidate]:
    """Candidates of a kind, drawn from even parameters (N, n) by their probabilities, then improved."""
    isometries = symmetry(starts)
    log_weight = frame.log_likelihood(isometries) + frame.log_prior(isometries)
    kept = starts[_drawn(np.exp(log_weight - log_weight.max()), KEPT)]
    for parameters in _climb(frame, symmetry, kept, steps):
        yield frame.candidate(kind, symmetry(parameters[None])[0])


def _drawn(weight: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) at even steps of the cumulated weights."""
    ladder = weight.cumsum()
    return np.searchsorted(ladder, (np.arange(count) + 0.5) / count * ladder[-1])


def _climb(
    frame: _Frame, symmetry: Callable[[np.ndarray], np.ndarray], kept: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Parameters (N, n) that are likelier: the best of random steps, of ever smaller size."""
    for size in 0.5 ** np.arange(4):
        tries = kept[:, None] + size * steps * frame.rng.standard_normal((len(kept), 10, kept.shape[1]))
        tries[:, 0] = kept
        likely = frame.log_likelihood(symmetry(tries.reshape(-1, kept.shape[1]))).reshape(tries.shape[:2])
        kept = tries[np.arange(len(kept)), likely.argmax(axis=1)]
    return kept


def _centers(frame: _Frame, count: int) -> np.ndarray:
    """Places (count,) of centres along the line of sight."""
    front, back = frame.points[:, 2].min(), frame.points[:, 2].max()
    return np.linspace((front + back) / 2, (front + back + DEEPEST * frame.excess) / 2, count)


def _product(*axes: np.ndarray) -> np.ndarray:
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _mirrored(frame: _Frame) -> Iterator[_Candidate]:
    tilt = np.tan(np.deg2rad([-65.0, -50.0, -35.0, -17.0, 0.0, 17.0, 35.0, 50.0, 65.0]))
    starts = _product(tilt, tilt, _centers(frame, 16))
    return _symmetric(frame, "mirrored", _mirror, starts, np.array([0.1, 0.1, 0.05 * frame.excess]))


def _inverted(frame: _Frame) -> Iterator[_Candidate]:
    middle, extent = (frame.points.min(axis=0) + frame.points.max(axis=0)) / 2, np.ptp(frame.points, axis=0)
    across = np.linspace(-0.1, 0.1, 5)
    starts = _product(middle[0] + across * extent[0], middle[1] + across * extent[1], _centers(frame, 16))
    return _symmetric(frame, "inverted", _inversion, starts, np.full(3, 0.05 * frame.excess))


def _half_turned(frame: _Frame) -> Iterator[_Candidate]:
    angle, across = np.pi * np.arange(12) / 12, np.linspace(-0.1, 0.1, 3) * np.ptp(frame.points[:, 1])
    starts = _product(angle, across, _centers(frame, 16))
    return _symmetric(frame, "half-turned", _half_turn, starts, np.array([0.1, *np.full(2, 0.05 * frame.excess)]))


def _revolved(frame: _Frame) -> Iterator[_Candidate]:
    starts = []
    for _ in range(8):
        chosen = frame.rng.permutation(len(frame.points))[: max(MIN_POINTS, len(frame.points) // 4)]
        starts.append(_axes(frame.points[chosen], frame.normals[chosen])[:2])
    axes = np.concatenate(starts)
    axes = axes[np.abs(axes[:, 2]) < ALONG]
    steps = np.array([0.05, 0.05, 0.05, *np.full(3, 0.05 * frame.excess)])
    return _symmetric(frame, "revolved", _revolution, axes, steps) if len(axes) else iter(())


def _axes(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Directions and points (3, 6) of axes that the normals of a surface of revolution meet, the best first.

    Least squares in Pluecker coordinates (Pottmann and Randrup, Rotational and helical surface approximation, 1998).
    """
    lines = np.hstack([np.cross(points, normals), normals])
    weight = np.ones(len(lines))
    for _ in range(5):
        M = (lines * weight[:, None]).T @ lines
        moments = -np.linalg.pinv(M[3:, 3:], rcond=1e-6) @ M[3:, :3]
        values, vectors = np.linalg.eigh(M[:3, :3] + M[:3, 3:] @ moments)
        missed = np.abs(lines @ np.concatenate([vectors[:, 0], moments @ vectors[:, 0]]))
        weight = 1.0 / (1.0 + (missed / max(2.0 * float(np.median(missed)), 1e-6)) ** 2)
    m = (moments @ vectors).T
    return np.hstack([vectors.T, np.cross(vectors.T, m)])


def _extruded(frame: _Frame) -> Iterator[_Candidate]:
    back = frame.points[:, 2].max()
    for excess in frame.excess * _quantiles(KEPT):
        moved = np.column_stack([frame.outer[:, :2], np.full(len(frame.outer), back + excess)])
        log_weight = -EVIDENCE * float(frame.misfit(moved).mean())
        points = np.concatenate([frame.outer, moved])
        for kind, smooth in (("extruded", False), ("smooth", True)):
            yield _Candidate(kind, points, np.eye(4)[None], log_weight, smooth)


def _inflated(frame: _Frame) -> Iterator[_Candidate]:
    column = frame.grid.cells(frame.points) // frame.grid.shape[2]
    for share in THICKNESS:
        wall = np.maximum(share * frame.edge_distance, frame.grid.size)
        moved = frame.points + wall.ravel()[column][:, None] * [0.0, 0.0, 1.0]
        log_weight = -EVIDENCE * float(frame.misfit(moved[:: len(moved) // 200 + 1]).mean())
        points = np.concatenate([frame.outer, outermost(moved)])
        yield _Candidate("inflated", points, np.eye(4)[None], log_weight, smooth=True, wall=wall)


def _shell(frame: _Frame) -> Iterator[_Candidate]:
    normals, offsets = hull(frame.outer).planes
    free = frame.free[((frame.grid.centers @ normals.T) <= offsets).all(axis=1)]
    concave = min(float((free > frame.margin).mean()) / OPEN, 1.0)
    for share in WALLS:
        wall = max(share * float(frame.edge_distance.max()), frame.grid.size)
        yield _Candidate("shell", frame.outer, np.eye(4)[None], float(np.log(max(concave, 1e-9))), wall=wall)


def _hull(frame: _Frame) -> Iterator[_Candidate]:
    yield _Candidate("hull", frame.outer, np.eye(4)[None], 0.0, smooth=True)


def _quantiles(count: int) -> np.ndarray:
    """Even quantiles (count,) of the exponential distribution with mean 1."""
    return -np.log1p(-(np.arange(count) + 0.5) / count)


_KINDS: tuple[Callable[[_Frame], Iterator[_Candidate]], ...] = (
    _mirrored,
    _inverted,
    _half_turned,
    _revolved,
    _extruded,
    _inflated,
    _shell,
    _hull,
)


def _representatives(candidates: list[_Candidate], count: int) -> list[tuple[_Candidate, float]]:
    """Candidates that stand for all, the most probable first, with the probability of all for which each stands."""
    kinds = [candidate.kind for candidate in candidates]
    log_weight = np.array([one.log_weight + np.log(PRIORS[one.kind] / kinds.count(one.kind)) for one in candidates])
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    directions = on_sphere(64)
    supports = np.stack([(candidate.points @ directions.T).max(axis=0) for candidate in candidates])
    apart = np.linalg.norm(supports[:, None] - supports, axis=2)
    chosen = [int(weight.argmax())]
    while len(chosen) < min(count, len(candidates)):
        left = apart[chosen].min(axis=0)
        gain = (weight * np.maximum(left - apart, 0.0)).sum(axis=1)
        best = int(gain.argmax())
        if gain[best] <= 1e-6 * float(weight @ left):
            break
        chosen.append(best)
    mass = np.bincount(apart[chosen].argmin(axis=0), weight, minlength=len(chosen))
    order = np.argsort(-mass, kind="stable")
    return [(candidates[chosen[index]], float(mass[index])) for index in order]


def _shifts(count: int, noise_m: float, seed: int) -> np.ndarray:
    """Shifts (count,) along the line of sight: 0, then even quantiles of the noise in random order."""
    from scipy.special import ndtri

    quantiles = ndtri((np.arange(count - 1) + 0.5) / max(count - 1, 1))
    return np.append(0.0, noise_m * np.random.default_rng(seed).permutation(quantiles))


def _above(pieces: tuple[Piece, ...], table: Plane | None) -> tuple[Piece, ...]:
    """Parts of convex pieces above a table."""
    if table is None:
        return pieces
    cut = [_clipped(piece, *table) for piece in pieces]
    return tuple(piece for piece in cut if piece is not None)


def _clipped(piece: Piece, point: np.ndarray, normal: np.ndarray) -> Piece | None:
    height = (piece.vertices - point) @ normal
    if height.min() >= 0.0:
        return piece
    edges = piece.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    above, below = edges[(height[edges[:, 0]] > 0.0) & (height[edges[:, 1]] < 0.0)].T
    share = (height[above] / (height[above] - height[below]))[:, None]
    crossing = piece.vertices[above] + share * (piece.vertices[below] - piece.vertices[above])
    left = np.concatenate([piece.vertices[height >= 0.0], crossing])
    return hull(left) if len(left) > 3 and height.max() > 1e-6 else None
