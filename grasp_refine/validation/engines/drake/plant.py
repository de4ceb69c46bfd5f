"""Drake's plant of a world, translated from its compiled MuJoCo model, so that both engines have the same numbers.

The same in both are bodies and inertias, joints with limits, damping, armature and dry friction, convex geometry and
the pairs that may touch, stiffness, damping and force limits of servos at joints and tendons, couplings, and the
coefficient of friction. Not the same, as Drake has no counterpart:

- contacts carry no torque about their normal: Drake's point contacts have no torsional friction, MuJoCo's have 2 cm of
  it at the friction 0.6 of DexGraspBench (a torque of up to 0.02 m times the normal force);
- contacts are springs with Hunt and Crossley's dissipation instead of MuJoCo's impedances, and dry friction is
  regularised by a speed (`build.STICTION_SPEED_M_S`), below which it creeps, instead of a solver's tolerance;
- an asymmetric force range of a servo is widened to the larger of its ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import GeometryId
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Diagram

from grasp_refine.core.array_types import Float, Int


@dataclass(frozen=True, eq=False)
class Plant:
    """World in Drake; it is never changed: contexts hold poses, set points and pushes."""

    diagram: Diagram
    """Plant and scene graph."""
    plant: MultibodyPlant
    """Bodies, joints and servos."""
    hand: ModelInstanceIndex
    """Model instance of the hand."""
    start: FixedOffsetFrame
    """Frame in which the joints of the hand's root are counted; each context has its own pose of it."""
    root: Int[np.ndarray, " 6"]
    """Indices (6,) in positions of the root's joints: along x, y, z, then about them."""
    root_servos: Int[np.ndarray, " 6"]
    """Indices (6,) of the root's servos among the set points."""
    joints: Int[np.ndarray, " m"]
    """Indices (m,) in positions of the hand's joints, in the order of `HandModel.joints`."""
    helpers: Float[np.ndarray, "p p"]
    """Matrix (p, p) that takes positions in which helper joints of tendons are 0 to complete ones."""
    servos: Int[np.ndarray, " u"]
    """Indices (u,) among the set points of MuJoCo's actuators."""
    gear: Float[np.ndarray, " u"]
    """Set points of MuJoCo's actuators (u,) are Drake's times this."""
    control_range: Float[np.ndarray, "u 2"]
    """Smallest and largest set point (u, 2) of MuJoCo's actuators."""
    rest: Float[np.ndarray, " s"]
    """Set points (s,) of all actuators before they are driven."""
    object: RigidBody
    """The object."""
    object_at: slice
    """Indices (7,) in positions of the object's pose: quaternion (w, x, y, z), then position."""
    centre: Float[np.ndarray, " 3"]
    """Centre of mass (3,) of the object in its frame, metres."""
    geoms: Mapping[GeometryId, int]
    """Geometry -> number of the geom in MuJoCo."""

    def set_points(self, control: Float[np.ndarray, "N u"]) -> Float[np.ndarray, "N u"]:
        """Return the set points of Drake's servos for MuJoCo's, clipped at their limits."""
        return np.clip(control, *self.control_range.T) / self.gear


def rigid(T: Float[np.ndarray, "4 4"]) -> RigidTransform:
    """Return a transform (4, 4) for Drake, its rotation orthonormal as Drake asks for."""
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(T[:3, :3]), T[:3, 3])
