"""Planning of the whole way of one grasp, with progress and interruption."""

from __future__ import annotations

from grasp_refine.motion.way import ways
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.jobs.validating import PosedGrasp
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.pose import posed_scene
from grasp_refine_apps.viewer.model.shown_way import ShownWay, shown_way


def plan_way(grasp: PosedGrasp, control: Control) -> ShownWay:
    """Plan the way of one grasp, as `refine-grasp run --way` does.

    Args:
        grasp: The grasp.
        control: Receives a description of the present step, and can stop the planning between steps.

    Raises:
        GraspRefineError: there is no grasp, or it is out of reach.
        Stopped: the job was stopped.
    """
    control.describe("planning the way: opening and closing the hand")
    motion, _ = grasp.motion(control.check)
    control.describe("planning the way: approach and lift")
    control.check()
    scene = posed_scene(grasp.scene, grasp.pose)
    prepared = grasp.prepared or HandObject.of(scene)
    (way,) = ways(scene, motion, prepared=prepared)
    control.check()
    return shown_way(scene, way, prepared)
