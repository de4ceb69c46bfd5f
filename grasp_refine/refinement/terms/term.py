"""Terms of the loss of a grasp: residuals, and the rows of their Jacobian, as functions of the same state.

A loss is the sum over the terms of weight times squared residuals, without a factor of one half, in square metres.
Residuals are written against the array API: on torch tensors they keep their graph, which first-order solvers follow;
least squares takes the rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any, ClassVar

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.arguments import describe_value
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import Array, array_namespace
from grasp_refine.forces.contact_points import LinkPatches
from grasp_refine.forces.equilibrium import Balance
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.hands.chain import Frames
from grasp_refine.refinement.solvers.rows import JointRows, LinkRows
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Nearby, Surroundings


@dataclass(frozen=True, eq=False)
class State:
    """M grasps at a point, as NumPy arrays, or as tensors with a graph; the object rests at the world's origin."""

    loss: np.ndarray
    """Losses (M,) in m^2; NaN where a query could not be answered."""
    num_queries: np.ndarray
    """Narrow-phase queries (M,) of this evaluation."""
    member: np.ndarray
    """Rows (M,) of the grasps in their scene."""
    T: Array
    """Poses (M, 4, 4) of the base link."""
    q: Array
    """Joint values (M, n)."""
    T_link: Array
    """Poses (M, L, 4, 4) of the links."""
    axes: np.ndarray | None
    """Unit twists (M, 6, 6 + m) of root and joints; None: not needed by gradients."""
    witness: Witness
    """Witness points (M, L) of links and object."""
    self_witness: Witness
    """Witness points (M, S) of pairs of links; no pairs where no term has asked for them."""
    forces: Balance | None = None
    """Optimal contact forces, where a term needs them; before it has found them, from a nearby state."""
    patches: LinkPatches | None = None
    """Patches where flat faces of touching links meet the object; None: no link can have any, or none is wanted."""
    T_object: Array | None = None
    """Poses (M, L, 4, 4) of the object, where gradients flow through them; None: the identity."""
    nearby: Nearby | None = None
    """Nearby bodies of the environment; before their term has run, from a similar state; None: there are none."""

    @property
    def frames(self) -> Frames:
        """Poses of the links with the twists of the joints."""
        assert self.axes is not None
        return Frames(self.T_link, self.axes, self.T, self.q)

    def like(self, values: np.ndarray) -> Any:
        """Return an array in the library and number type, and on the device, of the state."""
        if isinstance(self.q, np.ndarray):
            return values
        xp = array_namespace(self.q)
        return xp.asarray(values, dtype=self.q.dtype if values.dtype.kind == "f" else None, device=self.q.device)


@dataclass(frozen=True, eq=False)
class Setup:
    """Givens of a refinement, from which terms are made."""

    scene: Scene
    goal: Goal
    prepared: HandObject
    """Geometry of hand and object."""
    margin: float
    """Contact margin in metres."""
    scales: Scales
    """Movements of equal cost."""
    clearance: Float[np.ndarray, " L"]
    """Gap (L,) in metres that each link without a target keeps from the object, see `clearance.clearances`."""
    surroundings: Surroundings | None = None
    """Links, and the bodies around the object that grasps could reach; None: there are none."""

    @cached_property
    def reach(self) -> Float[np.ndarray, " L"]:
        """Distance (L,) in metres within which links without a target matter, whether they should touch or not.

        Where there are regions in which they should not touch, they keep out of the reach of contacts there.
        """
        if self.scene.regions is None:
            return self.clearance
        return np.maximum(self.clearance, CONTACTS.cutoff(self.scene.hand, self.scene.links))

    @cached_property
    def anywhere(self) -> Bool[np.ndarray, "N L"]:
        """Mask (N, L) of the links that should touch, wherever they do."""
        return self.goal.touching & ~self.goal.aimed

    @cached_property
    def flat(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps with any of these links that can meet the object face to face."""
        return (self.anywhere & self.prepared.faces.flat[self.scene.number]).any(axis=1)

    def patches(self, member: np.ndarray, T_link: np.ndarray, witness: Witness) -> LinkPatches | None:
        """Return the patches of these links, of grasps `member` (M,) with poses (M, L, 4, 4) of the links, if any."""
        return LinkPatches.of(self.prepared.faces, self.anywhere[member], T_link, witness, self.scene.number[member])


class Term(ABC):
    """A term of the loss: a value with its settings; each refinement takes a copy of its own.

    A subclass needs `residuals` alone. They are written once, for NumPy arrays and for torch tensors on a graph.
    """

    setup: Setup
    """Givens of the refinement: scene, goal, geometry."""
    weight: float = 1.0
    """Factor of the sum of its squared residuals."""
    autograd: ClassVar[bool] = True
    """Whether first-order solvers have the term."""
    least_squares: ClassVar[bool] = True
    """Whether least squares has the term, which then has `rows`."""
    cost: ClassVar[int] = 0
    """Terms of a higher cost are evaluated later, and only for members that the others do not reject."""

    def of(self, setup: Setup) -> Term:
        """Return a copy of the term for a refinement in which it has a part."""
        term = copy(self)
        object.__setattr__(term, "setup", setup)  # subclasses may be frozen dataclasses
        term.prepare(setup)
        return term

    def prepare(self, setup: Setup) -> None:  # noqa: B027 - most terms need nothing
        """Compute what stays the same during a refinement."""

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether the term has a part in a refinement."""
        return True

    @abstractmethod
    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return arrays of residuals (M, ...), whose squares are summed."""

    def rows(self, state: State, width: np.ndarray) -> Iterable[LinkRows | JointRows]:
        """Return the residuals that have a derivative, with it; `width` (M,) multiplies radii of neighbourhoods.

        By default all residuals, differentiated by autograd: one backward pass for each of them.
        """
        from grasp_refine.refinement.terms.by_autograd import rows_by_autograd

        yield rows_by_autograd(self.residuals, state, self.setup.prepared)

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with what only this term needs, except for members that will be `rejected` (M,) anyway.

        Args:
            state: State.
            rejected: Mask (M,).
            self_witness: Returns the witness points of the pairs of links, given that mask.
        """
        return state

    def loss(self, state: State) -> Array:
        """Return the sum of the squared residuals (M,).

        Raises:
            GraspRefineError: residuals of another kind or shape.
        """
        found = self.residuals(state)
        check_residuals(self, found, len(state.member))
        return reduce(add, (array_namespace(r).sum(r * r, axis=tuple(range(1, r.ndim))) for r in found))


def check_residuals(term: Term, found: Any, count: int) -> None:
    """Refuse residuals of M grasps that are no tuple of arrays (M, ...).

    Raises:
        GraspRefineError: names the term, and what it returned.
    """
    if not (isinstance(found, tuple) and found and all(getattr(one, "shape", ())[:1] == (count,) for one in found)):
        given = [describe_value(one) for one in found] if isinstance(found, tuple) else describe_value(found)
        raise GraspRefineError(
            f"{type(term).__name__}: residuals must return a tuple of arrays of shape ({count}, ...), got {given}"
        )


def checked_rows(term: Term, state: State, width: np.ndarray) -> Iterator[LinkRows | JointRows]:
    """Yield the rows of a term.

    Raises:
        GraspRefineError: rows of another kind or shape; names the term.
    """
    count, dof = len(state.member), 6 + state.q.shape[1]
    for part in term.rows(state, width):
        if not isinstance(part, (LinkRows, JointRows)):  # a union would be made anew at each step
            raise GraspRefineError(
                f"{type(term).__name__}: rows must yield JointRows or LinkRows, got {describe_value(part)}"
            )
        derivative, last = (part.covector, 6) if isinstance(part, LinkRows) else (part.jacobian, dof)
        shape = np.shape(part.residual)
        if len(shape) != 2 or shape[0] != count or np.shape(derivative) != (*shape, last):
            raise GraspRefineError(
                f"{type(term).__name__}: rows must be residuals ({count}, R) and derivatives ({count}, R, {last}), got "
                f"{shape} and {np.shape(derivative)}"
            )
        yield part
