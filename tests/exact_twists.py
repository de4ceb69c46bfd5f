"""Twists to try the maps of SE(3) on, and what these maps give: power series in extended precision."""

import numpy as np
from hypothesis import strategies as st

Long = np.longdouble

SPECIAL_ANGLES = (
    0.0, 1e-300, 1e-20, 1e-12, 1e-9, 1e-8, 1e-6, 1e-5, 0.999e-4, 1.001e-4, 1e-3, 0.01, 0.1, 0.3, 0.5, 1.0, np.pi / 2,
    3.0, np.pi - 1e-2, np.pi - 1e-4, np.pi - 1e-6, np.pi - 1e-8, np.pi - 1e-12, np.pi,
)  # fmt: skip
"""Rotation angles in radians where branches change, or numbers cancel."""

DTYPES = ("float64", "float32")


def angles() -> st.SearchStrategy[float]:
    """Rotation angles in [0, pi], mostly near one end."""
    near_zero = st.floats(-12, 0).map(lambda power: 10.0**power)
    return st.one_of(
        st.sampled_from(SPECIAL_ANGLES), near_zero, near_zero.map(lambda angle: np.pi - angle), st.floats(0, np.pi)
    )


def axes() -> st.SearchStrategy[np.ndarray]:
    """Unit vectors (3,), those along the axes and nearly along them included."""
    parts = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 1e-9, -1e-5]), st.floats(-1, 1))
    return st.tuples(parts, parts, parts).filter(lambda n: np.linalg.norm(n) > 0.1).map(lambda n: n / np.linalg.norm(n))


def lengths() -> st.SearchStrategy[float]:
    """Lengths in metres from a nanometre to a kilometre, and nothing."""
    return st.one_of(st.just(0.0), st.floats(-9, 3).map(lambda power: 10.0**power))


def twists() -> st.SearchStrategy[np.ndarray]:
    """Twists (v, w) (6,): a length along a direction, an angle about an axis."""
    return st.builds(lambda s, v, angle, w: np.concatenate([s * v, angle * w]), lengths(), axes(), angles(), axes())


def generator(twist: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) of a twist (v, w), written out by hand."""
    vx, vy, vz, wx, wy, wz = twist
    return np.array([[0, -wz, wy, vx], [wz, 0, -wx, vy], [-wy, wx, 0, vz], [0, 0, 0, 0]], dtype=Long)


def bracket(twist: np.ndarray) -> np.ndarray:
    """The matrix ad (6, 6) of a twist: ad(x) y = [x, y], so that Ad(exp x) = exp(ad x)."""
    v, w = (generator(np.concatenate([np.zeros(3), part]))[:3, :3] for part in (twist[:3], twist[3:]))
    return np.block([[w, v], [np.zeros((3, 3), dtype=Long), w]])


def series(matrix: np.ndarray, first: int, terms: int = 60) -> np.ndarray:
    """The sum of matrix^k / (k + first)!: for 0 the exponential, for 1 the integral of exp(t matrix) over [0, 1]."""
    total, power = np.zeros_like(matrix), np.eye(len(matrix), dtype=Long)
    for k in range(terms):
        power = power if k == 0 else power @ matrix
        power = power / Long(max(k + first, 1))
        total = total + power
    return total


def exact_exp(twist: np.ndarray) -> np.ndarray:
    """The transform (4, 4) of a twist (6,) in extended precision, good to 1e-17 for angles of a turn or less."""
    return series(generator(twist.astype(Long)), 0)


def exact_right_jacobian(twist: np.ndarray) -> np.ndarray:
    """J (6, 6): exp(x + dx) = exp(x) exp(J dx) to first order, the integral of exp(-t ad x)."""
    return series(-bracket(twist.astype(Long)), 1)
