"""Derivative methods of witness points, and neighbourhoods of their surface samples, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from types import MappingProxyType
from typing import Literal

from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.slip import Coupling
from grasp_refine.witness.zeroth_order import ZerothOrder

NeighborhoodName = Literal["adaptive", "fixed", "neighbor"]

NEIGHBORHOODS: Mapping[NeighborhoodName, Adaptive | Fixed | Neighbor] = MappingProxyType(
    {"adaptive": Adaptive(), "fixed": Fixed(), "neighbor": Neighbor()}
)

METHODS: Mapping[str, Callable[..., Derivative]] = MappingProxyType(
    {
        "distance": Distance,
        "direction": Direction,
        "analytical": Analytical,
        "zeroth-order": ZerothOrder,
        "finite-difference": FiniteDifference,
        "contact-kinematics": ContactKinematics,
        "rigid": Rigid,
    }
)
"""Name -> class of the method."""


def make_derivative(
    name: str, *, neighborhood: NeighborhoodName = "adaptive", coupling: Coupling = "coupled", seed: int = 0
) -> Derivative:
    """Make a derivative method; a method ignores the settings that it does not have."""
    settings = {"neighborhood": NEIGHBORHOODS[neighborhood], "coupling": coupling, "seed": seed}
    known = signature(METHODS[name]).parameters
    return METHODS[name](**{key: value for key, value in settings.items() if key in known})
