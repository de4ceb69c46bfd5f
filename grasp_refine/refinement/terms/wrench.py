"""Wrench: the best contact forces balance (see `forces.equilibrium`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array
from grasp_refine.forces.equilibrium import Equilibrium
from grasp_refine.forces.wrench import center_of_mass
from grasp_refine.refinement.solvers.rows import JointRows
from grasp_refine.refinement.terms.motion import contact_curvatures
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.scene.goal import Goal
from grasp_refine.witness.pair_curvature import PairCurvatures

CURVATURE_RADIUS_M = 0.008
"""Radius in metres of the neighbourhoods in which surface normals determine curvature."""


@dataclass(frozen=True, eq=False)
class Wrench(Term):
    """Forces and torques that the best contact forces leave unbalanced, per unit of total pressure.

    Without targets only: these say where contacts are.
    """

    autograd: ClassVar[bool] = False
    cost: ClassVar[int] = 1

    equilibrium: Equilibrium
    goal: Goal
    curvatures: PairCurvatures
    columns: np.ndarray
    """Links (C,) that touch in any of the grasps."""

    @classmethod
    def of(cls, setup: Setup) -> Wrench | None:
        """Return the term of a refinement; None with targets, or without contacts."""
        prepared, goal, columns = setup.prepared, setup.goal, np.flatnonzero(setup.goal.touching.any(axis=0))
        if goal.aimed.any() or not len(columns):
            return None
        equilibrium = Equilibrium.of(prepared.hand, prepared.chain, center_of_mass(prepared.object))
        return cls(equilibrium, goal, prepared.curvatures, columns)

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with the best contact forces; without contacts where it is rejected."""
        pushing = self.goal.touching[state.member] & ~rejected[:, None]
        return replace(state, forces=self.equilibrium.forces(pushing, state.witness, state.frames))

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the roots (M,) of the mean squares over the loads, forces being counted a little."""
        return (np.sqrt(self.loss(state)),)

    def loss(self, state: State) -> Array:
        """Return the mean squares (M,) over the loads, forces being counted a little."""
        assert state.forces is not None
        return state.forces.value

    def rows(self, state: State, width: np.ndarray) -> Iterator[JointRows]:
        """Return rows of the unbalanced forces and torques."""
        columns = self.columns
        assert state.forces is not None
        pressed = state.forces.pressed[:, columns]
        radius = np.full((2, *pressed.shape), 0.5 * CURVATURE_RADIUS_M)
        w, E, *K = contact_curvatures(self.curvatures, state, columns, pressed, radius, width)
        yield JointRows(*self.equilibrium.rows(state.forces, columns, w, state.frames, E, *K))
