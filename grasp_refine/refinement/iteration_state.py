"""What can be seen of a refinement while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from grasp_refine.refinement.goal import Goal
from grasp_refine.refinement.solvers import least_squares
from grasp_refine.refinement.solvers.least_squares import Point


@dataclass(frozen=True, eq=False)
class IterationState:
    """Where the hands of M grasps are after an iteration."""

    row: np.ndarray
    """Rows (M,) of the grasps in their scene; a grasp that is tried from several starts at once comes as often."""
    point: Point
    """Poses of the base link (M, 4, 4) and joint values (M, n)."""
    loss: np.ndarray
    """Losses (M,) in m^2, those of the present stage."""
    touching: np.ndarray
    """Links (M, L) that should touch in the present stage."""
    stage: str
    """What is being done, for people."""


IterationCallback = Callable[[IterationState], None]
"""Sees a refinement; what it raises ends it."""


def with_callback(
    on_iteration: IterationCallback | None, goal: Goal, stage: str, rows: np.ndarray | None = None
) -> least_squares.IterationCallback | None:
    """What shows a solver's members to `on_iteration`.

    Args:
        on_iteration: Whom; None: nobody.
        goal: What is wanted of the members.
        stage: What is being done.
        rows: Which grasp of the scene each member is; None: they are the same.
    """
    if on_iteration is None:
        return None

    def see(member: np.ndarray, point: Point, loss: np.ndarray) -> None:
        on_iteration(
            IterationState(member if rows is None else rows[member], point, loss, goal.touching[member], stage)
        )

    return see
