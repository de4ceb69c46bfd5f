"""Poses of the links of a tree of joints, for files that are read before there is a hand: `Chain` is that of hands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.files.tree import Joint


def tree_poses(
    base_link: str, joints: Sequence[Joint], values: Mapping[str, Float[np.ndarray, " K"]]
) -> dict[str, Float[np.ndarray, "K 4 4"]]:
    """Return link -> its poses (K, 4, 4) in the frame of the base link.

    Args:
        base_link: Link that the first joints hang from.
        joints: All joints, parents before children.
        values: Values (K,) of each movable joint, in rad or m.
    """
    count = len(next(iter(values.values())))
    T = {base_link: np.tile(np.eye(4), (count, 1, 1))}
    for joint in joints:
        T[joint.child] = T[joint.parent] @ joint.T_parent_child
        if joint.movable:
            T[joint.child] = T[joint.child] @ joint.motion(values[joint.name])
    return T
