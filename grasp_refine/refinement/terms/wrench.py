"""Wrench: the best contact forces balance (see `forces.equilibrium`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array
from grasp_refine.forces.equilibrium import Equilibrium
from grasp_refine.forces.wrench import PLANNING_FRICTION, center_of_mass
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
        self.equilibrium = Equilibrium.of(prepared.hand, prepared.chain, center_of_mass(prepared.object), friction)
        self.columns = np.flatnonzero(setup.goal.touching.any(axis=0))

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there are contacts."""
        return bool(setup.goal.touching.any())

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with the best contact forces, warm-started from its own; none where it is rejected."""
        pushing = self.setup.goal.touching[state.member] & ~rejected[:, None]
        known = state.forces, state.patches
        forces = self.equilibrium.forces(pushing, state.witness, state.frames, self._axes(state), *known)
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
        axes, patches = self._axes(state), state.patches
        known = columns, w, state.frames, axes, E, K_link, K_object, patches
        yield JointRows(*self.equilibrium.rows(state.forces, *known))

    def _axes(self, state: State) -> Float[np.ndarray, "M 3 3"]:
        """Return the rotations of the hands in the initial grasps: a frame that rotates with the scene."""
        return self.setup.scene.T_world_root[state.member, :3, :3]
