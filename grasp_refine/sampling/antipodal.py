"""Antipodal grasps of grippers with two jaws: placement at opposite points of an object, and closing in its middle.

Two contacts with friction hold an object where the line through both lies in both friction cones (V.-D. Nguyen,
"Constructing force-closure grasps", International Journal of Robotics Research 7(3), 1988). Pairs of surface points
are drawn of which this is so, and approach directions at any angle about their line, as for Dex-Net 2.0 (J. Mahler et
al., Robotics: Science and Systems 2017) and ACRONYM (C. Eppner, A. Mousavian and D. Fox, ICRA 2021).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import matvec, tangents
from grasp_refine.objects.object import Object
from grasp_refine.sampling.jaw_frame import JawFrame
from grasp_refine.sampling.placement import Placed
from grasp_refine.scene.plane import Plane

FRICTION = 0.3
"""Friction of the cones in which the line through both points lies."""

MAX_OFFSET_SHARE = 0.6
"""Largest share of the half length and half breadth of the pads by which points are off their middle."""

MAX_CLOSINGS = 24
"""Most steps in which jaws close."""


Gaps = Callable[[Placed], Float[np.ndarray, "M L"]]
"""Distances (M, L) in metres of the links of hands from the object or the table, whichever is nearer."""


def antipodal_pairs(obj: Object, width: tuple[float, float]) -> Int[np.ndarray, "P 2"]:
    """Pairs (P, 2) of indices of surface points whose line lies in both friction cones.

    Args:
        obj: The object.
        width: Least and largest distance of two points in metres.
    """
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    apart = x[None] - x[:, None]
    length = np.linalg.norm(apart, axis=-1)
    least = length / np.sqrt(1.0 + FRICTION**2)
    inside = (-(apart * n[:, None]).sum(axis=-1) >= least) & ((apart * n).sum(axis=-1) >= least)
    return np.argwhere(inside & (length > width[0]) & (length < width[1]))


def place_jaws(
    jaws: JawFrame,
    obj: Object,
    pairs: Int[np.ndarray, "P 2"],
    count: int,
    clearance: float,
    table: Plane | None,
    rng: np.random.Generator,
) -> tuple[Placed, Float[np.ndarray, "M 3"], Float[np.ndarray, " M"]]:
    """Open hands (count) at antipodal pairs, their axes (count, 3) of closing, and their widths (count,) in metres.

    The axis is the mean of both normals, so that flat pads come to lie on flat faces; approach directions are
    uniform at right angles to it, never from below a table. Points lie anywhere in the inner part of the pads, and jaws
    are more or less open.

    Args:
        jaws: The jaw frame of the hand.
        obj: The object.
        pairs: Its `antipodal_pairs`.
        count: Number of hands.
        clearance: Least distance in metres of each pad from its point.
        table: A plane from below which no hand approaches.
        rng: Source of random numbers.
    """
    x, n = obj.body.candidates.points, obj.body.candidates.normals
    first, second = pairs[rng.integers(len(pairs), size=count)].T
    axis = n[second] - n[first]
    # The finger that moves along the axis comes from the side of the first point.
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    way = matvec(tangents(axis), np.stack([np.cos(turn), np.sin(turn)], axis=-1))
    if table is not None:
        way = np.where((way @ np.asarray(table.normal) > 0.0)[:, None], -way, way)
    least = np.minimum(((x[second] - x[first]) * axis).sum(axis=1) + 2.0 * clearance, jaws.width[0])
    width = least + rng.uniform(0.0, 1.0, count) * (jaws.width[0] - least)
    off = rng.uniform(-MAX_OFFSET_SHARE, MAX_OFFSET_SHARE, (count, 2)) * [jaws.half_length, jaws.half_breadth]
    middle = 0.5 * (x[first] + x[second]) + off[:, :1] * way + off[:, 1:] * np.cross(way, axis)
    q, center = jaws.at(width)
    return Placed(jaws.poses(middle, axis, way, center), q, way), axis, width


def close_jaws(
    jaws: JawFrame,
    hands: Placed,
    axis: Float[np.ndarray, "M 3"],
    width: Float[np.ndarray, " M"],
    gaps: Gaps,
    fingers: tuple[Bool[np.ndarray, " L"], Bool[np.ndarray, " L"]],
    stop: float,
) -> Placed:
    """The hands with their jaws closed, moved along the axis so that both touch: the object stays where it is.

    A hand that closes on an object moves along its axis until both fingers touch, as an arm that gives way does.
    Each step moves each finger by no more than its distance, so that none of them goes into anything.

    Args:
        jaws: The jaw frame of the hands.
        hands: Open hands (M).
        axis: Axes of closing (M, 3), object frame.
        width: Widths (M,) of the jaws in metres.
        gaps: Distances of the links of hands from everything, at any distance.
        fingers: Masks (L,) of the links of the first and of the second finger.
        stop: Distance in metres at which a finger stops.
    """
    middle = hands.T[:, :3, 3] + matvec(hands.T[:, :3, :3], jaws.at(width)[1])
    T, q, width = hands.T.copy(), hands.q.copy(), width.copy()
    others = ~(fingers[0] | fingers[1])
    busy = np.arange(len(T))
    for _ in range(MAX_CLOSINGS):
        if not len(busy):
            break
        gap = gaps(Placed(T[busy], q[busy], hands.way[busy]))
        near = [gap[:, mask].min(axis=1, initial=np.inf) for mask in (*fingers, others)]
        step = [np.where(each > stop, np.maximum(each - 0.5 * stop, 0.0), 0.0) for each in near]
        shift = 0.5 * (step[0] - step[1])
        # What is no finger moves with the shift, and so do fingers that have stopped.
        share = np.minimum(1.0, step[2] / np.maximum(np.abs(shift), 1e-12))
        step = [share * each for each in step[:2]]
        closed = np.minimum(step[0] + step[1], width[busy] - jaws.width[-1])
        width[busy] -= closed
        middle[busy] += (share * shift)[:, None] * axis[busy]
        q[busy], center = jaws.at(width[busy])
        T[busy] = jaws.poses(middle[busy], axis[busy], hands.way[busy], center)
        busy = busy[closed > 0.1 * stop]
    return Placed(T, q, hands.way)
