"""Margins of the grasps of a problem, for Python."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rich.console import RenderableType

from grasp_refine.core.plurals import count_text
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.refine import Listener
from grasp_refine.results.console import html_of, text_of
from grasp_refine.results.margins_table import margins_table
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import DEFAULT, PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine.validation.margins.draws import Draws, draw
from grasp_refine.validation.margins.factors import JOINT, Factors
from grasp_refine.validation.margins.margins import Margins, Worlds, check_pushes, margins, other_model_of
from grasp_refine.validation.validate import model_of


@dataclass(frozen=True, eq=False)
class GraspMargins:
    """Margins of N grasps, in the requested order."""

    problem: Problem
    """Hand, objects and grasps."""
    protocol: Protocol
    """Protocol that holds for everything that is not drawn."""
    draws: Draws
    """The drawn worlds, which all grasps share."""
    margins: Margins
    """Trials in each draw, and limits."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.margins)

    @property
    def probability(self) -> np.ndarray:
        """Share (N,) of the drawn worlds in which a grasp held."""
        return self.margins.held[JOINT].mean(axis=1)

    def table(self, *, verbose: bool = False) -> RenderableType:
        """Return the table of `refine-grasp validate` with margins, for a console of rich."""
        groups, order = self.problem.groups, self.problem.order
        objects = np.concatenate([np.full(len(group.rows), group.object) for group in groups])[order]
        index = np.concatenate([group.index for group in groups])[order]
        return margins_table(self.margins, objects, index, self.problem.hand.name, verbose=verbose)

    def __repr__(self) -> str:
        return f"GraspMargins({count_text(len(self), 'grasp')} of {self.problem.hand.name}: {self.margins!r})"

    def __str__(self) -> str:
        return text_of(self.table())

    def _repr_html_(self) -> str:
        """Return the table as HTML, for a notebook."""
        return html_of(self.table())


def problem_margins(
    problem: Problem,
    factors: Factors | None = None,
    *,
    draws: int = 32,
    seed: int = 0,
    with_limits: bool = True,
    threads: int | None = None,
    listener: Listener | None = None,
) -> GraspMargins:
    """Return the margins of all grasps of a problem.

    Args:
        problem: Hand, objects, grasps and task; its protocol, by default `dexgraspbench`, pushes, and holds for
            everything that is not drawn.
        factors: Ranges of the factors; the defaults when None.
        draws: Number of drawn worlds.
        seed: Seed of the draws.
        with_limits: Whether lowest friction, largest force and largest torque are searched too.
        threads: CPU threads; by default as many as there are.
        listener: Callbacks of the progress.

    Raises:
        GraspRefineError: a protocol that lifts, or MuJoCo cannot compile the hand or a world.
    """
    if problem.task.protocol is None:
        problem = problem.for_task(Task(PROTOCOLS[DEFAULT]))
    protocol = problem.task.test(patches=problem.hand.patches)
    check_pushes(protocol)
    drawn, listener = draw(factors or Factors(), draws, seed), listener or Listener()
    model, other = model_of(problem.hand), other_model_of(problem.hand)
    parts = []
    for group in problem.groups:
        worlds = Worlds.of(model, group.scene.object, group.scene.task.for_simulation, other)
        parts.append(
            margins(
                worlds,
                group.motion(),
                drawn,
                with_limits=with_limits,
                threads=threads,
                progress=listener.simulating(group),
            )
        )
    return GraspMargins(problem, protocol, drawn, Margins.join(parts).select(problem.order))
