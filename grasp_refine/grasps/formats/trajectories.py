"""The frame of a trajectory that is its grasp, chosen from the motion of the hand alone."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Int

STILL_M = 2e-4
"""Largest step in metres of a hand that stands still."""
UPWARD = 0.9
"""Smallest share of a step that goes upwards while an object is lifted."""


def frames_before_lift(position: Float[np.ndarray, "N T 3"]) -> Int[np.ndarray, " N"]:
    """Last frame (N,) before the hand lifts the object: its contacts are closed, and the object is where it was.

    A lift is a run of steps that go upwards, along +z, until the end; frames at rest behind it belong to it. Without a
    lift it is the last frame, and the first frame for a hand that never does anything else.

    Args:
        position: Positions of the hand in a world at rest, z upwards, metres.
    """
    if position.shape[1] == 1:
        return np.zeros(len(position), dtype=int)
    step = np.diff(position, axis=1)
    length = np.linalg.norm(step, axis=-1)
    moves = length > STILL_M
    upward = moves & (step[..., 2] >= UPWARD * length)
    # Steps at the end that are upward or still; only if one of them is upward is there a lift.
    others = ~(upward | ~moves)
    count = step.shape[1]
    start = np.where(others.any(axis=1), count - np.argmax(others[:, ::-1], axis=1), 0)
    first = np.full(len(position), count)
    for row, (at, up) in enumerate(zip(start, upward, strict=True)):
        lifts = np.flatnonzero(up[at:])
        if len(lifts):
            first[row] = at + lifts[0]
    return first
