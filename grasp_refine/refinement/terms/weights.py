"""Weights of the terms of the loss: the list of all terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import inf
from types import MappingProxyType
from typing import Annotated, get_type_hints

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.terms.contact import Contact
from grasp_refine.refinement.terms.direction import Direction
from grasp_refine.refinement.terms.environment import Clearance
from grasp_refine.refinement.terms.joint_limits import JointLimits
from grasp_refine.refinement.terms.penetration import Penetration
from grasp_refine.refinement.terms.region import InRegion
from grasp_refine.refinement.terms.self_penetration import SelfPenetration
from grasp_refine.refinement.terms.stay_near import StayNear
from grasp_refine.refinement.terms.table import Table
from grasp_refine.refinement.terms.term import Setup, Term
from grasp_refine.refinement.terms.wrench import Wrench


@dataclass(frozen=True)
class Weights:
    """Weights of the terms in the sum of squares, each with its term."""

    contact: Annotated[float, Contact] = 1.0
    """Weight of gaps and of target misses (metres) of the links that should touch; gaps at the corners where flat faces
    meet count too."""
    penetration: Annotated[float, Penetration] = 100.0
    """Weight of the depth of every link in the object (metres); descent and adam are faster with 10."""
    self_penetration: Annotated[float, SelfPenetration] = 100.0
    """Weight of the depth of links in each other (metres); likewise."""
    table: Annotated[float, Table] = 100.0
    """Weight of the depth of every link below the table, where there is one (metres)."""
    environment: Annotated[float, Clearance] = 100.0
    """Weight of the depth of every link in a body of the scene, or in its margin (metres)."""
    region: Annotated[float, InRegion] = 10.0
    """Weight of the distance of contacts from where hands should touch, or of their depth where they should not
    (metres)."""
    joint_limits: Annotated[float, JointLimits] = 0.01
    """Weight of joint values beyond their limits (radians, or metres for prismatic joints), in m^2/rad^2; with
    levenberg-marquardt, limits hold exactly and it has no effect."""
    stay_near: Annotated[float, StayNear] = 0.0
    """Weight of the movement from the initial grasp, in units of `Scales`, in m^2."""
    wrench: Annotated[float, Wrench] = 1.6e-3
    """Weight of the wrench that the best contact forces leave unbalanced, per unit of total pressure, in m^2; with
    levenberg-marquardt only."""
    direction: Annotated[float, Direction] = 1e-3
    """Weight of contact normals that differ from target normals (1 - their cosine is half the square), in m^2."""

    def __post_init__(self) -> None:
        """Refuse weights that are negative or not finite.

        Raises:
            GraspRefineError: names the weight that is below 0 or not a finite number, or of no term of ours.
        """
        check_fields(self)
        for field in fields(self):
            if field.name not in Weights.__dataclass_fields__:
                raise GraspRefineError(
                    f"{type(self).__name__}: {field.name} is no weight of a term of ours; give your own term in "
                    "terms=[...]"
                )
            if not 0.0 <= getattr(self, field.name) < inf:
                raise GraspRefineError(
                    f"weights: {field.name} must be at least 0 and finite, got {getattr(self, field.name):g}"
                )

    def terms(self, setup: Setup, *, autograd: bool) -> tuple[tuple[float, Term], ...]:
        """Return the terms of a refinement with weights above 0, for gradients or for least squares."""
        kinds = ((getattr(self, name), kind) for name, kind in term_kinds().items())
        return tuple(
            (weight, kind().of(setup))
            for weight, kind in kinds
            if weight > 0.0 and (kind.autograd if autograd else kind.least_squares) and kind.applies(setup)
        )


@cache
def term_kinds() -> Mapping[str, type[Term]]:
    """Return the terms by the names of their weights."""
    hints = get_type_hints(Weights, include_extras=True)
    return MappingProxyType({name: hint.__metadata__[0] for name, hint in hints.items()})
