"""Completion: the solids that a scanned object may be, with their probabilities.

A symmetry is a set of isometries. It maps the seen points to unseen ones, and the free space to space that must be
free as well: the solid is the hull of all points without what is free. So the inside of a bowl stays free all around
when a part of its wall was seen.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.scans.candidates import KINDS, Candidate, filled, pieces_of
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Plane, Scan
from grasp_refine.scans.view_frame import ViewFrame

PRIORS = {
    "mirrored": 0.25,
    "inverted": 0.1,
    "half-turned": 0.05,
    "revolved": 0.25,
    "extruded": 0.1,
    "inflated": 0.05,
    "shell": 0.15,
    "hull": 0.05,
    "standing": 0.5,
}
"""Probability of each kind before the scan is looked at, over their sum; one kind needs a table."""

HOVERING = 0.05
"""Mean height above its table of a solid that stands on it, over the mean extent behind the seen points: solids that
end above the table are improbable."""


def complete(scan: Scan, *, count: int = 8, seed: int = 0, table: Plane | None = None) -> tuple[Hypothesis, ...]:
    """Return at most `count` solids that the object of a scan may be; their weights sum to 1.

    Candidates of several kinds (`PRIORS`) are drawn with thicknesses as of many objects, and weighed by the points that
    they put into free space or onto the seen surface. The hypotheses are the candidates that stand for all others at
    the least distance, with the weights of the others. The first is nearest to all, the others follow by weight,
    shifted along the line of sight by the noise of the sensor.

    Args:
        scan: points on the seen surface, with outward normals.
        count: most hypotheses.
        seed: number that the thinning and the shifts are drawn by.
        table: point (3,) and unit normal (3,) of the plane on which the object stands: the object reaches it, and
            nothing lies below. None: that of the scan.

    Raises:
        MeshError: `count` is below 1; there are too few points, they are not finite, or they lie on a line, or in a
            plane and the sensor is not known; or the table is above them.
    """
    if count < 1:
        raise MeshError(f"the number of completions must be at least 1, got {count}")
    table = table or scan.table
    frame = ViewFrame.of(scan, seed, table)
    candidates = [one for kind in KINDS for one in kind(frame)]
    chosen = _representatives(frame, candidates, count)
    shifts = _shifts(len(chosen), scan.noise_m, seed)
    found = []
    for (candidate, weight), shift in zip(chosen, shifts, strict=True):
        T = frame.T_object_view.copy()
        T[:3, 3] += shift * T[:3, 2]
        pieces = tuple(piece.transformed(T) for piece in pieces_of(frame, candidate))
        found.append(Hypothesis(candidate.kind, pieces, weight))
    return above_table(found, table)


def above_table(solids: Iterable[Hypothesis], table: Plane | None) -> tuple[Hypothesis, ...]:
    """Return solids without what lies below a table; their weights sum to 1.

    Raises:
        MeshError: all lie below the table.
    """
    cut = [replace(one, pieces=_above(one.pieces, table)) for one in solids]
    left = [one for one in cut if one.pieces]
    if not left:
        raise MeshError("all points of the scan lie below the table")
    total = sum(one.weight for one in left)
    return tuple(replace(one, weight=one.weight / total) for one in left)


def _representatives(frame: ViewFrame, candidates: list[Candidate], count: int) -> list[tuple[Candidate, float]]:
    """Candidates that stand for all, the one nearest to all first, with the probability of all for which each stands.

    The distance between two is the volume that is in one of them only.
    """
    kinds = [candidate.kind for candidate in candidates]
    log_weight = np.array([one.log_weight + np.log(PRIORS[one.kind] / kinds.count(one.kind)) for one in candidates])
    masks = np.stack([filled(frame, candidate, frame.possible) for candidate in candidates])
    if frame.table is not None:
        lowest = np.where(masks, frame.height(frame.grid.centers[frame.possible]), np.inf).min(axis=1, initial=np.inf)
        log_weight -= np.clip(lowest - frame.grid.size, 0.0, frame.excess) / (HOVERING * frame.excess)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    solids = masks.astype(np.float32)
    common, volume = solids @ solids.T, solids.sum(axis=1)
    apart = volume[:, None] + volume - 2.0 * common
    chosen: list[int] = []
    left = np.full(len(candidates), apart.max())
    while len(chosen) < min(count, len(candidates)):
        gain = np.maximum(left - apart, 0.0) @ weight
        best = int(gain.argmax())
        if chosen and gain[best] <= 1e-6 * apart.max():
            break
        chosen.append(best)
        left = np.minimum(left, apart[best])
    mass = np.bincount(apart[chosen].argmin(axis=0), weight, minlength=len(chosen))
    order = np.append(0, 1 + np.argsort(-mass[1:], kind="stable"))
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
