"""The quadratic programs of contact forces: compiled for a whole batch, or one after another by DAQP.

The compiled solver is an active-set method that knows the friction pyramids (see `collision/native/forces.h`); DAQP
(Arnstroem et al. 2022) serves where there is no compiled module (see `collision.engine`).
"""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.core.array_types import Bool, Float, Int

MAX_PRESSURE_SHARE = 0.5
"""Largest share of the total pressure at one contact: every push needs a counter-push."""

SHARE_WEIGHT, SHARE_TOLERANCE = 300.0, 1e-5
"""Weight of the difference of the pressures of a link from that share in programs where they have it, and tolerance of
that difference."""

NUM_EDGES = 8
"""Number of edges of the pyramids that approximate friction cones from within."""

DAQP_OPTIMAL, DAQP_EQUALITY = 1, 5
"""Daqp's codes for an optimal solution, and for a constraint that always holds with equality."""


def solve_programs(
    G: Float[np.ndarray, "N K R 3"],
    there: Bool[np.ndarray, "N K"],
    outer: Float[np.ndarray, "N P R"],
    friction: float,
    ridge: float,
    start: Float[np.ndarray, "N P K 3"] | None = None,
    link: Int[np.ndarray, "N K"] | None = None,
) -> tuple[Float[np.ndarray, "N P K 3"], Bool[np.ndarray, "N P"]]:
    """Best forces (pressure and two tangents) of N grasps under P loads each, and True where they were found.

    They minimise |outer + sum G_k f_k|^2 + ridge sum |f_k|^2 (see `wrench.contact_forces`). Forces that were not found,
    and forces where there is no contact, are 0. Grasps do not depend on each other.

    Args:
        G: Grasp maps (see `wrench.grasp_map`).
        there: Mask of the contacts.
        outer: Loads.
        friction: Coefficient of friction.
        ridge: Weight of the squared forces.
        start: Forces found for similar grasps, with the same friction: they change the way to the solution, not where
            it is. Where they are none, such as for other contacts, they are ignored.
        link: Index of the link of each contact, where contacts of one link share its largest pressure; None: each has
            its own.
    """
    local, solved = _solve(G, there, outer, friction, ridge, start)
    if link is None:
        return local, solved
    # Where a link presses more than its share, it has just that share in the best forces: the program is convex. All
    # others together have the rest then.
    n, p = np.nonzero(solved)
    most, excess = heaviest_link(local[n, p], link[n])
    others = (there[n] & ~most).any(axis=1)
    over = np.flatnonzero(others & (excess > SHARE_TOLERANCE))
    if len(over):
        n, p, most = n[over], p[over], most[over]
        row = np.zeros((len(n), G.shape[1], 1, 3))
        row[..., 0, 0] = SHARE_WEIGHT * most
        wanted = np.full((len(n), 1, 1), -SHARE_WEIGHT * MAX_PRESSURE_SHARE)
        programs = np.concatenate([G[n], row], axis=2), there[n], np.concatenate([outer[n, p, None], wanted], axis=2)
        shared, found = _solve(*programs, friction, ridge, np.ascontiguousarray(local[n, p, None]))
        local[n, p], solved[n, p] = shared[:, 0], found[:, 0]
    return local, solved


def heaviest_link(
    local: Float[np.ndarray, "*N K 3"], link: Int[np.ndarray, "*#N K"]
) -> tuple[Bool[np.ndarray, "*N K"], Float[np.ndarray, "*N"]]:
    """Return the contacts of the link that presses most, and how far its pressures are above the largest share.

    Args:
        local: Forces as of `solve_programs`.
        link: Index of the link of each contact.
    """
    pressure = local[..., 0]
    total = ((link[..., :, None] == link[..., None, :]) @ pressure[..., None])[..., 0]
    heaviest = np.take_along_axis(np.broadcast_to(link, pressure.shape), total.argmax(axis=-1)[..., None], axis=-1)
    return link == heaviest, total.max(axis=-1) - MAX_PRESSURE_SHARE


def _solve(
    G: np.ndarray, there: np.ndarray, outer: np.ndarray, friction: float, ridge: float, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Solve the programs, each contact with its own largest pressure."""
    if chosen("auto") == "native":
        from grasp_refine.collision.native_search import solve_forces

        return solve_forces(G, there, outer, start, friction, MAX_PRESSURE_SHARE, ridge)
    return _solve_by_daqp(G, there, outer, friction, ridge)


def pyramid_faces(friction: float) -> Float[np.ndarray, "8 3"]:
    """Outward normals of the faces of a friction pyramid, each between two edges.

    Their products with a force in the pyramid (pressure and two tangents, as of `solve_programs`) are at most 0.
    """
    angle = (np.arange(NUM_EDGES) + 0.5) * 2.0 * np.pi / NUM_EDGES
    rim = friction * np.cos(np.pi / NUM_EDGES)
    return np.stack([np.full(NUM_EDGES, -rim), np.cos(angle), np.sin(angle)], axis=1)


def _solve_by_daqp(
    G: np.ndarray, there: np.ndarray, outer: np.ndarray, friction: float, ridge: float
) -> tuple[np.ndarray, np.ndarray]:
    import daqp

    (N, P), K = outer.shape[:2], G.shape[1]
    local, solved = np.zeros((N, P, K, 3)), np.zeros((N, P), dtype=bool)
    for n in np.flatnonzero(there.any(axis=1)):
        place = np.flatnonzero(there[n])
        A = np.moveaxis(G[n, place], 1, 0).reshape(G.shape[2], -1)
        H, constraints = A.T @ A + ridge * np.eye(A.shape[1]), _constraints(len(place), friction)
        for p in range(P):
            x, _, flag, _ = daqp.solve(H, outer[n, p] @ A, *constraints)
            if flag == DAQP_OPTIMAL:
                local[n, p, place], solved[n, p] = x.reshape(-1, 3), True
    return local, solved


def _constraints(C: int, friction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows, upper and lower bounds and kinds of the constraints on pressures and tangential forces of C contacts.

    The first bounds are on the unknowns themselves: pressures from 0 to the cap, tangents without any. Then
    come the sum of the pressures and, for each contact, the faces of its pyramid.
    """
    rows = np.concatenate([np.tile([1.0, 0.0, 0.0], C)[None], np.kron(np.eye(C), pyramid_faces(friction))])
    none, cap = 1e30, max(MAX_PRESSURE_SHARE, 1.0 / C)  # 1e30 is infinity for daqp
    faces = np.full(C * NUM_EDGES, none)
    lower = np.concatenate([np.tile([0.0, -none, -none], C), [1.0], -faces])
    upper = np.concatenate([np.tile([cap, none, none], C), [1.0], 0.0 * faces])
    sense = np.zeros(len(lower), dtype=np.int32)
    sense[3 * C] = DAQP_EQUALITY
    return rows, upper, lower, sense
