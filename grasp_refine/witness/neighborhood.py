"""Neighbourhoods: choice of the surface candidates near a witness point.

A candidate is in the neighbourhood of a witness when it lies within a radius and its outward normal within
120 degrees of the contact normal; the witness point itself is always included. Candidates are stored in random
order, so taking consecutive ones (cyclically, from an offset that depends on the seed and the iteration only)
is a random choice that does not depend on the rest of the batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.core.errors import CollisionError
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry.body import Body

COS_NORMALS = -0.5
"""Cosine of 120 degrees, the largest angle between the contact normal and normals that count."""

_WINDOW_CANDIDATES = 128
"""Candidates that are tested first when only a few are drawn."""

_MIN_SPREAD_RATIO = 0.05
"""Floor of the temperature, as a fraction of the squared candidate spacing."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Candidates of S bodies stacked for batched selection, all with the same number N of them."""

    points: np.ndarray
    """Candidates (S, N, 3) in metres, in the frames of their bodies."""
    normals: np.ndarray
    """Unit outward normals (S, N, 3)."""
    spacing: np.ndarray
    """Spacing eps = 2 sqrt(area / N) of each body (S,), in metres: a disc of this radius holds about 12 candidates."""
    diagonal: np.ndarray
    """Bounding-box diagonal of each body (S,), in metres."""

    __repr__ = brief

    @staticmethod
    def of(bodies: Sequence[Body]) -> "Surfaces":
        """Stack the candidates of `bodies`.

        Raises:
            CollisionError: the bodies were built with different numbers of candidates.
        """
        counts = {len(body.candidates.points) for body in bodies}
        if len(counts) > 1:
            raise CollisionError(
                f"bodies of one scene need equally many surface candidates, got {', '.join(map(str, sorted(counts)))}: "
                "load hand and object with the same number of candidates"
            )
        points = np.stack([body.candidates.points for body in bodies])
        normals = np.stack([body.candidates.normals for body in bodies])
        spacing = np.array([2.0 * np.sqrt(body.area / len(body.candidates.points)) for body in bodies])
        return Surfaces(points, normals, spacing, np.array([body.diagonal for body in bodies]))

    def take(self, index: np.ndarray) -> "Surfaces":
        """Return the surfaces of the bodies `index`."""
        return Surfaces(self.points[index], self.normals[index], self.spacing[index], self.diagonal[index])

    @property
    def floor(self) -> np.ndarray:
        """Smallest sensible spread of squared distances between neighbours (S, 1), in square metres."""
        return _MIN_SPREAD_RATIO * self.spacing[:, None] ** 2

    @cached_property
    def center(self) -> np.ndarray:
        """Mean of the candidates (S, 3); coordinates about it keep single precision accurate."""
        return self.points.mean(axis=1)

    @cached_property
    def _features(self) -> np.ndarray:
        """Features (-2 v, |v|^2) about the centre (S, 4, 2 N), float32; repeated so that a cyclic window is a slice."""
        v = self.points - self.center[:, None]
        features = np.concatenate([-2.0 * v, (v * v).sum(axis=2, keepdims=True)], axis=2).mT
        return np.concatenate([features, features], axis=2).astype(np.float32)

    def offsets(self, x: np.ndarray, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Values |v - x|^2 - |x|^2 of `count` candidates from `first` on, cyclically (S, B, count), and |x|^2 (S, B).

        Witness points x (S, B, 3) are in body frames; single precision about the centre suffices for the choice.
        """
        y = x - self.center[:, None]
        ones = np.concatenate([y, np.ones_like(y[..., :1])], axis=2).astype(np.float32)
        return ones @ self._features[:, :, first : first + count], (y * y).sum(axis=2)

    def offsets_of(self, body: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Values |v - x|^2 - |x|^2 of all candidates (M, N) for points x (M, 3) of the bodies (M,)."""
        y = x - self.center[body]
        ones = np.concatenate([y, np.ones_like(y[:, :1])], axis=1).astype(np.float32)
        return (ones[:, None] @ self._features[body, :, : self.points.shape[1]])[:, 0]

    def pick(self, name: Literal["points", "normals"], index: np.ndarray) -> np.ndarray:
        """Points or normals (S, B, K, 3) of the candidates `index` (S, B, K) of each body."""
        S, N, _ = self.points.shape
        flat = index + (N * np.arange(S))[:, None, None]
        return getattr(self, name).reshape(S * N, 3).take(flat, axis=0)


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Chosen candidates of each witness point; the witness itself comes first."""

    points: np.ndarray
    """Points (S, B, K, 3) in the body frames, metres."""
    normals: np.ndarray
    """Outward normals (S, B, K - 1, 3) of the candidates, body frames; the witness has none of its own."""
    mask: np.ndarray
    """Mask (S, B, K): false for padding."""
    radius: np.ndarray
    """Radius (S, B) of each neighbourhood in metres; (S, 1) where it is one per body."""
    floor: np.ndarray
    """Smallest sensible spread of squared distances (S, 1), in square metres."""


@runtime_checkable
class Neighborhood(Protocol):
    """A rule for the width of a witness point's neighbourhood, and the number of its candidates."""

    @property
    def samples(self) -> int | None:
        """Number of candidates drawn at random from the neighbourhood; None: all."""
        ...

    @property
    def minimum(self) -> int:
        """Fewest candidates; with fewer inside, the nearest ones are taken."""
        ...

    def radius(self, surfaces: Surfaces, away: np.ndarray | None) -> np.ndarray:
        """Radius in metres, (S, B) or (S, 1), where witness points are `away` (S, B; NaN, None: none) from targets."""
        ...


@dataclass(frozen=True)
class Adaptive:
    """Radius equal to the distance of the witness from its target, as in the paper: smoothing fades at the goal."""

    samples: int | None = 16
    """Candidates drawn at random from the neighbourhood; None: all of them."""
    minimum: int = 8
    """Fewest candidates; with fewer inside, the nearest ones are taken."""
    smallest: float = 1.0
    """Smallest radius near a target, in candidate spacings; sqrt(N) / 2, 16 of 1024 candidates, spans the body."""
    without_target: float = 4.0
    """Radius where no target is given, in candidate spacings."""

    def __post_init__(self) -> None:
        """Refuse fields of another type, and numbers out of range."""
        check_positive(self, "samples", "minimum", "smallest", "without_target")

    def radius(self, surfaces: Surfaces, away: np.ndarray | None) -> np.ndarray:
        """Radius max(|t - x|, `smallest` eps), and `without_target` eps where there is no target."""
        eps = surfaces.spacing[:, None]
        if away is None:
            return self.without_target * eps
        return np.where(np.isnan(away), self.without_target * eps, np.maximum(away, self.smallest * eps))


@dataclass(frozen=True)
class Fixed:
    """Radius of a constant fraction of the body's size, independent of the target."""

    fraction: float = 0.1
    """Radius as a fraction of the body's bounding-box diagonal."""
    samples: int | None = 16
    """Candidates drawn at random from the neighbourhood; None: all of them."""
    minimum: int = 8
    """Fewest candidates; with fewer inside, the nearest ones are taken."""

    def __post_init__(self) -> None:
        """Refuse fields of another type, and numbers out of range."""
        check_positive(self, "fraction", "samples", "minimum")

    def radius(self, surfaces: Surfaces, away: np.ndarray | None) -> np.ndarray:
        """Radius `fraction` x diagonal."""
        return self.fraction * surfaces.diagonal[:, None]


def distance_from(target: np.ndarray | None, x: np.ndarray) -> np.ndarray | None:
    """Distances (S, B) of points x (S, B, 3) from their targets (S, B, 3; NaN: none), in metres."""
    return None if target is None else np.sqrt(((target - x) ** 2).sum(axis=2))


def draw_offset(seed: int, key: int) -> int:
    """Start of iteration `key` in the random order: multiples of the golden ratio spread evenly over it."""
    return ((key + 1) * 0x9E3779B97F4A7C15 + seed * 0xD1B54A32D192ED03) % 2**64 >> 33


def choose(
    rule: Neighborhood,
    surfaces: Surfaces,
    x: np.ndarray,
    normal: np.ndarray,
    target: np.ndarray | None,
    offset: int,
) -> Neighbors:
    """Choose the neighbours of witness points by a rule.

    Args:
        rule: `Adaptive` or `Fixed`.
        surfaces: Candidates of S bodies.
        x: Witness points (S, B, 3), body frames, metres.
        normal: Outward contact normals (S, B, 3), body frames.
        target: Target points (S, B, 3), body frames (NaN: none), or None.
        offset: Start of the draw in the random order of the candidates.
    """
    S, B, _ = x.shape
    N = surfaces.points.shape[1]
    radius = rule.radius(surfaces, distance_from(target, x))
    minimum = min(rule.minimum, N)
    width = N if rule.samples is None else max(rule.samples, minimum)
    # A window of the random order suffices for wide neighbourhoods, which hold most of the candidates.
    window = N if rule.samples is None else min(N, _WINDOW_CANDIDATES)
    first = offset % N
    index, mask, inside = _draw(surfaces, x, radius, first, window, width)
    incomplete = inside < width
    if window < N and incomplete.any():
        # Equally many witness points of each body; complete ones among them are not drawn again.
        columns = np.argsort(~incomplete, axis=1, kind="stable")[:, : incomplete.sum(axis=1).max()]
        wanted = np.take_along_axis(incomplete, columns, axis=1)
        some = np.take_along_axis(x, columns[..., None], axis=1)
        reach = np.where(wanted, np.take_along_axis(np.broadcast_to(radius, (S, B)), columns, axis=1), np.nan)
        more, more_mask, _ = _draw(surfaces, some, reach, first, N, width)
        body, _ = np.nonzero(wanted)
        index[body, columns[wanted]], mask[body, columns[wanted]] = more[wanted], more_mask[wanted]
    normals = surfaces.pick("normals", index)
    mask &= _agree_with_contact(normals, normal)
    few = np.nonzero(mask.sum(axis=2) < minimum)
    if len(few[0]):
        index[few], mask[few] = _nearest(surfaces, few[0], x[few], normal[few], minimum, width)
        normals[few] = surfaces.normals[few[0][:, None], index[few]]
    points = np.empty((S, B, width + 1, 3))
    points[:, :, 0] = x
    points[:, :, 1:] = surfaces.pick("points", index)
    with_witness = np.ones((S, B, width + 1), dtype=bool)
    with_witness[:, :, 1:] = mask
    return Neighbors(points, normals, with_witness, radius, surfaces.floor)


def _draw(
    surfaces: Surfaces, x: np.ndarray, radius: np.ndarray, first: int, window: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Up to `width` candidates inside the radius (S, B, width), from a window of the random order.

    Also the mask of real candidates, and the number inside the window (S, B). There are none where the radius is NaN.
    """
    S, B, _ = x.shape
    squared, x_squared = surfaces.offsets(x, first, window)
    inside = squared <= (radius * radius - x_squared).astype(np.float32)[..., None]
    flat = np.flatnonzero(inside.reshape(-1))
    row = flat // window
    count = np.bincount(row, minlength=S * B)
    rank = np.arange(len(flat)) - np.repeat(np.cumsum(count) - count, count)
    keep = rank < width
    row, rank = row[keep], rank[keep]
    index = np.zeros((S * B, width), dtype=np.int64)
    mask = np.zeros(index.shape, dtype=bool)
    index[row, rank] = (flat[keep] - row * window + first) % surfaces.points.shape[1]
    mask[row, rank] = True
    return index.reshape(S, B, width), mask.reshape(S, B, width), count.reshape(S, B)


def _nearest(
    surfaces: Surfaces, body: np.ndarray, x: np.ndarray, normal: np.ndarray, count: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """The `count` nearest candidates with normals that agree (M, width), and the mask of real candidates.

    Witness points x (M, 3) with normals (M, 3) are on the bodies (M,).
    """
    M, N = len(body), surfaces.points.shape[1]
    squared = surfaces.offsets_of(body, x)
    shortlist = min(N, 4 * count)
    while True:
        near = np.argpartition(squared, shortlist - 1, axis=1)[:, :shortlist]
        near = np.take_along_axis(near, np.take_along_axis(squared, near, axis=1).argsort(axis=1), axis=1)
        agree = _agree_with_contact(surfaces.normals[body[:, None], near], normal)
        if shortlist == N or (agree.sum(axis=1) >= count).all():
            break
        shortlist = N
    # Agreeing samples come first, by distance.
    chosen = np.argsort(~agree, axis=1, kind="stable")[:, :count]
    index, mask = np.zeros((M, width), dtype=np.int64), np.zeros((M, width), dtype=bool)
    index[:, :count] = np.take_along_axis(near, chosen, axis=1)
    mask[:, :count] = np.take_along_axis(agree, chosen, axis=1)
    return index, mask


def _agree_with_contact(normals: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Mask of the normals (..., K, 3) within 120 degrees of contact normals (..., 3)."""
    return (normals @ contact[..., None])[..., 0] >= COS_NORMALS
