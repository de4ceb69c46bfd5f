"""Contact forces: how well pushes at the contacts of a grasp can balance each other.

Links push the object along the contact normals and, within the friction, across them. Of all ways to share a
total pressure of 1, a small quadratic program per grasp finds the one whose forces and torques cancel best.
What is left is the wrench residual: 0 where the hand can squeeze the object without moving it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import hat
from grasp_refine.forces.programs import solve_programs

PLANNING_FRICTION = 0.15
"""Friction that forces are planned with for the protocol `dexgraspbench`: a quarter of its friction, so that they hold
with a margin; for other tasks, as large a share of theirs."""

LEVER_M = 0.05
"""Lever in metres: a torque counts like the force that makes it there."""

POLE_ROTATION = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""Rotation (3, 3) that takes the only normal at which `basis_tangents` turn abruptly to -z, in the axes of a grasp; no
common normal, such as an axis, is near it."""

WORLD_AXES = np.eye(3)
"""Axes of grasps where nothing else says how friction pyramids are oriented about the normals."""

MIN_POLE_OFFSET = 1e-9
"""Smallest 1 + z for which that rotation is computed."""

RIDGE = 1.25e-6
"""Weight of the squared forces: decides between forces that balance equally well, and changes little otherwise."""


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Best contact forces of N grasps, per unit of total pressure."""

    residual: Float[np.ndarray, "*N"]
    """Norm (N,) of [F, tau / `LEVER_M`] of all contacts together, without unit; NaN where `solved` is not."""
    unbalanced: Float[np.ndarray, "*N R"]
    """[F, tau / `LEVER_M`] itself, with the load if there is one, then the values of the extra forms (N, 6 + E)."""
    force: Float[np.ndarray, "*N K 3"]
    """Force (N, K, 3) of each link on the object, in the frame of the contacts; 0 without a contact, or unsolved."""
    pressure: Float[np.ndarray, "*N K"]
    """Its part along the normal (N, K), at least 0; the pressures of a grasp sum to 1."""
    local: Float[np.ndarray, "*N K 3"]
    """Force (N, K, 3) along the normal and the two `basis_tangents` at it."""
    solved: Bool[np.ndarray, "*N"]
    """Mask (N,) of grasps that have forces: a contact, and no failure of the solver."""
    squares: Float[np.ndarray, "*N"]
    """Sum (N,) of the squares of `local`."""


@stage("forces")
def contact_forces(
    loads: Float[np.ndarray, "N P 6"] | Float[np.ndarray, "P 6"],
    point: Float[np.ndarray, "N K 3"],
    normal: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, "*#N 3"],
    *,
    friction: float = PLANNING_FRICTION,
    ridge: float = RIDGE,
    forms: Float[np.ndarray, "N E K 3"] | None = None,
    axes: Float[np.ndarray, "*N 3 3"] = WORLD_AXES,
    start: Float[np.ndarray, "N P K 3"] | None = None,
    link: Int[np.ndarray, "N K"] | None = None,
) -> ContactForces:
    """The forces f_k that minimise |[F, tau / LEVER_M]|^2 + ridge sum |f_k|^2, where F = sum f_k, tau = sum r_k x f_k.

    They do so under each of P outer loads, which are added to F and tau; all fields of the result are (N, P, ...).
    The pressures n_k . f_k sum to 1 and none is above `MAX_PRESSURE_SHARE`, or, of a single contact, 1. Friction is at
    most that of a pyramid of `NUM_EDGES` edges within the cone (see `programs`), aligned with `basis_tangents` about
    the normal. Where the axes rotate with everything else, the forces do too; where only they rotate, the
    result changes as little as a friction between that and cos(pi / NUM_EDGES) times it would change it.

    Args:
        loads: Outer loads on the object, [F, tau / `LEVER_M`] per unit of total pressure, the same for all grasps or
            not, in the frame of the contacts (see `turn_loads`).
        point: Contact points (N, K, 3) in metres; a contact with any NaN, in point or normal, is ignored.
        normal: Unit normals (N, K, 3) from link to object, into the object.
        center: The point that torques are about, the object's centre of mass: (3,), or (N, 3) of several objects.
        friction: Coefficient of friction.
        ridge: Weight of the squared forces, above 0: it makes the solution unique. Its cost is in the residual,
            about as large as the weight itself.
        forms: Other linear forms of the forces, sum a_ek . f_k, whose squares are minimised with the rest.
        axes: Rotations (N, 3, 3) of the frames to which pyramids are aligned, such as the hand's, or one for all.
        start: `local` forces to start from (see `programs.solve_programs`).
        link: Index of the link of each contact, where contacts of one link together press at most as one does.
    """
    N, K = point.shape[:2]
    there = np.isfinite(point).all(axis=-1) & np.isfinite(normal).all(axis=-1)
    G, basis = grasp_map(point, normal, center, forms, axes)
    outer = np.zeros((N, loads.shape[-2], G.shape[2]))
    outer[..., :6] = loads
    local, solved = solve_programs(G, there, outer, friction, ridge, start, link)
    force = sum(local[..., [axis]] * basis[:, None, ..., axis] for axis in range(3))
    flat = np.moveaxis(G, 2, 3).reshape(N, 3 * K, G.shape[2])
    unbalanced = outer + local.reshape(N, outer.shape[1], 3 * K) @ flat
    residual = np.where(solved, np.linalg.norm(unbalanced[..., :6], axis=-1), np.nan)
    squares = (local**2).sum(axis=(-2, -1))
    return ContactForces(residual, unbalanced, force, np.maximum(local[..., 0], 0.0), local, solved, squares)


def grasp_map(
    point: Float[np.ndarray, "N K 3"],
    normal: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, "*#N 3"],
    forms: Float[np.ndarray, "N E K 3"] | None = None,
    axes: Float[np.ndarray, "*N 3 3"] = WORLD_AXES,
) -> tuple[Float[np.ndarray, "N K R 3"], Float[np.ndarray, "N K 3 3"]]:
    """Grasp map G (N, K, 6 + E, 3) of local forces, and their directions (N, K, 3, 3) as columns.

    Args:
        point: As for `contact_forces`; ignored contacts have a G of 0.
        normal: As for `contact_forces`.
        center: As for `contact_forces`.
        forms: As for `contact_forces`.
        axes: As for `contact_forces`.
    """
    there = np.isfinite(point).all(axis=-1) & np.isfinite(normal).all(axis=-1)
    n = np.where(there[..., None], normal, [0.0, 0.0, 1.0])
    r = np.where(there[..., None], point - center[..., None, :], 0.0)
    basis = np.concatenate([n[..., None], basis_tangents(n, axes)], axis=-1)
    parts = [basis, hat(r) @ basis / LEVER_M]
    if forms is not None:
        parts.append(np.moveaxis(forms, 1, 2) @ basis)
    return np.concatenate(parts, axis=-2) * there[..., None, None], basis


def basis_tangents(
    normal: Float[np.ndarray, "*N K 3"], axes: Float[np.ndarray, "*#N 3 3"] = WORLD_AXES
) -> Float[np.ndarray, "*N K 3 2"]:
    """Two unit tangents as columns of each unit normal that turn with it smoothly, except at one direction.

    The tangents of `se3.tangents` jump where a normal crosses a coordinate plane, where normals of upright objects lie.

    Args:
        normal: Unit normals.
        axes: Rotations of frames; rotating them with the normals rotates the tangents.
    """
    # In the frame of the pole, with w = n + e_z, they are the first two columns of I - w w^T / (1 + n_z).
    pole = POLE_ROTATION @ axes.mT
    n = normal @ pole.mT
    w = (normal + pole[..., None, 2, :]) / np.maximum(1.0 + n[..., 2:], MIN_POLE_OFFSET)
    return pole[..., None, :2, :].mT - w[..., None] * n[..., None, :2]


def basis_spin(
    normal: Float[np.ndarray, "*N K 3"],
    change: Float[np.ndarray, "*N K 3 D"],
    axes: Float[np.ndarray, "*#N 3 3"] = WORLD_AXES,
) -> Float[np.ndarray, "*N K D"]:
    """Rotation of the `basis_tangents` about the normal, in radians, where the normals change by `change`."""
    pole = POLE_ROTATION @ axes.mT
    x, y, z = np.moveaxis(normal @ pole.mT, -1, 0)
    turned = pole[..., None, :, :] @ change
    return (y[..., None] * turned[..., 0, :] - x[..., None] * turned[..., 1, :]) / np.maximum(1.0 + z, MIN_POLE_OFFSET)[
        ..., None
    ]


def turn_loads(loads: Float[np.ndarray, "P 6"], axes: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N P 6"]:
    """Loads (N, P, 6) in the frame of the contacts, from loads in the axes of each grasp."""
    return np.concatenate([part @ axes.mT for part in np.split(loads, 2, axis=-1)], axis=-1)
