"""Contact forces under a single load."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from grasp_refine.forces.wrench import ContactForces, contact_forces


def single_load_forces(
    point: np.ndarray, normal: np.ndarray, center: np.ndarray, *, load: np.ndarray | None = None, **settings: Any
) -> ContactForces:
    """Return `contact_forces` of N grasps under one load each, (6,) or (N, 6), or none; its fields are (N, ...)."""
    loads = np.zeros((len(point), 1, 6))
    if load is not None:
        loads[:, 0] = load
    found = contact_forces(loads, point, normal, center, **settings)
    return ContactForces(*(getattr(found, field.name)[:, 0] for field in fields(found)))
