"""Curvatures of surfaces near witness points, fitted to the surface candidates around them.

Like the fit of `contact_kinematics` to a few samples, for the solvers that need it in every iteration: weights and
moments of the candidates of a body come from three matrix products. A wide neighbourhood is fitted to a random half of
them, a quarter and so on, as long as enough are left in it. The compiled engine (see `native_kinematics`) does it in
double precision, and visits only the candidates nearby.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.body import Body
from grasp_refine.witness.neighborhood import COS_NORMALS

RIDGE_RATIO = 1e-3
"""Ridge of the least squares, as a fraction of rho^2: without it, candidates on a line would leave K undetermined."""

_BLOCK_POINTS = 128
"""Witness points that are fitted together, so that their weights stay in the processor's cache."""

_ENOUGH_CANDIDATES = 32
"""Number of candidates within the radius, on a flat surface, half of which are too few for a fit."""

_MIN_CANDIDATES = 16.0
"""Number of 1024 candidates within the smallest radius, on a flat surface."""


@dataclass(frozen=True, eq=False)
class Curvatures:
    """Curvature fit to the candidates of B bodies; single precision about their centres suffices."""

    count: np.ndarray
    """Number of candidates (B,) of each body."""
    density: np.ndarray
    """Candidates per square metre (B,)."""

    center: np.ndarray
    """Mean of the candidates (B, 3), body frames, metres."""
    position: np.ndarray
    """Features (v, |v|^2, 1) of each candidate (B, 5, N), about the centre."""
    normal: np.ndarray
    """Outward normals (B, 3, N)."""
    products: np.ndarray
    """Products 1, v, n, v v^T and v n^T of each candidate (B, N, 25)."""

    @staticmethod
    def of(bodies: Sequence[Body]) -> "Curvatures":
        """Precompute the features of bodies; fewer candidates than others are padded with zeros, which weigh 0."""
        center = np.array([body.candidates.points.mean(axis=0) for body in bodies])
        count = np.array([len(body.candidates.points) for body in bodies])
        density = count / np.array([body.area for body in bodies])
        columns = np.zeros((len(bodies), count.max(), 33), dtype=np.float32)
        for row, body, middle in zip(columns, bodies, center, strict=True):
            v, n = body.candidates.points - middle, body.candidates.normals
            one = np.ones((len(v), 1))
            squares = [(v[:, :, None] * other[:, None, :]).reshape(-1, 9) for other in (v, n)]
            row[: len(v)] = np.hstack([v, (v * v).sum(axis=1, keepdims=True), one, n, one, v, n, *squares])
        parts = columns[..., :5].mT, columns[..., 5:8].mT, columns[..., 8:]
        return Curvatures(count, density, center, *map(np.ascontiguousarray, parts))

    def fit(self, body: np.ndarray, x: np.ndarray, normal: np.ndarray, E: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Fit symmetric curvatures K (R, 2, 2) in 1/m, positive for convex: E^T n_j = b + K E^T (v_j - x).

        Least squares over the candidates v_j, n_j within the radius rho, or a sample of them where that is wide,
        weighted by 1 - |v_j - x|^2 / rho^2; eigenvalues are clipped to [-1/rho, 4/rho], the range that candidates of
        that spread can resolve.

        Args:
            body: Body (R,) of each witness point.
            x: Witness points (R, 3), body frames, metres.
            normal: Outward contact normals (R, 3), body frames.
            E: Tangents (R, 3, 2) as columns, body frames.
            radius: rho (R,) in metres.
        """
        moments = np.empty((len(x), self.products.shape[2]))
        scale = 1.0 / (radius * radius)
        y = x - self.center[body]
        weigh = np.empty((len(x), 5), dtype=np.float32)
        weigh[:, :3] = (2.0 * scale)[:, None] * y
        weigh[:, 3] = -scale
        weigh[:, 4] = 1.0 - scale * (y * y).sum(axis=1)
        facing = normal.astype(np.float32)
        level = self._level(body, radius)
        key = body * (level.max(initial=0) + 1) + level
        order = np.argsort(key, kind="stable")
        for group in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
            for start in range(0, len(group), _BLOCK_POINTS):
                rows = group[start : start + _BLOCK_POINTS]
                b, some = body[rows[0]], slice(self.count[body[rows[0]]] >> level[rows[0]])
                # One row at a time: in a product of many rows, the rounding of each depends on their number.
                weight = weigh[rows, None] @ self.position[b][:, some]
                np.maximum(weight, 0.0, out=weight)
                weight *= facing[rows, None] @ self.normal[b][:, some] >= COS_NORMALS
                moments[rows] = (weight @ self.products[b][some])[:, 0]
        return _curvature(moments, E, radius)

    def _level(self, body: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Halvings (R,) of the candidates: their order is random, so the first ones are a sample of the surface."""
        expected = self.density[body] * np.pi * radius * radius
        most = np.maximum(np.frexp(self.count / _ENOUGH_CANDIDATES)[1] - 1, 0)
        return np.clip(np.frexp(expected / _ENOUGH_CANDIDATES)[1] - 1, 0, most[body])


def smallest_radii(bodies: Sequence[Body]) -> np.ndarray:
    """Radii sqrt(16 area / (1024 pi)) (B,) in metres of neighbourhoods of bodies that hold just enough candidates."""
    return np.sqrt(_MIN_CANDIDATES * np.array([body.area for body in bodies]) / (1024 * np.pi))


def raise_eigenvalues(K_a: np.ndarray, K_b: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Raise the eigenvalues of K_a + K_b (..., 2, 2) to the floor (...), half by each."""
    half = 0.5 * with_eigenvalues(K_a + K_b, lambda values: np.maximum(floor - values, 0.0))
    return K_a + half, K_b + half


def with_eigenvalues(K: np.ndarray, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Apply a function to the eigenvalues of symmetric matrices K (..., 2, 2); the eigenvectors stay."""
    mean = 0.5 * (K[..., 0, 0] + K[..., 1, 1])
    difference, mixed = K[..., 0, 0] - mean, K[..., 0, 1]
    half = np.sqrt(difference * difference + mixed * mixed)
    high, low = function(mean + half), function(mean - half)
    mean = 0.5 * (high + low)
    factor = 0.5 * (high - low) / np.where(half > 0, half, 1.0)
    result = np.empty_like(K)
    result[..., 0, 0], result[..., 1, 1] = mean + factor * difference, mean - factor * difference
    result[..., 0, 1] = result[..., 1, 0] = factor * mixed
    return result


def _curvature(moments: np.ndarray, E: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Curvatures (R, 2, 2) from moments (R, 25) and tangents (R, 3, 2)."""
    mean = moments[:, 1:] / np.maximum(moments[:, :1], np.finfo(np.float32).tiny)
    v, v_and_n = mean[:, :3], mean[:, :6]
    products = np.concatenate([mean[:, 6:15].reshape(-1, 3, 3), mean[:, 15:].reshape(-1, 3, 3)], axis=2)
    spread = E.mT @ (products - v[:, :, None] * v_and_n[:, None, :])
    A, B = spread[..., :3] @ E, spread[..., 3:] @ E
    ridge = RIDGE_RATIO * radius * radius
    a, b, c = A[:, 0, 0] + ridge, A[:, 0, 1], A[:, 1, 1] + ridge
    # A and B are e e^T and e n^T: K^T = A^-1 B, and its symmetric part.
    scale = 1.0 / (a * c - b * b)
    K = np.empty_like(A)
    K[:, 0, 0] = (c * B[:, 0, 0] - b * B[:, 1, 0]) * scale
    K[:, 1, 1] = (a * B[:, 1, 1] - b * B[:, 0, 1]) * scale
    K[:, 0, 1] = K[:, 1, 0] = 0.5 * scale * (c * B[:, 0, 1] - b * B[:, 1, 1] + a * B[:, 1, 0] - b * B[:, 0, 0])
    return with_eigenvalues(K, lambda values: np.clip(values, -1.0 / radius, 4.0 / radius))
