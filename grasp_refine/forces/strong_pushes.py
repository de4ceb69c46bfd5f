"""Strong pushes: whether the contacts of grasps can balance the weight of a heavy object, whatever its direction."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.forces.wrench import turn_loads
from grasp_refine.objects.object import Object

STRONG_PUSH_SHARE = 0.33
"""Outer force per unit of total pressure: about the weight of 1 kg for a squeeze of `TOTAL_PRESSURE_N`."""

STRONG_PUSH_FRICTION = 0.3
"""Friction against strong pushes of objects in `dexgraspbench`: half of it, more than forces are planned with."""

_CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 3) / np.sqrt(3.0)

STRONG_PUSHES = STRONG_PUSH_SHARE * np.concatenate([np.eye(3, 6), -np.eye(3, 6), np.pad(_CORNERS, ((0, 0), (0, 3)))])
"""Outer forces (14, 6) towards the faces and corners of a cube, as loads of `contact_forces` in the axes of the
hand."""


def strong_push_residual(
    points: ContactPoints, obj: Object, axes: Float[np.ndarray, "N 3 3"], grip: float = 1.0
) -> Float[np.ndarray, " N"]:
    """Largest wrench residual (N,) under any of `STRONG_PUSHES`, with `STRONG_PUSH_FRICTION`; NaN without forces.

    Args:
        points: Contact points of N grasps.
        obj: The object.
        axes: Rotations (N, 3, 3) of the hand, in whose axes the pushes are.
        grip: Friction of the task, as `Demand.grip`.
    """
    loads = turn_loads(STRONG_PUSHES, axes)
    friction = STRONG_PUSH_FRICTION * grip
    return points.forces_under(loads, obj.center_of_mass, friction=friction, axes=axes).residual.max(axis=1)
