"""Checks of derivatives of witness points: finite, bounded, of the right sign, and scaling with the world.

The slip of points on their bodies is checked for two spheres only, where it is known: every method has to slip in the
true direction, and exact methods have to slip by the same amount. For polytopes, whose true slip is 0 or unbounded and
is smoothed on purpose by most methods, the checks hold for any slip: the derivative of the distance, points that move
with the bodies when these move together, bounds, and scale.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.witness.derivative import Derivative
from grasp_refine_apps.bench.derivatives import make_derivative
from grasp_refine_apps.bench.stability import cases
from grasp_refine_apps.bench.stability.bodies import make_pairs
from grasp_refine_apps.bench.stability.cases import Task
from grasp_refine_apps.bench.stability.judging import tolerance
from grasp_refine_apps.bench.stability.motion import Motion, Scene, forms_of, move, rigid_motion, sphere_motion
from grasp_refine_apps.bench.stability.poses import pose_samplers
from grasp_refine_apps.bench.stability.rows import Cell

TOLERANCE = 1e-9
"""Rounding of a derivative, as a share of its largest entry or of 1; the rounding of its precision is added."""

NUM_ROUNDINGS = 64.0
"""Number of roundings of the result's precision that may add up."""

STEP_TOLERANCE = 1e-5
"""Allowed error of finite differences for their step of 1e-3, as a share of the largest entry or of 1."""


def derivative_cells(task: Task) -> Iterator[Cell]:
    """Check the derivatives of a task, state by state; states that are impossible for such bodies are left out."""
    made = make_pairs(task.kind, task.diagonal, task.seed)
    every = pose_samplers(made, task)
    for state in task.states:
        able = [poser for poser in every if poser.can_be(state)]
        # Each pair has its share of the poses; pairs that could not be built have refused theirs.
        share = -(-task.differentiated // max(len(able) + len(made.refused), 1))
        counts = [min(share, task.differentiated - k * share) for k in range(len(able))]
        scenes = [
            Scene.of(poser.a, poser.b, posed, task.seed)
            for poser, count in zip(able, counts, strict=True)
            if count > 0 and (posed := poser.pose(state, count)) is not None
        ]
        for way in task.derivatives if scenes or made.refused else ():
            yield _cell(task, state, way, [judged(scene, way) for scene in scenes], share, made.refused)


def method_of(way: cases.Derivative) -> Derivative:
    """Make the derivative method of a cell."""
    return make_derivative(way.method, neighborhood=way.neighborhood or "adaptive")


@dataclass(frozen=True, eq=False)
class Faults:
    """Faults of the derivatives of N queries; masks (N,) that are false where there was no answer."""

    failed: np.ndarray
    """No witness points, by the status."""
    not_finite: np.ndarray
    """Some entry is not finite."""
    unbounded: np.ndarray
    """Some entry exceeds the bound of the method."""
    wrong_sign: np.ndarray
    """Distances do not grow along the normal, points stay behind when the bodies move together, or points of two
    separated spheres do not slip, slip the wrong way, or by another length with a method that is exact."""
    unscaled: np.ndarray
    """The derivative at the other size differs."""
    error: np.ndarray
    """Largest error of the exact properties, over its tolerance."""


def judged(scene: Scene, way: cases.Derivative, method: Derivative | None = None) -> Faults:
    """Check the derivatives in a scene.

    Args:
        scene: Bodies and poses.
        way: Method, neighbourhood and precision.
        method: Derivative method to check in place of the method of `way`.
    """
    method = method_of(way) if method is None else method
    dtype = getattr(torch, way.dtype)
    forms = forms_of(scene)
    motion = move(scene.pairs, method, scene.posed.T_a, scene.posed.T_b, scene.targets, forms, dtype)
    T_a, T_b = (T.astype(way.dtype) for T in (scene.posed.T_a, scene.posed.T_b))
    for T in (T_a, T_b):
        T[:, :3, 3] *= scene.factor
    target_a, target_b = (scene.factor * target.astype(way.dtype) for target in scene.targets)
    other = move(scene.other, method, T_a, T_b, (target_a, target_b), forms, dtype)

    w = motion.witness
    both = np.concatenate([motion.covectors, motion.distance[:, :, None]], axis=2)
    finite = np.isfinite(both).all(axis=(1, 2, 3))
    size = np.abs(np.where(finite[:, None, None, None], motion.covectors, 0.0)).max(axis=(1, 2, 3))
    # Poses and points are rounded, too: more so, the farther from the origin.
    reach = np.abs([w.point_a, w.point_b, *(T[:, :3, 3] for T in (scene.posed.T_a, scene.posed.T_b))]).max(axis=(0, 2))
    rounding = TOLERANCE + NUM_ROUNDINGS * torch.finfo(dtype).eps * (1.0 + reach / scene.diagonal)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        errors = np.stack(
            [
                np.abs(motion.distance - _distance_covectors(w)).max(axis=(1, 2)) / rounding,
                _left_behind(motion) / (rounding * (1.0 + size)),
                np.abs(motion.covectors - other.covectors).max(axis=(1, 2, 3)) / (rounding * (1.0 + size)),
                np.abs(motion.distance - other.distance).max(axis=(1, 2)) / rounding,
            ]
        )
        normal = (scene.posed.T_a[:, :3, :3] @ scene.posed.truth.normal[..., None])[..., 0]
        along = (motion.distance[:, 1, :3] * normal).sum(axis=1)
        # Directions are checked where there is one and distances are right: wrong distances are counted elsewhere.
        true, allowed = scene.posed.truth.distance, tolerance(scene.diagonal, reach, way.dtype)
        known = (np.abs(true) > 4.0 * allowed) & (np.abs(w.distance - true) <= allowed)
        backwards = known & scene.posed.truth.unique & ~(along > 0.0)
        if scene.spheres:
            slips = known & (true > 0.0)
            agreement, off = _slips(scene, motion, way.method, rounding)
            backwards |= slips & ~((agreement > 0.0) & (off <= 1.0))
            errors = np.concatenate([errors, np.where(slips, off, 0.0)[None]])
    answered = w.valid & finite
    return Faults(
        failed=~w.valid & (w.status != QueryStatus.NOT_FINITE),
        not_finite=(w.valid & ~finite) | (w.status == QueryStatus.NOT_FINITE),
        unbounded=answered & ~(size <= _bound(scene, way.method, w.distance)),
        wrong_sign=answered & (~(errors[:2] <= 1.0).all(axis=0) | backwards),
        unscaled=answered & (~(errors[2:4] <= 1.0).all(axis=0) | (w.status != other.witness.status)),
        error=np.where(answered, errors.max(axis=0), 0.0),
    )


def _distance_covectors(w: Witness) -> np.ndarray:
    """True derivative of a distance (N, body, 6): the normal, on a line through both witness points."""
    pull = np.stack([-w.normal, w.normal], axis=1)
    return np.concatenate([pull, np.zeros_like(pull)], axis=2)


def _left_behind(motion: Motion) -> np.ndarray:
    """Amount (N,) by which points and normals do not move with the bodies when these move together."""
    w = motion.witness
    f_a, f_b, f_n = np.split(motion.forms, 3, axis=1)
    a, b = motion.covectors[:, 0], motion.covectors[:, 1]
    # About the witness point of a, in diagonals.
    arm = ((w.point_b - w.point_a) / motion.diagonal)[:, None]
    force = a[..., :3] + b[..., :3] - (f_a + f_b)
    moment = a[..., 3:] + b[..., 3:] + np.cross(arm, b[..., :3] - f_b) - np.cross(w.normal[:, None], f_n)
    reach = 1.0 + np.abs(arm).max(axis=(1, 2))
    return np.maximum(np.abs(force).max(axis=(1, 2)), np.abs(moment).max(axis=(1, 2)) / reach)


def _slips(scene: Scene, motion: Motion, method: cases.Method, rounding: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compare the slip of points of two spheres with the true slip.

    Returns:
        Products (N,) of slips with the true slips, less their possible rounding: positive where points slip the right
        way. A slip is a derivative less the derivative without slip. And for exact methods the largest error (N,) over
        its tolerance, else 0: of all nine numbers for finite differences, and of both points for `Analytical`, which
        smooths the normal. Its system of both slips is as ill conditioned as the gap is small.
    """
    true, rigid = motion.forms @ sphere_motion(scene), rigid_motion(motion)
    slip = true - rigid
    agreement = ((motion.covectors - rigid - rounding[:, None, None, None] * slip) * slip).sum(axis=(1, 2, 3))
    # For each number, because the forms of spheres are nine that are orthonormal.
    error = np.abs(motion.forms.T @ (motion.covectors - true))
    size = 1.0 + np.abs(true).max(axis=(1, 2, 3))
    if method == "analytical":
        narrow = (rounding - TOLERANCE) * scene.diagonal / np.abs(motion.witness.distance)
        return agreement, error[:, :, :6].max(axis=(1, 2, 3)) / (size * (rounding + narrow))
    if method == "finite-difference":
        return agreement, error.max(axis=(1, 2, 3)) / (size * (STEP_TOLERANCE + rounding))
    return agreement, np.zeros(len(size))


def _bound(scene: Scene, method: cases.Method, distance: np.ndarray) -> np.ndarray:
    """Bound (N,) of a derivative, without unit.

    - contact-kinematics: curvatures are at most 4 / rho, and curvatures of both bodies together at least 5 over the
      mean of their diagonals; rho is the spacing of the candidates at least.
    - distance, direction: slips are at most 1 - 1e-6, so that I - A B is at least 2e-6; a normal turns with the
      difference of two points over twice the spacing at least.
    - analytical: the bound of distance with 1e-11, and slips up to a million deep in a sphere: it is exact, and true
      derivatives have no bound where normals jump.
    - zeroth-order, finite-difference: points stay on the bodies, so that they move by less than three diagonals, over
      steps of 2e-3 diagonals or more.

    Far apart, the rotation of one body moves the other one's points by their distance.
    """
    bodies = scene.pairs.a[0], scene.pairs.b[0]
    spacing = min(2.0 * np.sqrt(body.area / len(body.candidates.points)) for body in bodies) / scene.diagonal
    sharp = 1.0 + 4.0 / spacing
    bound = {
        "contact-kinematics": 4.0 * sharp**2,
        "distance": 5e6 * sharp,
        "direction": 5e6 * sharp,
        "analytical": 1e12 * sharp,
        "zeroth-order": 1e4,
        "finite-difference": 1e4,
    }[method]
    return bound * (1.0 + np.abs(distance) / scene.diagonal)


def _cell(
    task: Task, state: cases.State, way: cases.Derivative, faults: list[Faults], share: int, refused: tuple[str, ...]
) -> Cell:
    """Total the counts of all pairs of bodies in the cell."""
    names = {name: f"derivative_{name}" for name in ("not_finite", "unbounded", "wrong_sign", "unscaled")}
    counts: dict[str, Any] = {
        key: int(sum(getattr(one, name).sum() for one in faults)) for name, key in {"failed": "failed", **names}.items()
    }
    return Cell(
        kind=task.kind,
        diagonal=task.diagonal,
        state=state,
        measure="derivative",
        dtype=way.dtype,
        queries=sum(len(one.failed) for one in faults) + share * len(refused),
        method=way.method,
        neighborhood=way.neighborhood,
        refused=share * len(refused),
        **counts,
        derivative_error_max=max((float(one.error.max()) for one in faults), default=None),
        refusal="; ".join(dict.fromkeys(refused)) or None,
    )
