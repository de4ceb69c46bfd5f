"""Faults of answers, compared with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.se3 import matvec
from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.bench.stability.cases import DType
from grasp_refine_apps.bench.stability.polytopes import outside, separations
from grasp_refine_apps.bench.stability.reference import Truth

SIZE_TOLERANCE, TOLERANCE_M, POSITION_TOLERANCE = 1e-8, 1e-12, 1e-15
"""Allowed error of a distance: a share of the diagonal, metres, and a share of the position."""

SINGLE_TOLERANCE = float(np.finfo(np.float32).eps)
"""Allowed error in single precision: a share of diagonal plus position."""

POINT_TOLERANCE = 1e-6
"""Allowed error of a point as a share of the diagonal, besides the slide due to the error of the distance."""

MIN_SLIDE_ERROR = 1e-12
"""Lower bound of that error of the distance, as a share of the diagonal and of the distance of the cores."""

SIGN_ROUNDINGS = 64.0
"""Distances of more than this number of roundings of diagonal and position have a known sign."""


FAULTS = ("failed", "not_finite", "wrong_distance", "wrong_sign", "wrong_points")
"""Faults of an answer, fields of `AnswerFaults`."""


@dataclass(frozen=True, eq=False)
class AnswerFaults:
    """Faults of N answers; missing or non-finite answers have no other fault."""

    failed: np.ndarray
    """Missing answers (N,)."""
    not_finite: np.ndarray
    """Answers (N,) that are not finite, or finite poses that are reported as not finite."""
    wrong_distance: np.ndarray
    """Distances (N,) farther from the truth than the tolerance."""
    wrong_sign: np.ndarray
    """Distances (N,) of the wrong sign where the truth exceeds the tolerance, or with a contradicting status."""
    wrong_points: np.ndarray
    """Points (N,) that differ from a unique true pair, are not on the bodies, or are not the distance apart along the
    normal; or a normal along which the bodies are not that far apart."""
    compared: np.ndarray
    """True (N,) where there is only one pair of points."""
    collapsed: np.ndarray
    """True (N,) where sign or status contradict a truth beyond all rounding, but within the tolerance. No fault."""
    error: np.ndarray
    """Error of the distance (N,) in metres; NaN without an answer."""
    tolerance: np.ndarray
    """Allowed error of the distance (N,), in metres."""
    points_error: np.ndarray
    """Largest error of points and normal (N,) over its tolerance; NaN without an answer."""

    @property
    def wrong(self) -> np.ndarray:
        """Answers (N,) with any fault."""
        return np.any([getattr(self, name) for name in FAULTS], axis=0)


def tolerance(diagonal: float, position: np.ndarray, dtype: DType = "float64") -> np.ndarray:
    """Allowed error (N,) of distances in metres.

    Args:
        diagonal: Diagonal of the larger body in metres.
        position: Distance (N,) of the bodies from the origin of the world, metres.
        dtype: Precision of poses and answers.
    """
    return SIZE_TOLERANCE * diagonal + TOLERANCE_M + _rounding(diagonal, position, dtype)


def _rounding(diagonal: float, position: np.ndarray, dtype: DType) -> np.ndarray:
    """Largest displacement (N,) of bodies by the rounding of their poses, in metres."""
    return POSITION_TOLERANCE * position + (SINGLE_TOLERANCE * (position + diagonal) if dtype == "float32" else 0.0)


def _zeroed(found: Witness, good: np.ndarray) -> Witness:
    """Replace answers (N,) that are not good by zeros, so that the following is finite."""
    parts = {name: np.where(good[:, None], getattr(found, name), 0.0) for name in ("point_a", "point_b", "normal")}
    return replace(found, **parts, distance=np.where(good, found.distance, 0.0))


def judge(
    found: Witness,
    truth: Truth,
    pieces: tuple[Sequence[Piece], Sequence[Piece]],
    T_a: np.ndarray,
    T_b: np.ndarray,
    diagonal: float,
    dtype: DType = "float64",
) -> AnswerFaults:
    """Check N answers.

    Args:
        found: The answers (N,), in world coordinates.
        truth: The truth (N,), in the frame of the first body.
        pieces: The piece pairs that winners index, see `Pairs.piece_pairs`.
        T_a: Poses (N, 4, 4) of the first body, in double precision.
        T_b: Poses (N, 4, 4) of the second body, in double precision.
        diagonal: Diagonal of the larger body, in metres.
        dtype: Precision of the queried poses.
    """
    position = np.maximum(*(np.linalg.norm(T[:, :3, 3], axis=1) for T in (T_a, T_b)))
    allowed = tolerance(diagonal, position, dtype)
    answered = found.status <= QueryStatus.PENETRATING
    numbers = np.concatenate([found.point_a, found.point_b, found.normal, found.distance[:, None]], axis=1)
    finite = np.isfinite(numbers).all(axis=1)
    not_finite = (answered & ~finite) | (found.status == QueryStatus.NOT_FINITE)
    good = answered & finite
    found = _zeroed(found, good)
    error = np.where(good, np.abs(found.distance - truth.distance), np.nan)
    opposite = (np.sign(found.distance) != np.sign(truth.distance)) & (np.abs(truth.distance) > allowed)
    contrary = (found.distance > 0.0) != (found.status == QueryStatus.SEPARATED)
    # Only where rounding of the poses is negligible: otherwise it decides which feature is the nearest.
    sharp = good & (allowed <= POINT_TOLERANCE * diagonal)
    compared = sharp & truth.unique
    # If a point is d from a plane, points of the plane that are sqrt(2 d e) from the nearest one are d + e away.
    least = MIN_SLIDE_ERROR * (diagonal + np.abs(truth.core)) + _rounding(diagonal, position, dtype)
    slack = np.maximum(error, least)
    aslant = np.sqrt(2.0 * np.maximum(truth.core, 0.0) * slack)
    near = POINT_TOLERANCE * diagonal + aslant + np.where(compared, truth.slide, 1.0) * slack
    R = T_a[:, :3, :3]
    off = np.maximum(
        *(
            np.linalg.norm(matvec(R.mT, point - T_a[:, :3, 3]) - true, axis=1)
            for point, true in ((found.point_a, truth.point_a), (found.point_b, truth.point_b))
        )
    )
    # Whatever the true points are, these are on the bodies, and that far apart along the normal, as the bodies are.
    fault = np.linalg.norm(found.point_b - found.point_a - found.distance[:, None] * found.normal, axis=1)
    t, turned = matvec(R.mT, T_b[:, :3, 3] - T_a[:, :3, 3]), R.mT @ T_b[:, :3, :3]
    normal = matvec(R.mT, found.normal)
    for winner in np.unique(found.winner[sharp]):
        rows = np.flatnonzero(sharp & (found.winner == winner))
        a, b = (side[winner] for side in pieces)
        parted = separations(a, b, turned[rows], t[rows], normal[rows])
        in_a, in_b = (
            matvec(T[rows, :3, :3].mT, point[rows] - T[rows, :3, 3])
            for T, point in ((T_a, found.point_a), (T_b, found.point_b))
        )
        faults = fault[rows], truth.distance[rows] - parted, outside(a, in_a), outside(b, in_b)
        fault[rows] = np.maximum.reduce(faults)
    fault += np.abs(np.linalg.norm(found.normal, axis=1) - 1.0) * diagonal
    wide = POINT_TOLERANCE * (diagonal + np.abs(truth.distance)) + allowed
    points_error = np.where(good, np.maximum(np.where(compared, off / near, 0.0), fault / wide), np.nan)
    wrong_distance, wrong_sign = good & (error > allowed), good & (opposite | contrary)
    certain = np.abs(truth.distance) > SIGN_ROUNDINGS * np.finfo(dtype).eps * (diagonal + position)
    other = (np.sign(found.distance) != np.sign(truth.distance)) | (
        (found.status == QueryStatus.SEPARATED) != (truth.distance > 0.0)
    )
    return AnswerFaults(
        failed=~answered & ~not_finite,
        not_finite=not_finite,
        wrong_distance=wrong_distance,
        wrong_sign=wrong_sign,
        wrong_points=points_error > 1.0,
        compared=compared,
        collapsed=good & certain & other & ~wrong_distance & ~wrong_sign,
        error=error,
        tolerance=allowed,
        points_error=points_error,
    )
