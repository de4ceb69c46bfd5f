"""Two ellipsoids in closed form: support points, curvatures and witness points, apart, touching and overlapping."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.se3 import exp_se3, exp_so3


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid about the origin of the pose T (4, 4), with half axes (3,) along its columns."""

    T: np.ndarray
    axes: np.ndarray

    def moved(self, twist: np.ndarray) -> "Ellipsoid":
        """The same, moved by a spatial twist (v, w)."""
        return Ellipsoid(exp_se3(twist) @ self.T, self.axes)

    def support(self, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The point with outward normal n, s = c + M n / sqrt(n M n), and ds/dn, which is the inverse of dn/ds."""
        R = self.T[:3, :3]
        M = R @ np.diag(self.axes**2) @ R.T
        h = np.sqrt(n @ M @ n)
        s = M @ n / h
        return self.T[:3, 3] + s, (M - np.outer(s, s)) / h

    def curvature(self, n: np.ndarray, E: np.ndarray) -> np.ndarray:
        """Curvature (2, 2) in 1/m at the point with outward normal n, in its tangent basis E (3, 2)."""
        return np.linalg.inv(E.T @ self.support(n)[1] @ E)


@dataclass(frozen=True)
class Contact:
    """Witness points of two ellipsoids with the normal from a to b."""

    x_a: np.ndarray
    x_b: np.ndarray
    n: np.ndarray
    d: float
    E: np.ndarray


def tangents(n: np.ndarray) -> np.ndarray:
    """Two unit tangents (3, 2) of a unit normal."""
    return np.linalg.svd(n[None])[2][1:].T


def contact(a: Ellipsoid, b: Ellipsoid, n: np.ndarray) -> Contact:
    """The stationary pair near the normal n: P (s_b(-n) - s_a(n)) = 0, by Newton's method on the sphere of normals.

    Regular at every signed distance, contact included.
    """
    for _ in range(50):
        (x_a, ds_a), (x_b, ds_b) = a.support(n), b.support(-n)
        E, gap = tangents(n), x_b - x_a
        # n' = E u changes s_b(-n) - s_a(n) by -(ds_a + ds_b) E u, and the tangents by -n (E u)^T.
        J = -E.T @ (ds_a + ds_b) @ E - (gap @ n) * np.eye(2)
        u = -np.linalg.solve(J, E.T @ gap)
        n = exp_so3(np.cross(n, E @ u)) @ n
        if np.abs(u).max() < 1e-15:
            break
    (x_a, _), (x_b, _) = a.support(n), b.support(-n)
    gap = x_b - x_a
    assert np.abs(gap - (gap @ n) * n).max() < 1e-14
    return Contact(x_a, x_b, n, float(gap @ n), tangents(n))


def at_gap(seed: int, gap: float) -> tuple[Ellipsoid, Ellipsoid, Contact]:
    """Two random ellipsoids whose signed distance is `gap`."""
    rng = np.random.default_rng(seed)
    a, b = (
        Ellipsoid(exp_se3(rng.normal(size=6) * [0.1, 0.1, 0.1, 1, 1, 1]), rng.uniform(0.02, 0.04, 3)) for _ in range(2)
    )
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    # Equal normals face each other along n; b then moves there.
    T = b.T.copy()
    T[:3, 3] += a.support(n)[0] + gap * n - b.support(-n)[0]
    b = Ellipsoid(T, b.axes)
    found = contact(a, b, n)
    assert abs(found.d - gap) < 1e-14
    return a, b, found


def motion(a: Ellipsoid, b: Ellipsoid, n: np.ndarray, h: float = 1e-5) -> np.ndarray:
    """Central differences (12, 3, 3) of (x_a, x_b, n) along the six spatial twists of a, then of b."""
    rows = []
    for k in range(12):
        ends = []
        for sign in (1.0, -1.0):
            twist = sign * h * np.eye(6)[k % 6]
            c = contact(a.moved(twist), b, n) if k < 6 else contact(a, b.moved(twist), n)
            ends.append(np.stack([c.x_a, c.x_b, c.n]))
        rows.append((ends[0] - ends[1]) / (2 * h))
    return np.array(rows)
