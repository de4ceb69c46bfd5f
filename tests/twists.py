"""One finite-difference checker over twist directions, which every derivative of the witness layer passes through."""

from collections.abc import Callable, Mapping

import numpy as np
import torch

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import exp_se3, hat, log_so3
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.slip import Slip, pull_back

Loss = Callable[[Witness], np.ndarray]
FIELDS = ("point_a", "point_b", "normal", "distance")
"""The fields of a witness that have derivatives."""


def random_poses(count: int, seed: int, spread: float = 0.05) -> np.ndarray:
    """Poses (count, 1, 4, 4) with any orientation and positions of the given spread."""
    rng = np.random.default_rng(seed)
    return exp_se3(rng.normal(size=(count, 1, 6)) * [spread, spread, spread, 1.5, 1.5, 1.5])


def poses_at_gap(pairs: Pairs, count: int, gap: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random poses of both bodies whose signed distance is `gap`."""
    # Several times as many as wanted: concave bodies do not all come to rest at the gap.
    T_a, T_b = random_poses(4 * count, seed), random_poses(4 * count, seed + 1)
    for _ in range(12):
        found = query(pairs, T_a, T_b)
        T_b[..., :3, 3] += (gap - found.distance)[..., None] * found.normal
    settled = np.flatnonzero(np.abs(query(pairs, T_a, T_b).distance[:, 0] - gap) < 1e-6)[:count]
    assert len(settled) == count
    return T_a[settled], T_b[settled]


def adjoint(T: np.ndarray) -> np.ndarray:
    """Matrices Ad(T) (..., 6, 6) that carry twists (v, w) along: T exp(xi) T^-1 = exp(Ad(T) xi)."""
    R = T[..., :3, :3]
    top = np.concatenate([R, hat(T[..., :3, 3]) @ R], axis=-1)
    return np.concatenate([top, np.concatenate([np.zeros_like(R), R], axis=-1)], axis=-2)


def log_se3(T: np.ndarray) -> np.ndarray:
    """Twists (v, w) (..., 6) whose exponentials are T (..., 4, 4): V v = p, V by `exp_se3` column by column."""
    w = log_so3(T[..., :3, :3])
    columns = [exp_se3(np.concatenate([np.broadcast_to(e, w.shape), w], axis=-1))[..., :3, 3] for e in np.eye(3)]
    v = np.linalg.solve(np.stack(columns, axis=-1), T[..., :3, 3:])[..., 0]
    return np.concatenate([v, w], axis=-1)


def slopes_along_twists(
    value: Callable[[np.ndarray, np.ndarray], np.ndarray], T_a: np.ndarray, T_b: np.ndarray, step: float
) -> np.ndarray:
    """Central differences (12, ...) of value(T_a, T_b) along the six spatial twists of a, then of b."""
    rows = []
    for k in range(12):
        motions = [exp_se3(sign * step * np.eye(6)[k % 6]) for sign in (1.0, -1.0)]
        moved = [value(M @ T_a, T_b) if k < 6 else value(T_a, M @ T_b) for M in motions]
        rows.append((moved[0] - moved[1]) / (2.0 * step))
    return np.array(rows)


def gradient_along_twists(G: np.ndarray, T: np.ndarray) -> np.ndarray:
    """<G, d/dt exp(t xi) T> (6, batch) for six spatial twists xi and an entry-wise gradient G (batch, ..., 4, 4)."""
    rows = []
    for k in range(6):
        generator = np.zeros((4, 4))
        generator[:3, :3], generator[:3, 3] = hat(np.eye(6)[k, 3:]), np.eye(6)[k, :3]
        rows.append((G * (generator @ T)).sum(axis=tuple(range(1, G.ndim))))
    return np.array(rows)


def weighed(witness: Witness, cotangents: Mapping[str, np.ndarray] | None = None) -> torch.Tensor:
    """sum(cotangent * field), a loss of the fields named; None: of all of them, with random cotangents."""
    cotangents = random_cotangents(witness, FIELDS, seed=0) if cotangents is None else cotangents
    fields = {name: getattr(witness, name) for name in cotangents}
    return sum((field * torch.from_numpy(cotangents[name]).to(field)).sum() for name, field in fields.items())


def gradients(
    layer: WitnessLayer,
    T_a: np.ndarray | torch.Tensor,
    T_b: np.ndarray | torch.Tensor,
    cotangents: Mapping[str, np.ndarray] | None = None,
    **options: object,
) -> torch.Tensor:
    """Gradients (2, batch, P, 4, 4) of what `weighed` gives in the entries of both poses, by backward."""
    leaves = [torch.as_tensor(T).detach().clone().requires_grad_() for T in (T_a, T_b)]
    weighed(layer(*leaves, **options), cotangents).backward()
    return torch.stack([leaf.grad for leaf in leaves])


def layer_gradient(
    layer: WitnessLayer, T_a: np.ndarray, T_b: np.ndarray, cotangents: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Derivative (12, batch) along twists of sum(cotangent * field) over the witness fields named, by backward."""
    found = gradients(layer, T_a, T_b, cotangents).numpy()
    return np.concatenate([gradient_along_twists(G, T) for G, T in zip(found, (T_a, T_b), strict=True)])


def random_cotangents(witness: Witness, names: tuple[str, ...], seed: int) -> dict[str, np.ndarray]:
    """Normally distributed cotangents for the named fields."""
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=np.shape(getattr(witness, name))) for name in names}


def contracted(witness: Witness, cotangents: dict[str, np.ndarray]) -> np.ndarray:
    """sum(cotangent * field) (batch,) over the fields named."""
    total = 0.0
    for name, cotangent in cotangents.items():
        product = getattr(witness, name) * cotangent
        total = total + product.sum(axis=tuple(range(1, product.ndim)))
    return total


def slip_velocities(
    slip: Slip, x_a: np.ndarray, x_b: np.ndarray, twist_a: np.ndarray, twist_b: np.ndarray, coupling: str = "coupled"
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (..., 3) of both witness points under spatial twists (..., 6): transposes of `pull_back`."""
    found = []
    for axis in np.eye(6):
        forces = (np.broadcast_to(part, np.shape(x_a)) for part in (axis[:3], axis[3:]))
        wrench_a, wrench_b = pull_back(slip, x_a, x_b, *forces, coupling)
        found.append((wrench_a * twist_a).sum(axis=-1) + (wrench_b * twist_b).sum(axis=-1))
    return np.stack(found[:3], axis=-1), np.stack(found[3:], axis=-1)
