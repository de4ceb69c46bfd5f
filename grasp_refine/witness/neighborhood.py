"""Neighbourhoods: which surface candidates stand for the surface near a witness point.

A candidate belongs to the neighbourhood of a witness when it lies within a radius and its outward normal within
120 degrees of the contact normal; the witness point itself always belongs. Candidates are stored in random
order, so taking consecutive ones (cyclically, from an offset that depends on the seed and the iteration only)
is a random choice that does not depend on what else is in the batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from grasp_refine.errors import CollisionError
from grasp_refine.geometry.body import Body

_COS_NORMALS = -0.5
"""Normals within 120 degrees of the contact normal."""

_WINDOW = 128
"""How many candidates are looked at first when only a few are drawn."""

_SMALLEST_SPREAD = 0.05
"""Floor of the temperature, as a fraction of the squared candidate spacing."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Candidates of S bodies stacked for batched selection, all with the same number N of them."""

    points: np.ndarray
    """(S, N, 3) in metres, each in its body's frame."""
    normals: np.ndarray
    """Unit outward normals (S, N, 3)."""
    spacing: np.ndarray
    """eps = 2 sqrt(area / N) of each body (S,), in metres: a disc of this radius holds about 12 candidates."""
    diagonal: np.ndarray
    """Bounding-box diagonal of each body (S,), in metres."""

    @staticmethod
    def of(bodies: Sequence[Body]) -> "Surfaces":
        """The stacked candidates of `bodies`.

        Raises:
            CollisionError: the bodies were built with different numbers of candidates.
        """
        counts = {len(body.candidates.points) for body in bodies}
        if len(counts) > 1:
            raise CollisionError(
                f"bodies of one scene need equally many surface candidates, got {', '.join(map(str, sorted(counts)))}: "
                "load hand and object with the same `candidates`"
            )
        points = np.stack([body.candidates.points for body in bodies])
        normals = np.stack([body.candidates.normals for body in bodies])
        spacing = np.array([2.0 * np.sqrt(body.area / len(body.candidates.points)) for body in bodies])
        return Surfaces(points, normals, spacing, np.array([body.diagonal for body in bodies]))

    def take(self, index: np.ndarray) -> "Surfaces":
        """The surfaces of the bodies `index`."""
        return Surfaces(self.points[index], self.normals[index], self.spacing[index], self.diagonal[index])

    @property
    def floor(self) -> np.ndarray:
        """Smallest sensible spread of squared distances between neighbours (S, 1), in square metres."""
        return _SMALLEST_SPREAD * self.spacing[:, None] ** 2

    @cached_property
    def center(self) -> np.ndarray:
        """Mean of the candidates (S, 3); coordinates about it keep single precision accurate."""
        return self.points.mean(axis=1)

    @cached_property
    def _features(self) -> np.ndarray:
        """(S, 4, 2 N) single: (-2 v, |v|^2) about the centre, twice in a row so that a cyclic window is a slice."""
        v = self.points - self.center[:, None]
        features = np.concatenate([-2.0 * v, (v * v).sum(axis=2, keepdims=True)], axis=2).mT
        return np.concatenate([features, features], axis=2).astype(np.float32)

    def offsets(self, x: np.ndarray, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """|v - x|^2 - |x|^2 of `count` candidates from `first` on, cyclically (S, B, count), and |x|^2 (S, B).

        Witness points x (S, B, 3) are in body frames; single precision about the centre, which suffices to choose.
        """
        y = x - self.center[:, None]
        ones = np.concatenate([y, np.ones_like(y[..., :1])], axis=2).astype(np.float32)
        return ones @ self._features[:, :, first : first + count], (y * y).sum(axis=2)


@dataclass(frozen=True, eq=False)
class Neighbors:
    """Chosen candidates of each witness point; the witness itself comes first."""

    points: np.ndarray
    """(S, B, K, 3) in the body frames, metres."""
    normals: np.ndarray
    """Outward normals (S, B, K - 1, 3) of the candidates, body frames; the witness has none of its own."""
    mask: np.ndarray
    """(S, B, K): false pads."""
    radius: np.ndarray
    """Radius (S, B) of each neighbourhood in metres; (S, 1) where it is that of the body."""
    floor: np.ndarray
    """Smallest sensible spread of squared distances (S, 1), in square metres."""


@runtime_checkable
class Neighborhood(Protocol):
    """A rule that says how wide the neighbourhood of a witness point is, and how many candidates it uses."""

    samples: int | None
    minimum: int

    def radius(self, surfaces: Surfaces, x: np.ndarray, target: np.ndarray | None) -> np.ndarray:
        """Radius in metres, (S, B) or (S, 1), of witness points x (S, B, 3) with targets (S, B, 3; NaN, None: none)."""
        ...


@dataclass(frozen=True)
class Adaptive:
    """As wide as the witness is from its target, so that smoothing fades out as the goal is reached (the paper's)."""

    samples: int | None = 16
    """Candidates drawn at random from the neighbourhood; None: all of them."""
    minimum: int = 8
    """With fewer candidates inside, the nearest ones are taken."""
    without_target: float = 4.0
    """Radius where no target is given, in candidate spacings."""

    def radius(self, surfaces: Surfaces, x: np.ndarray, target: np.ndarray | None) -> np.ndarray:
        """max(|t - x|, eps), and 4 eps where there is no target."""
        eps = surfaces.spacing[:, None]
        if target is None:
            return self.without_target * eps
        away = np.sqrt(((target - x) ** 2).sum(axis=2))
        return np.where(np.isnan(away), self.without_target * eps, np.maximum(away, eps))


@dataclass(frozen=True)
class Fixed:
    """A constant fraction of the body's size, whatever the target."""

    fraction: float = 0.1
    """Radius as a fraction of the body's bounding-box diagonal."""
    samples: int | None = 16
    """Candidates drawn at random from the neighbourhood; None: all of them."""
    minimum: int = 8
    """With fewer candidates inside, the nearest ones are taken."""

    def radius(self, surfaces: Surfaces, x: np.ndarray, target: np.ndarray | None) -> np.ndarray:
        """Fraction x diagonal."""
        return np.broadcast_to(self.fraction * surfaces.diagonal[:, None], x.shape[:2])


def draw_offset(seed: int, key: int) -> int:
    """Where iteration `key` begins in the random order: multiples of the golden ratio spread evenly over it."""
    return ((key + 1) * 0x9E3779B97F4A7C15 + seed * 0xD1B54A32D192ED03) % 2**64 >> 33


def choose(
    rule: Neighborhood,
    surfaces: Surfaces,
    x: np.ndarray,
    normal: np.ndarray,
    target: np.ndarray | None,
    offset: int,
) -> Neighbors:
    """The neighbours of witness points by a rule.

    Args:
        rule: `Adaptive` or `Fixed`.
        surfaces: Candidates of S bodies.
        x: Witness points (S, B, 3), body frames, metres.
        normal: Outward contact normals (S, B, 3), body frames.
        target: Target points (S, B, 3), body frames (NaN: none), or None.
        offset: Where in the random order of the candidates the draw begins.
    """
    S, B, _ = x.shape
    N = surfaces.points.shape[1]
    radius = rule.radius(surfaces, x, target)
    body = np.repeat(np.arange(S), B)
    minimum = min(rule.minimum, N)
    width = N if rule.samples is None else max(rule.samples, minimum)
    # A window of the random order is enough for wide neighbourhoods, which hold most of the candidates.
    window = N if rule.samples is None else min(N, _WINDOW)
    rows = _Rows(surfaces, x, normal, np.broadcast_to(radius, (S, B)), offset % N)
    index, normals, mask, inside = rows.draw(window, width)
    hungry = mask.sum(axis=1) < minimum
    if window < N:
        hungry |= inside < width
    hungry = hungry.reshape(S, B)
    most = hungry.sum(axis=1).max()
    if most:
        # Equally many rows of each body; those that are full already draw the same candidates again.
        columns = np.argsort(~hungry, axis=1, kind="stable")[:, :most]
        again = rows.take(columns)
        here = (np.arange(S)[:, None] * B + columns).reshape(-1)
        index[here], normals[here], mask[here] = again.draw_at_least(minimum, width)
    points = np.empty((S * B, width + 1, 3))
    points[:, 0] = x.reshape(S * B, 3)
    points[:, 1:] = surfaces.points[body[:, None], index]
    with_witness = np.ones((S * B, width + 1), dtype=bool)
    with_witness[:, 1:] = mask
    return Neighbors(
        points.reshape(S, B, -1, 3),
        normals.reshape(S, B, -1, 3),
        with_witness.reshape(S, B, -1),
        radius,
        surfaces.floor,
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """The witness points of a draw, M = S B of them in rows."""

    surfaces: Surfaces
    x: np.ndarray
    """(S, B, 3)."""
    normal: np.ndarray
    """(S, B, 3)."""
    radius: np.ndarray
    """(S, B)."""
    first: int
    """The candidate that the draw begins with."""

    @cached_property
    def body(self) -> np.ndarray:
        """Body (M, 1) of each row."""
        S, B, _ = self.x.shape
        return np.repeat(np.arange(S), B)[:, None]

    def take(self, columns: np.ndarray) -> "_Rows":
        """Some witness points (S, H) of each body."""
        x, normal = (np.take_along_axis(array, columns[..., None], axis=1) for array in (self.x, self.normal))
        return _Rows(self.surfaces, x, normal, np.take_along_axis(self.radius, columns, axis=1), self.first)

    def draw(
        self, window: int, width: int, squared: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Up to `width` candidates inside the radius (M, width) from a window of the random order.

        Also their normals (M, width, 3), which of them are real, and how many the window has inside (M,).
        `squared` saves asking for the squared distances to the candidates of the window again.
        """
        squared = self.squared(window) if squared is None else squared
        inside = squared <= (self.radius**2).astype(np.float32)[..., None]
        flat = np.flatnonzero(inside.reshape(-1))
        row = flat // window
        count = np.bincount(row, minlength=len(self.body))
        rank = np.arange(len(flat)) - np.repeat(np.cumsum(count) - count, count)
        keep = rank < width
        row, rank = row[keep], rank[keep]
        index = np.zeros((len(self.body), width), dtype=np.int64)
        mask = np.zeros(index.shape, dtype=bool)
        index[row, rank] = self._candidate(flat[keep] - row * window)
        mask[row, rank] = True
        normals = self.surfaces.normals[self.body, index]
        mask &= self._agree(normals, slice(None))
        return index, normals, mask, count

    def draw_at_least(self, minimum: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `draw` from all candidates; rows with fewer than `minimum` get the nearest ones instead."""
        N = self.surfaces.points.shape[1]
        squared = self.squared(N)
        index, normals, mask, _ = self.draw(N, width, squared)
        few = np.flatnonzero(mask.sum(axis=1) < minimum)
        if len(few):
            index[few], normals[few], mask[few] = self._nearest(few, squared.reshape(-1, N)[few], minimum, width)
        return index, normals, mask

    def squared(self, window: int) -> np.ndarray:
        """Squared distances (S, B, window) to the candidates of a window."""
        offsets, x_squared = self.surfaces.offsets(self.x, self.first, window)
        offsets += x_squared.astype(np.float32)[..., None]
        return offsets

    def _nearest(
        self, rows: np.ndarray, squared: np.ndarray, count: int, width: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The `count` nearest candidates of some rows whose normals agree; same shapes as from `draw`."""
        N = squared.shape[1]
        shortlist = min(N, 4 * count)
        while True:
            near = np.argpartition(squared, shortlist - 1, axis=1)[:, :shortlist]
            near = np.take_along_axis(near, np.argsort(np.take_along_axis(squared, near, axis=1), axis=1), axis=1)
            candidate = self._candidate(near)
            normals = self.surfaces.normals[self.body[rows], candidate]
            agree = self._agree(normals, rows)
            if shortlist == N or (agree.sum(axis=1) >= count).all():
                break
            shortlist = N
        # Those that agree come first, by their distance.
        first = np.argsort(~agree, axis=1, kind="stable")[:, :count]
        index = np.zeros((len(rows), width), dtype=np.int64)
        mask = np.zeros(index.shape, dtype=bool)
        index[:, :count] = np.take_along_axis(candidate, first, axis=1)
        mask[:, :count] = np.take_along_axis(agree, first, axis=1)
        return index, self.surfaces.normals[self.body[rows], index], mask

    def _candidate(self, position: np.ndarray) -> np.ndarray:
        """Which candidate stands at a position of the random order, counted from `first`."""
        return (position + self.first) % self.surfaces.points.shape[1]

    def _agree(self, normals: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
        """Whether normals (M, K, 3) lie within 120 degrees of the contact normals of their rows (M, K)."""
        return (normals @ self.normal.reshape(-1, 3)[rows, :, None])[..., 0] >= _COS_NORMALS
