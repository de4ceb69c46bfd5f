"""Closing of fingers along a path of the joints, until the object, a table or another link stops them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.refinement.closing import step_until_stopped
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane

NUM_STEPS = 12
"""Steps of a joint from one end of its path to the other: no finger passes through a thin wall between two. Fingers of
hands in use stop within about 0.1 mm."""

Obstruction = Callable[[Int[np.ndarray, " R"], Float[np.ndarray, "R n"], Float[np.ndarray, "R L 4 4"]], np.ndarray]
"""Returns which links (R, L) are stopped, of grasps (R,) with these joint values and poses of the links."""


def close_until_stopped(
    prepared: HandObject,
    T_world_root: Float[np.ndarray, "N 4 4"],
    q_open: Float[np.ndarray, "N n"],
    q_end: Float[np.ndarray, "N n"],
    touch: Float[np.ndarray, "N L"] | float = 0.0,
    obstruction: Obstruction | None = None,
) -> Float[np.ndarray, "N n"]:
    """Return the shares (N, n) of their paths at which the object, or what else is in the way, stops the joints.

    All joints move from `q_open` to `q_end`, each by an even share of its path, while the base link stays. A joint
    stops when a link that it moves touches the object; joints of links beyond go on. The share is 1 where nothing
    stops a joint, and 0 where it has no path.

    Args:
        prepared: Hand and object.
        T_world_root: Poses (N, 4, 4) of the base link, object frame, metres.
        q_open: Joint values (N, n) at which the hand is open.
        q_end: Joint values (N, n) at which the paths end.
        touch: Distances (N, L), at most 0, from which on links touch: less for links that are in the object already.
        obstruction: Test for further obstacles; None: there are none.
    """
    chain, path = prepared.chain, q_end - q_open
    touch = np.broadcast_to(touch, (len(path), len(chain.links)))

    def touches(rows: np.ndarray, share: np.ndarray, step: np.ndarray) -> Bool[np.ndarray, "R n"]:
        q = q_open[rows] + share * path[rows]
        T_link = chain(T_world_root[rows], q).T_world_link
        # Links whose joints all stopped need no query.
        cutoff = np.where((chain.moves & (step > 0.0)[:, None]).any(axis=2), 0.0, np.nan)
        witness = prepared.query(np.zeros(len(rows), dtype=np.int64), T_link, cutoff=cutoff)
        touching = witness.valid & (witness.distance <= touch[rows])
        if obstruction is not None:
            touching |= obstruction(rows, q, T_link)
        return (touching[..., None] & chain.moves).any(axis=1)

    step = np.where(path != 0.0, 1.0 / NUM_STEPS, 0.0)
    return step_until_stopped(np.zeros_like(path), step, touches, (0.0, 1.0), NUM_STEPS)[0]


def table_obstruction(
    prepared: HandObject,
    table: Plane,
    T_world_root: Float[np.ndarray, "N 4 4"],
    q_open: Float[np.ndarray, "N n"],
    raised: Float[np.ndarray, " N"],
) -> Obstruction:
    """Return the obstruction by a table; links that are below it at `q_open` go no deeper.

    Args:
        prepared: Hand and object.
        table: The table.
        T_world_root: Poses (N, 4, 4) of the base link, object frame, metres.
        q_open: Joint values (N, n) at which the hand is open.
        raised: Distances (N,) in metres by which the table is raised along its normal.
    """

    def heights(rows: np.ndarray, T_link: np.ndarray) -> Float[np.ndarray, "R L"]:
        return table.heights(prepared.bodies, T_link)[0] - raised[rows, None]

    lowest = np.minimum(heights(np.arange(len(q_open)), prepared.chain(T_world_root, q_open).T_world_link), 0.0)
    return lambda rows, q, T_link: heights(rows, T_link) < lowest[rows]
