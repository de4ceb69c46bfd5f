"""Motion of witness points through the layer, as a user computes it, in any size and precision.

The differentiated quantities are linear forms of the output of the layer,

    L = (f_a . x_a + f_b . x_b) / D + f_n . n,     |f_a|^2 + |f_b|^2 + |f_n|^2 = 1,     and     d / D,

in the twists of both bodies about their own witness points, (D dL/dv, dL/dw), D the diagonal of the larger body. So
all numbers are without unit, and a world that is `factor` times as large must give the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.se3 import cross, hat
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.derivative import Derivative
from grasp_refine_apps.bench.stability.poses import PosedBodies

NUM_FORMS = 3
"""Linear forms of points and normal that are differentiated; of two spheres all nine, whose derivatives are known."""

SCENE_SIZE_M = 0.1
"""Size in metres at which derivatives are compared, up to a factor of 3."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Two bodies in N poses, targets of their points, and the scaled scene."""

    pairs: Pairs
    """The bodies."""
    posed: PosedBodies
    """Their poses, and the truth about them."""
    targets: tuple[np.ndarray, np.ndarray]
    """Targets (N, 3) on both bodies, metres, body frames; NaN in half of the poses, which have none."""
    other: Pairs
    """The bodies, `factor` times as large."""
    factor: float
    """A power of 8, so that scaling is exact; never 1."""

    @staticmethod
    def of(a: Body, b: Body, posed: PosedBodies, seed: int) -> Scene:
        """Make the scene of two bodies, with random targets."""
        rng = np.random.default_rng(seed)
        N = len(posed.T_a)
        targets = [body.candidates.points[rng.integers(len(body.candidates.points), size=N)] for body in (a, b)]
        targets = [np.where(np.arange(N)[:, None] % 2 == 0, np.nan, target) for target in targets]
        factor = 8.0 ** (round(np.log(SCENE_SIZE_M / max(a.diagonal, b.diagonal)) / np.log(8.0)) or 1)
        other = Pairs((_scaled(a, factor, seed),), (_scaled(b, factor, seed),))
        return Scene(Pairs((a,), (b,)), posed, (targets[0], targets[1]), other, factor)

    @property
    def diagonal(self) -> float:
        """Diagonal in metres of the larger body."""
        return _diagonal(self.pairs)

    @property
    def spheres(self) -> bool:
        """True if both bodies are spheres, whose derivatives are known in closed form."""
        return all(len(body.pieces[0].vertices) == 1 for body in (*self.pairs.a, *self.pairs.b))


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the answers to N queries, without unit (see above)."""

    witness: Witness
    """The answers (N,)."""
    diagonal: float
    """D in metres."""
    forms: np.ndarray
    """Differentiated forms (K, 9): f_a, f_b and f_n."""
    covectors: np.ndarray
    """Derivatives (N, body, K, 6) in the twists (v, w) of the bodies."""
    distance: np.ndarray
    """Derivatives of the distance (N, body, 6) in the twists (v, w) of the bodies."""


def forms_of(scene: Scene) -> np.ndarray:
    """Return orthonormal forms (K, 9), equal at all poses."""
    drawn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(9, 9)))
    return drawn if scene.spheres else drawn[:NUM_FORMS]


def move(
    pairs: Pairs,
    method: Derivative,
    T_a: np.ndarray,
    T_b: np.ndarray,
    targets: tuple[np.ndarray, np.ndarray],
    forms: np.ndarray,
    dtype: torch.dtype,
) -> Motion:
    """Differentiate witness points.

    Args:
        pairs: One pair of bodies.
        method: The derivative method.
        T_a: Poses (N, 4, 4) of the first body.
        T_b: Poses (N, 4, 4) of the second body.
        targets: Targets (N, 3) of the points on each body, in its frame; NaN: none.
        forms: Forms (K, 9) to differentiate.
        dtype: Precision of poses and gradients.
    """
    N, K = len(T_a), len(forms)
    diagonal = _diagonal(pairs)

    def repeated(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.tile(array, (K + 1, *[1] * (array.ndim - 1)))[:, None]).to(dtype)

    poses = [repeated(T).requires_grad_() for T in (T_a, T_b)]
    found = WitnessLayer(pairs, method)(*poses, *map(repeated, targets))
    points = torch.cat([found.point_a / diagonal, found.point_b / diagonal, found.normal], dim=-1)
    of_forms = points.reshape(K + 1, N, 9)[:K] * torch.from_numpy(forms[:, None]).to(dtype)
    (of_forms.sum() + found.distance.reshape(K + 1, N)[K].sum() / diagonal).backward()
    w = found.detached().reshape(-1)
    covectors = []
    for pose, point in zip(poses, (w.point_a, w.point_b), strict=True):
        assert pose.grad is not None
        G, T = (tensor.detach()[:, 0].double().numpy() for tensor in (pose.grad, pose))
        covectors.append(_covector(G, T, point) * ([diagonal] * 3 + [1.0] * 3))
    both = np.stack(covectors, axis=1).reshape(K + 1, N, 2, 6)
    return Motion(w.rows(slice(0, N)), diagonal, forms, both[:K].transpose(1, 2, 0, 3), both[K])


def _covector(G: np.ndarray, T: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """Convert an entry-wise gradient G (M, 4, 4) to the derivative (M, 6) in the twist about a point (M, 3)."""
    force = G[:, :3, 3]
    turn = G[:, :3, :3] @ T[:, :3, :3].mT
    moment = np.stack([turn[:, j, k] - turn[:, k, j] for j, k in ((2, 1), (0, 2), (1, 0))], axis=1)
    return np.concatenate([force, moment + cross(T[:, :3, 3] - pivot, force)], axis=1)


def rigid_motion(motion: Motion) -> np.ndarray:
    """Return `Motion.covectors` (N, body, K, 6) without any slip: points are fixed to their bodies.

    The normal turns by the mean of the rotations of the bodies.
    """
    f_a, f_b, f_n = np.split(motion.forms, 3, axis=1)
    turn = 0.5 * np.cross(motion.witness.normal[:, None], f_n)
    sides = [np.concatenate([np.broadcast_to(force, turn.shape), turn], axis=2) for force in (f_a, f_b)]
    return np.stack(sides, axis=1)


def sphere_motion(scene: Scene) -> np.ndarray:
    """Return derivatives (N, body, 9, 6) of x_a / D, x_b / D and n of two spheres, in units of `Motion.covectors`.

    With n = (c_b - c_a) / r, x_a = c_a + r_a n and x_b = c_b - r_b n: dn = (I - n n^T) (dc_b - dc_a) / r.
    """
    (a,), (b,) = (body.pieces for body in (scene.pairs.a[0], scene.pairs.b[0]))
    poses = scene.posed.T_a, scene.posed.T_b
    c_a, c_b = (T[:, :3, :3] @ piece.vertices[0] + T[:, :3, 3] for T, piece in zip(poses, (a, b), strict=True))
    r = np.linalg.norm(c_b - c_a, axis=1)[:, None, None]
    n = (c_b - c_a) / r[..., 0]
    eye = np.tile(np.eye(3), (len(n), 1, 1))
    across = (eye - n[:, :, None] * n[:, None, :]) / r
    result = []
    for side, arm in ((0, -a.radius * n), (1, b.radius * n)):
        dc = np.concatenate([eye, -hat(arm) / scene.diagonal], axis=2)
        dn = (1.0 if side else -1.0) * across @ dc
        moved = [(dc if side == 0 else 0.0) + a.radius * dn, (dc if side == 1 else 0.0) - b.radius * dn]
        result.append(np.concatenate([*moved, scene.diagonal * dn], axis=1))
    return np.stack(result, axis=1)


def _scaled(body: Body, factor: float, seed: int) -> Body:
    """Scale the body by `factor`."""
    return build_body(body.name, [piece.scaled(factor) for piece in body.pieces], seed=seed)


def _diagonal(pairs: Pairs) -> float:
    return max(pairs.a[0].diagonal, pairs.b[0].diagonal)
