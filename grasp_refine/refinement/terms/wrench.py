"""Wrench: the best contact forces balance (see `forces.equilibrium`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import Array
from grasp_refine.forces.equilibrium import Equilibrium
from grasp_refine.forces.wrench import PLANNING_FRICTION
from grasp_refine.refinement.solvers.rows import JointRows
from grasp_refine.refinement.terms.motion import contact_curvatures
from grasp_refine.refinement.terms.term import Setup, State, Term

CURVATURE_RADIUS_M = 0.008
"""Radius in metres of the neighbourhoods in which surface normals determine curvature."""


class Wrench(Term):
    """Forces and torques that the best contact forces leave unbalanced, per unit of total pressure."""

    autograd: ClassVar[bool] = False
    cost: ClassVar[int] = 1

    def prepare(self, setup: Setup) -> None:
        """Set up the equilibrium of the hand's grasps, and find the links that touch in any of them."""
        prepared = setup.prepared
        friction = PLANNING_FRICTION * setup.scene.demand.grip
        self.equilibrium = Equilibrium.of(prepared.hand, prepared.chain, friction)
        self.columns = np.flatnonzero(setup.goal.touching.any(axis=0))

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there are contacts."""
        return bool(setup.goal.touching.any())

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with the best contact forces, warm-started from its own; none where it is rejected."""
        pushing = self.setup.goal.touching[state.member] & ~rejected[:, None]
        where, known = self._where(state), (state.forces, state.patches)
        forces = self.equilibrium.forces(pushing, state.witness, state.frames, *where, *known)
        return replace(state, forces=forces)

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
        w, E, K_link, K_object = contact_curvatures(self.setup, state, columns, pressed, radius, width)
        known = columns, w, state.frames, *self._where(state), E, K_link, K_object, state.patches
        yield JointRows(*self.equilibrium.rows(state.forces, *known))

    def _where(self, state: State) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3 3"]]:
        """Return the centres of mass of the objects, and frames that rotate with the scene: the hands at first."""
        scene = self.setup.scene
        return scene.centers(state.member), scene.T_world_root[state.member, :3, :3]
