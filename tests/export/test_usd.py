"""Stages of USD, read by Pixar's library alone."""

from __future__ import annotations

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.export.targets import export
from grasp_refine.hands.chain import Chain
from grasp_refine.problem.exports import exported_grasps
from plate_gripper import URDF

pxr = pytest.importorskip("pxr", reason="USD is not installed: pip install 'grasp-refine[usd]'")
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdValidation  # noqa: E402

TURNING = """<robot name="turner"><link name="palm"><inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"
 ixy="0" ixz="0" iyz="0"/></inertial>
 <collision><origin xyz="0 0 -0.02"/><geometry><box size="0.1 0.04 0.02"/></geometry></collision></link>
 {fingers}</robot>"""
FINGER = """<link name="{name}"><inertial><origin xyz="0 0 0.03"/><mass value="0.1"/><inertia ixx="1e-4" iyy="2e-4"
 izz="3e-4" ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 0.04"/><geometry>
 <box size="0.01 0.03 0.08"/></geometry></collision></link>
 <joint name="{joint}" type="revolute"><parent link="palm"/><child link="{name}"/>
 <origin xyz="{x} 0 0" rpy="0.1 0 {yaw}"/><axis xyz="0 {sign} 0"/><limit lower="-0.5" upper="0.9" effort="2"
 velocity="3"/>{mimic}</joint>"""


@pytest.fixture(scope="module")
def turner(tmp_path_factory: pytest.TempPathFactory) -> gr.Hand:
    """Gripper of two fingers that turn, the second one by half as much as the first."""
    path = tmp_path_factory.mktemp("turner") / "turner.urdf"
    mimic = '<mimic joint="1.first" multiplier="0.5" offset="0.1"/>'
    fingers = FINGER.format(name="left", joint="1.first", x=-0.04, yaw=0.2, sign=1, mimic="")
    fingers += FINGER.format(name="right", joint="1_first", x=0.04, yaw=-0.3, sign=-1, mimic=mimic)
    path.write_text(TURNING.format(fingers=fingers))
    return gr.load_hand(path, candidates=64)


@pytest.fixture(scope="module", params=["plates", "turner"])
def stage(
    request: pytest.FixtureRequest, turner: gr.Hand, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Usd.Stage, gr.Hand, np.ndarray, np.ndarray, str]:
    folder = tmp_path_factory.mktemp("usd")
    hand = turner
    if request.param == "plates":
        (folder / "plates.urdf").write_text(URDF)
        hand = gr.load_hand(folder / "plates.urdf", candidates=64)
    pose = np.array([[0.01, 0.02, -0.09, 0.9, 0.1, -0.2, 0.3], [0.0, 0.0, -0.12, 1.0, 0.0, 0.0, 0.0]])
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    q = np.clip(hand.rest + np.array([[0.02], [0.01]]), hand.lower, hand.upper)
    grasps = gr.GraspSet.of(hand, pose, q)
    problem = gr.problem_of(hand, gr.load_object("box:0.04,0.05,0.06"), grasps, as_is=True)
    (part,) = exported_grasps(problem)
    export([part], "usd", folder / "stage")
    path = str(folder / "stage" / "scene.usda")
    return Usd.Stage.Open(path), hand, part.motion.T_world_root, part.motion.q, path


def joints_of(stage: Usd.Stage) -> list[UsdPhysics.Joint]:
    """The joints of the hand."""
    return [UsdPhysics.Joint(prim) for prim in stage.Traverse() if prim.IsA(UsdPhysics.Joint)]


def frame(joint: UsdPhysics.Joint, number: int) -> np.ndarray:
    """Frame of a joint on one of its two bodies."""
    position = getattr(joint, f"GetLocalPos{number}Attr")().Get()
    turn = getattr(joint, f"GetLocalRot{number}Attr")().Get()
    T = np.eye(4)
    T[:3, :3] = np.array(Gf.Matrix3d(Gf.Quatd(turn))).T
    T[:3, 3] = position
    return T


def test_joints_at_the_written_values_put_links_where_the_kinematics_of_the_hand_has_them(stage):
    opened, hand, T_root, q, _ = stage
    links = [link.name for link in hand.links]
    grasp = opened.GetPrimAtPath("/World/Grasps/grasp_1")
    values = dict(zip(grasp.GetAttribute("joints").Get(), grasp.GetAttribute("grasp:positions").Get(), strict=True))
    root = np.array(grasp.GetAttribute("grasp:pose").Get())
    poses = {"/World/Hand/" + links[0]: gr.transform_from_pose(root)}
    # The names of prims lose what USD does not allow; the order of joints is that of their links.
    spelled = {label.replace(".", "_"): value for label, value in sorted(values.items(), reverse=True)}
    for joint in joints_of(opened):
        parent, child = (str(rel().GetTargets()[0]) for rel in (joint.GetBody0Rel, joint.GetBody1Rel))
        name = joint.GetPrim().GetName()
        moved = np.eye(4)
        if joint.GetPrim().IsA(UsdPhysics.PrismaticJoint):
            moved[0, 3] = spelled[name]
        elif joint.GetPrim().IsA(UsdPhysics.RevoluteJoint):
            angle = values["1.first"] if child.endswith("left") else values["1_first"]
            moved[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        poses[child] = poses[parent] @ frame(joint, 0) @ moved @ np.linalg.inv(frame(joint, 1))
    expected = Chain(hand, links)(T_root[:, 1], q[:, 1]).T_world_link[1]
    for link, T in zip(links, expected, strict=True):
        np.testing.assert_allclose(poses[f"/World/Hand/{link}"], T, atol=2e-6)


def test_bodies_stand_where_the_first_pregrasp_has_them_and_drives_hold_them_there(stage):
    opened, hand, T_root, q, _ = stage
    links = [link.name for link in hand.links]
    for link, T in zip(links, Chain(hand, links)(T_root[:, 0], q[:, 0]).T_world_link[0], strict=True):
        found = UsdGeom.Xformable(opened.GetPrimAtPath(f"/World/Hand/{link}")).ComputeLocalToWorldTransform(0)
        np.testing.assert_allclose(np.array(found).T, T, atol=2e-6)
    driven = 0
    for joint in joints_of(opened):
        for kind, unit in (("angular", np.pi / 180.0), ("linear", 1.0)):
            drive = UsdPhysics.DriveAPI.Get(joint.GetPrim(), kind)
            if drive and drive.GetStiffnessAttr().HasAuthoredValue():
                driven += 1
                assert unit * drive.GetStiffnessAttr().Get() >= 0
                limits = joint.GetPrim().GetAttribute("physics:lowerLimit").Get(), drive.GetTargetPositionAttr().Get()
                assert limits[0] - 1e-4 <= limits[1]
    assert driven == len(joints_of(opened)) == 2


def test_masses_limits_and_couplings_are_the_hands(turner: gr.Hand, stage):
    opened, hand, *_ = stage
    mass = UsdPhysics.MassAPI(opened.GetPrimAtPath("/World/Object")).GetMassAttr().Get()
    assert mass == pytest.approx(0.1)
    if hand is not turner:
        return
    left, right = joints_of(opened)
    revolute = UsdPhysics.RevoluteJoint(left.GetPrim())
    assert revolute.GetLowerLimitAttr().Get() == pytest.approx(np.degrees(-0.5))
    assert revolute.GetUpperLimitAttr().Get() == pytest.approx(np.degrees(0.9))
    assert left.GetPrim().GetAttribute("physxJoint:maxJointVelocity").Get() == pytest.approx(np.degrees(3.0))
    assert left.GetPrim().GetName() != right.GetPrim().GetName()
    assert "PhysxMimicJointAPI:rotX" in right.GetPrim().GetMetadata("apiSchemas").GetAddedOrExplicitItems()
    # joint + gearing * reference + offset = 0, in degrees
    prim = right.GetPrim()
    gearing, offset = (prim.GetAttribute(f"physxMimicJoint:rotX:{name}").Get() for name in ("gearing", "offset"))
    assert 0.5 * 20.0 + np.degrees(0.1) + gearing * 20.0 + offset == pytest.approx(0.0, abs=1e-4)
    finger = UsdPhysics.MassAPI(opened.GetPrimAtPath("/World/Hand/left"))
    assert finger.GetMassAttr().Get() == pytest.approx(0.1)
    np.testing.assert_allclose(finger.GetCenterOfMassAttr().Get(), [0.0, 0.0, 0.03], atol=1e-6)
    np.testing.assert_allclose(np.sort(finger.GetDiagonalInertiaAttr().Get()), [1e-4, 2e-4, 3e-4], rtol=1e-4)


def test_the_validators_of_usd_have_no_complaint(stage):
    opened = stage[0]
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    assert [error.GetMessage() for error in context.Validate(opened)] == []
    assert UsdGeom.GetStageMetersPerUnit(opened) == 1.0 and UsdGeom.GetStageUpAxis(opened) == "Z"
    # They do look: a joint of a body that is not there is a fault.
    joints_of(opened)[0].GetBody1Rel().SetTargets(["/World/Nothing"])
    assert context.Validate(opened)
