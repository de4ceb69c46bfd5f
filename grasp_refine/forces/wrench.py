"""Contact forces: how well pushes at the contacts of a grasp can balance each other.

Links push the object along the contact normals and, within the friction, across them. Of all ways to share a
total pressure of 1, a small quadratic program per grasp finds the one whose forces and torques cancel best.
What is left is the wrench residual: 0 where the hand can squeeze the object without moving it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import daqp
import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import hat
from grasp_refine.hands.inertia import Inertia

if TYPE_CHECKING:
    from grasp_refine.objects.object import Object

PLANNING_FRICTION = 0.15
"""Friction that forces are planned with: less than any expected friction, so that they hold with a margin."""

LEVER_M = 0.05
"""Lever in metres: a torque counts like the force that makes it there."""

MAX_PRESSURE_SHARE = 0.5
"""Largest share of the total pressure at one contact: every push needs a counter-push."""

NUM_EDGES = 8
"""Number of edges of the pyramids that approximate friction cones from within."""

DAQP_OPTIMAL, DAQP_EQUALITY = 1, 5
"""Daqp's codes for an optimal solution, and for a constraint that always holds with equality."""

POLE_ROTATION = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""Rotation (3, 3) that takes the only normal at which `basis_tangents` turn abruptly to -z; no common normal, such as
an axis, is near it."""

MIN_POLE_OFFSET = 1e-9
"""Smallest 1 + z for which that rotation is computed."""

RIDGE = 1.25e-6
"""Weight of the squared forces: decides between forces that balance equally well, and changes little otherwise."""


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Best contact forces of N grasps, per unit of total pressure."""

    residual: Float[np.ndarray, " N"]
    """Norm (N,) of [F, tau / `LEVER_M`] of all contacts together, without unit; NaN where `solved` is not."""
    unbalanced: Float[np.ndarray, "N R"]
    """[F, tau / `LEVER_M`] itself, with the load if there is one, then the values of the extra forms (N, 6 + E)."""
    force: Float[np.ndarray, "N K 3"]
    """Force (N, K, 3) of each link on the object, in the frame of the contacts; 0 without a contact, or unsolved."""
    pressure: Float[np.ndarray, "N K"]
    """Its part along the normal (N, K), at least 0; the pressures of a grasp sum to 1."""
    local: Float[np.ndarray, "N K 3"]
    """Force (N, K, 3) along the normal and the two `basis_tangents` at it."""
    solved: Bool[np.ndarray, " N"]
    """Mask (N,) of grasps that have forces: those with a contact, unless the solver failed."""


def contact_forces(
    point: Float[np.ndarray, "N K 3"],
    normal: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, " 3"],
    *,
    friction: float = PLANNING_FRICTION,
    ridge: float = RIDGE,
    load: Float[np.ndarray, "N 6"] | Float[np.ndarray, " 6"] | None = None,
    forms: Float[np.ndarray, "N E K 3"] | None = None,
) -> ContactForces:
    """The forces f_k that minimise |[F, tau / LEVER_M]|^2 + ridge sum |f_k|^2, where F = sum f_k, tau = sum r_k x f_k.

    The pressures n_k . f_k sum to 1 and none is above `MAX_PRESSURE_SHARE`, or, of a single contact, 1. Friction is at
    most that of a pyramid of `NUM_EDGES` edges within the cone; its orientation about the normal is that of
    `basis_tangents`, so that rotating everything changes the result as little as a friction between that and
    cos(pi / NUM_EDGES) times it would.

    Args:
        point: Contact points (N, K, 3) in metres; a contact with any NaN, in point or normal, is ignored.
        normal: Unit normals (N, K, 3) from link to object, into the object.
        center: The point (3,) that torques are about, the object's centre of mass.
        friction: Coefficient of friction.
        ridge: Weight of the squared forces, above 0: it makes the solution unique. Its cost is in the residual,
            about as large as the weight itself.
        load: Outer load on the object, [F, tau / `LEVER_M`] per unit of total pressure; None: none.
        forms: Other linear forms of the forces, sum a_ek . f_k, whose squares are minimised with the rest.
    """
    loads = [np.zeros(6) if load is None else load]
    return contact_forces_under(loads, point, normal, center, friction=friction, ridge=ridge, forms=forms)[0]


@stage("forces")
def contact_forces_under(
    loads: Sequence[np.ndarray] | Float[np.ndarray, "P 6"],
    point: Float[np.ndarray, "N K 3"],
    normal: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, " 3"],
    *,
    friction: float = PLANNING_FRICTION,
    ridge: float = RIDGE,
    forms: Float[np.ndarray, "N E K 3"] | None = None,
) -> list[ContactForces]:
    """`contact_forces` under each of several loads, which costs less than one after another.

    Args:
        loads: Loads (6,) or (N, 6).
        point: As for `contact_forces`.
        normal: As for `contact_forces`.
        center: As for `contact_forces`.
        friction: As for `contact_forces`.
        ridge: As for `contact_forces`.
        forms: As for `contact_forces`.
    """
    N, K = point.shape[:2]
    there = np.isfinite(point).all(axis=-1) & np.isfinite(normal).all(axis=-1)
    G, basis = grasp_map(point, normal, center, forms)
    outer = np.zeros((len(loads), N, G.shape[2]))
    for number, load in enumerate(loads):
        outer[number, :, :6] = load
    local, solved = np.zeros((len(loads), N, K, 3)), np.zeros((len(loads), N), dtype=bool)
    for count in np.unique(there.sum(axis=1)):
        # Grasps with equally many contacts share the constraints.
        rows = np.flatnonzero(there.sum(axis=1) == count)
        if count and len(rows):
            place = np.argsort(~there[rows], axis=1, kind="stable")[:, :count]
            found, done = _solve_programs(G[rows[:, None], place], outer[:, rows], friction, ridge)
            local[:, rows[:, None], place], solved[:, rows] = found, done
    force = (basis @ local[..., None])[..., 0]
    unbalanced = outer + (G @ local[..., None])[..., 0].sum(axis=2)
    residual = np.where(solved, np.linalg.norm(unbalanced[..., :6], axis=-1), np.nan)
    pressure = np.maximum(local[..., 0], 0.0)
    return [ContactForces(*parts) for parts in zip(residual, unbalanced, force, pressure, local, solved, strict=True)]


def grasp_map(
    point: Float[np.ndarray, "N K 3"],
    normal: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, " 3"],
    forms: Float[np.ndarray, "N E K 3"] | None = None,
) -> tuple[Float[np.ndarray, "N K R 3"], Float[np.ndarray, "N K 3 3"]]:
    """Grasp map G (N, K, 6 + E, 3) of local forces, and their directions (N, K, 3, 3) as columns.

    Args:
        point: As for `contact_forces`; ignored contacts have a G of 0.
        normal: As for `contact_forces`.
        center: As for `contact_forces`.
        forms: As for `contact_forces`.
    """
    there = np.isfinite(point).all(axis=-1) & np.isfinite(normal).all(axis=-1)
    n = np.where(there[..., None], normal, [0.0, 0.0, 1.0])
    r = np.where(there[..., None], point - center, 0.0)
    basis = np.concatenate([n[..., None], basis_tangents(n)], axis=-1)
    parts = [basis, hat(r) @ basis / LEVER_M]
    if forms is not None:
        parts.append(np.moveaxis(forms, 1, 2) @ basis)
    return np.concatenate(parts, axis=-2) * there[..., None, None], basis


def basis_tangents(normal: Float[np.ndarray, "*K 3"]) -> Float[np.ndarray, "*K 3 2"]:
    """Two unit tangents as columns of each unit normal that turn with it smoothly, except at one direction.

    Those of `se3.tangents` jump where a normal crosses a coordinate plane, where normals of upright objects lie.
    """
    x, y, z = np.moveaxis(normal @ POLE_ROTATION.T, -1, 0)
    a = -1.0 / np.maximum(1.0 + z, MIN_POLE_OFFSET)
    first = np.stack([1.0 + x * x * a, x * y * a, -x], axis=-1)
    second = np.stack([x * y * a, 1.0 + y * y * a, -y], axis=-1)
    return np.stack([first @ POLE_ROTATION, second @ POLE_ROTATION], axis=-1)


def basis_spin(normal: Float[np.ndarray, "*K 3"], change: Float[np.ndarray, "*K 3 D"]) -> Float[np.ndarray, "*K D"]:
    """Rotation of the `basis_tangents` about the normal, in radians, where the normals change by `change`."""
    x, y, z = np.moveaxis(normal @ POLE_ROTATION.T, -1, 0)
    turned = POLE_ROTATION @ change
    return (y[..., None] * turned[..., 0, :] - x[..., None] * turned[..., 1, :]) / np.maximum(1.0 + z, MIN_POLE_OFFSET)[
        ..., None
    ]


def center_of_mass(obj: Object) -> Float[np.ndarray, " 3"]:
    """Centre of mass (3,) of an object of uniform density in its own frame, metres.

    It is that of the mesh, where this is closed: the pieces overlap a little and fill small hollows. An open surface,
    which may come with given pieces, has none: there it is that of the pieces, each with its own volume.
    """
    if obj.mesh.is_volume:
        return np.asarray(obj.mesh.center_mass, dtype=np.float64)
    return Inertia.of(obj.body.pieces).centre


def _solve_programs(
    G: Float[np.ndarray, "M C R 3"], outer: Float[np.ndarray, "P M R"], friction: float, ridge: float
) -> tuple[Float[np.ndarray, "P M C 3"], Bool[np.ndarray, "P M"]]:
    """Forces (pressure and two tangents) of C contacts each, and True where they were found, one program per load."""
    (P, M), C = outer.shape[:2], G.shape[1]
    G = np.ascontiguousarray(np.moveaxis(G, 1, 2)).reshape(M, -1, 3 * C)
    H = G.mT @ G + ridge * np.eye(3 * C)
    rows, lower, upper, sense = _constraints(C, friction)
    g = (outer[:, :, None] @ G)[:, :, 0]
    local, solved = np.zeros((P, M, 3 * C)), np.zeros((P, M), dtype=bool)
    for p, m in np.ndindex(P, M):
        x, _, flag, _ = daqp.solve(H[m], g[p, m], rows, upper, lower, sense)
        if flag == DAQP_OPTIMAL:
            local[p, m], solved[p, m] = x, True
    return local.reshape(P, M, C, 3), solved


def _constraints(C: int, friction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows, bounds and kinds of the constraints on C pressures and tangential forces, as daqp takes them.

    The first bounds are those of the unknowns themselves: pressures from 0 to the cap, tangents without any. Then
    come the sum of the pressures and, for each contact, the faces of its pyramid, which lie between two edges.
    """
    angle = (np.arange(NUM_EDGES) + 0.5) * 2.0 * np.pi / NUM_EDGES
    face = np.stack([np.full(NUM_EDGES, -friction * np.cos(np.pi / NUM_EDGES)), np.cos(angle), np.sin(angle)], axis=1)
    rows = np.concatenate([np.tile([1.0, 0.0, 0.0], C)[None], np.kron(np.eye(C), face)])
    none, cap = 1e30, max(MAX_PRESSURE_SHARE, 1.0 / C)  # 1e30 is infinity for daqp
    faces = np.full(C * NUM_EDGES, none)
    lower = np.concatenate([np.tile([0.0, -none, -none], C), [1.0], -faces])
    upper = np.concatenate([np.tile([cap, none, none], C), [1.0], 0.0 * faces])
    sense = np.zeros(len(lower), dtype=np.int32)
    sense[3 * C] = DAQP_EQUALITY
    return rows, lower, upper, sense
