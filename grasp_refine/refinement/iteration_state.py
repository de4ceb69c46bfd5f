"""State of a refinement after an iteration, for callbacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from grasp_refine.refinement.solvers import iterate
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.scene.goal import Goal


@dataclass(frozen=True, eq=False)
class IterationState:
    """State of M grasps after an iteration."""

    row: np.ndarray
    """Rows (M,) of the grasps in their scene; one that is tried from several starts at once appears once per start."""
    member: np.ndarray
    """Numbers (M,) of the grasps' starts in the present attempt, which tries several at once."""
    point: Point
    """Poses of the base link (M, 4, 4) and joint values (M, n)."""
    loss: np.ndarray
    """Losses (M,) in m^2 at the present stage of the search."""
    touching: np.ndarray
    """Links (M, L) that should touch in the present stage."""
    stage: str
    """Name of the present stage, for people."""


IterationCallback = Callable[[IterationState], None]
"""Called after each iteration; an exception that it raises ends the refinement."""


def with_callback(
    on_iteration: IterationCallback | None, goal: Goal, stage: str, rows: np.ndarray | None = None
) -> iterate.IterationCallback | None:
    """Return the callback of a solver that passes its members on to `on_iteration`.

    Args:
        on_iteration: Callback of the refinement; None: no callback.
        goal: Goal of the members.
        stage: Name of the stage.
        rows: Grasp of the scene that each member is; None: their own numbers.
    """
    if on_iteration is None:
        return None

    def callback(member: np.ndarray, point: Point, loss: np.ndarray) -> None:
        on_iteration(
            IterationState(member if rows is None else rows[member], member, point, loss, goal.touching[member], stage)
        )

    return callback
