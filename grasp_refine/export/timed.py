"""Trajectory of an exported grasp."""

from __future__ import annotations

from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.motion.plan import MotionPlan, closing_paths
from grasp_refine.motion.trajectory import Trajectory, trajectory


def timed(grasps: ExportedGrasps, plan: MotionPlan, row: int) -> Trajectory:
    """Return the whole plan, where it is free; else the fingers' part of it."""
    if plan.free:
        return trajectory(grasps.hand, plan)
    legs = closing_paths(grasps.hand, grasps.motion.T_world_root[row], grasps.motion.q[row])
    return trajectory(grasps.hand, MotionPlan(plan.status, plan.why, legs, plan.direction))
