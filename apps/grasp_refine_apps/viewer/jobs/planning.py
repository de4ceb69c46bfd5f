"""Planning of the trajectory of one grasp, with progress and interruption."""

from __future__ import annotations

from grasp_refine.motion.plan import plan_motions
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.jobs.validating import PosedGrasp
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.pose import posed_scene
from grasp_refine_apps.viewer.model.shown_trajectory import ShownTrajectory, shown_trajectory


def plan_trajectory(grasp: PosedGrasp, control: Control) -> ShownTrajectory:
    """Plan the trajectory of one grasp, as `refine-grasp run --trajectory` does.

    Args:
        grasp: The grasp.
        control: Receives a description of the present step, and can stop the planning between steps.

    Raises:
        GraspRefineError: there is no grasp, or it is out of reach.
        Stopped: the job was stopped.
    """
    control.describe("planning the trajectory: opening and closing the hand")
    motion, _ = grasp.motion(control.check)
    control.describe("planning the trajectory: approach and lift")
    control.check()
    scene = posed_scene(grasp.scene, grasp.pose)
    prepared = grasp.prepared or HandObject.of(scene)
    (plan,) = plan_motions(scene, motion, prepared=prepared)
    control.check()
    return shown_trajectory(scene, plan, prepared)
