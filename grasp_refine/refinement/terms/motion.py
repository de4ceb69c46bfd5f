"""Derivatives of witness points and distances in the twists of links.

Derivatives are *covectors*: rows g with dr = g . (v, w), (v, w) the spatial twist of a link at the world's origin,
while the object rests. Distances have exact derivatives; how witness points slide is contact kinematics.
"""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace, cross, tangents, transform_points
from grasp_refine.refinement.terms.term import Setup, State
from grasp_refine.scene.goal import Goal


def distance_covectors(witness: Witness) -> Array:
    """Return covectors (..., 6) of the signed distance: -(n, x_b x n) on the twist of body a, exact."""
    xp = array_namespace(witness.normal)
    return -xp.concat([witness.normal, cross(witness.point_b, witness.normal)], axis=-1)


def without_nan(array: Array) -> Array:
    """Return an array with 0 for NaN."""
    xp = array_namespace(array)
    return xp.where(xp.isnan(array), xp.zeros_like(array), array)


def target_misses(state: State, goal: Goal, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors (M, C, 3) from the targets of the links `columns` (C,) to the witness points, world frame.

    On the links and on the object, in metres; NaN without a target.
    """
    w, member = state.witness.pairs(columns), state.member
    on_link = transform_points(state.T_link[:, columns], goal.target_link[member][:, columns])
    return w.point_a - on_link, w.point_b - goal.target_object[member][:, columns]


def contact_curvatures(
    setup: Setup,
    state: State,
    columns: np.ndarray,
    needed: np.ndarray,
    radius: np.ndarray,
    width: np.ndarray,
) -> tuple[Witness, np.ndarray, np.ndarray, np.ndarray]:
    """Return witness points of the links `columns` (C,), tangents (M, C, 3, 2), and curvatures of links and object.

    Curvatures (M, C, 2, 2) are in the basis of the tangents, in 1/m, fitted where `needed` (M, C). Elsewhere, and
    without witness points, they are for spheres of 1 m and mean nothing.

    Args:
        setup: Givens of the refinement.
        state: State.
        columns: Links.
        needed: Mask (M, C).
        radius: Half of the radii (2, M, C) in metres of the neighbourhoods on links and object.
        width: Factors (M,) of these radii.
    """
    w = state.witness.pairs(columns)
    # Any tangents where there are no witness points.
    E = tangents(np.where(w.valid[..., None], w.normal, [0.0, 0.0, 1.0]))
    shape = w.distance.shape
    item = np.flatnonzero((needed & w.valid).reshape(-1))
    K = setup.prepared.curvatures.fit(
        setup.prepared.pair(setup.scene.number[state.member], columns).reshape(-1)[item],
        state.T_link[:, columns].reshape(-1, 4, 4)[item],
        np.broadcast_to(np.eye(4), (len(item), 4, 4)),
        w.reshape(-1).rows(item),
        E.reshape(-1, 3, 2)[item],
        np.nan_to_num(radius.reshape(2, -1)[:, item]),
        np.repeat(width, shape[1])[item],
    )
    every = np.broadcast_to(np.eye(2), (2, shape[0] * shape[1], 2, 2)).copy()
    every[0, item], every[1, item] = K
    return w, E, every[0].reshape(*shape, 2, 2), every[1].reshape(*shape, 2, 2)
