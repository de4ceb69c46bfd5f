"""Hands in USD, in a stage that is written here as text: centimetres, degrees, scaled prims, frames beside origins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import HandError
from grasp_refine.hands.chain import Chain
from refusals import refused

pytest.importorskip("pxr", reason="USD is not installed: pip install 'grasp-refine[usd]'")

BODY = """
def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
    double3 xformOp:translate = {at}
    float3 xformOp:scale = (1, 1, 1)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    float physics:mass = 0.5
    point3f physics:centerOfMass = (1, 2, 3)
    float3 physics:diagonalInertia = (2, 3, 4)
    def Cube "solid" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{
        double size = 2
        float3 xformOp:scale = (0.5, 1, 1.5)
        uniform token[] xformOpOrder = ["xformOp:scale"]
    }}
    def Sphere "ghost" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{
        double radius = 9
        bool physics:collisionEnabled = 0
    }}
}}
"""
JOINT = """
def Physics{kind}Joint "{name}" (prepend apiSchemas = ["PhysicsDriveAPI:angular"]) {{
    rel physics:body0 = </World/Hand/palm>
    rel physics:body1 = </World/Hand/{child}>
    point3f physics:localPos0 = {at0}
    point3f physics:localPos1 = {at1}
    quatf physics:localRot0 = {turn0}
    quatf physics:localRot1 = (1, 0, 0, 0)
    {more}
}}
"""
LIMITS = """uniform token physics:axis = "{axis}"
    float physics:lowerLimit = {low}
    float physics:upperLimit = {high}
    """
QUARTER, NONE, ZERO = "(0.70710678, 0, 0, 0.70710678)", "(1, 0, 0, 0)", "(0, 0, 0)"
"""A quarter turn about z, none, and the origin."""
HEAD = '#usda 1.0\n(\n metersPerUnit = 0.01\n kilogramsPerUnit = 1\n defaultPrim = "World"\n upAxis = "Z"\n)\n'


def stage(folder: Path, joints: str = "") -> Path:
    """Write a palm with a finger that turns about a point beside its origin, a slider, and a hook that follows it."""
    if not joints:
        force = "float drive:angular:physics:maxForce = 30000"
        follows = "float physxMimicJoint:rotX:gearing = -0.5\n float physxMimicJoint:rotX:offset = -10\n"
        follows += "rel physxMimicJoint:rotX:referenceJoint = </World/Hand/turn>"
        turning = LIMITS.format(axis="Z", low=-30, high=90) + force
        sliding, folding = LIMITS.format(axis="X", low=-1, high=3), LIMITS.format(axis="Y", low=-90, high=90) + follows
        joints = (
            JOINT.format(
                kind="Revolute",
                name="turn",
                child="finger",
                at0="(0, 5, 0)",
                at1="(0, 2, 0)",
                turn0=QUARTER,
                more=turning,
            )
            + JOINT.format(
                kind="Prismatic", name="slide", child="slider", at0="(0, 0, 4)", at1=ZERO, turn0=NONE, more=sliding
            )
            + JOINT.format(kind="Revolute", name="fold", child="hook", at0=ZERO, at1=ZERO, turn0=NONE, more=folding)
        )
    bodies = "".join(BODY.format(name=name, at=ZERO) for name in ("palm", "finger", "slider", "hook"))
    thing = BODY.format(name="Object", at="(50, 0, 0)")
    path = folder / "hand.usda"
    path.write_text(f'{HEAD}def Xform "World" {{\n def Xform "Hand" {{\n{bodies}{joints}\n}}\n{thing}\n}}\n')
    return path


@pytest.fixture
def hand(tmp_path: Path) -> gr.Hand:
    return gr.load_hand(stage(tmp_path), base_link="palm")


def test_joints_turn_about_their_points_within_limits_in_radians_and_metres(hand: gr.Hand):
    assert hand.joint_names == ("turn", "slide")
    np.testing.assert_allclose(hand.lower, [np.radians(-30), -0.01], atol=1e-6)
    np.testing.assert_allclose(hand.upper, [np.radians(90), 0.03], atol=1e-6)
    q = np.array([[0.0, 0.01], [np.radians(60.0), 0.02]])
    T = Chain(hand, ["finger", "slider", "hook"])(np.tile(np.eye(4), (2, 1, 1)), q).T_world_link
    for (angle, way), (finger, slider, hook) in zip(q, T, strict=True):
        # A quarter turn on the palm, then the joint; the finger's origin is 2 cm before the axis.
        c, s = np.cos(angle + np.pi / 2), np.sin(angle + np.pi / 2)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(finger[:3, :3], R, atol=1e-6)
        np.testing.assert_allclose(finger[:3, 3], [0.0, 0.05, 0.0] - R @ [0.0, 0.02, 0.0], atol=1e-7)
        np.testing.assert_allclose(slider[:3, 3], [way, 0.0, 0.04], atol=1e-7)
        # Half as far as the finger, and 10 degrees more.
        assert np.arctan2(hook[0, 2], hook[2, 2]) == pytest.approx(0.5 * angle + np.radians(10.0), abs=1e-6)


def test_pieces_masses_and_forces_are_in_metres_and_kilograms(hand: gr.Hand):
    finger = hand.links_by_name["finger"]
    assert finger.body is not None and len(finger.body.pieces) == 1  # the other one does not collide
    assert finger.body.diagonal == pytest.approx(np.linalg.norm([0.01, 0.02, 0.03]), rel=1e-6)
    assert finger.inertia is not None and finger.mass == 0.5
    np.testing.assert_allclose(finger.inertia.centre, [0.01, 0.02, 0.03], rtol=1e-6)
    np.testing.assert_allclose(np.diag(finger.inertia.matrix), [2e-4, 3e-4, 4e-4], rtol=1e-6)
    # 30000 kg cm^2 / s^2
    assert hand.joints_by_name["turn"].effort == pytest.approx(3.0)


def test_a_scale_scales_all_that_is_in_it(tmp_path: Path):
    path = stage(tmp_path)
    path.write_text(path.read_text().replace("xformOp:scale = (1, 1, 1)", "xformOp:scale = (2, 2, 2)"))
    large = gr.load_hand(path, base_link="palm")
    T = Chain(large, ["finger"])(np.eye(4)[None], np.zeros((1, 2))).T_world_link[0, 0]
    np.testing.assert_allclose(T[:3, 3], [0.04, 0.1, 0.0], atol=1e-7)
    body = large.links_by_name["finger"].body
    assert body is not None and body.diagonal == pytest.approx(2 * np.linalg.norm([0.01, 0.02, 0.03]), rel=1e-6)


def test_what_is_no_hand_is_refused_by_name(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    ball = JOINT.format(kind="Spherical", name="ball", child="finger", at0=ZERO, at1=ZERO, turn0=NONE, more="")
    with refused(HandError, "hand.usda", "/World/Hand/ball", "PhysicsSphericalJoint"):
        gr.load_hand(stage(tmp_path, ball))
    (tmp_path / "empty.usda").write_text("#usda 1.0\n(\n subLayers = [@lost.usd@]\n)\n")
    with refused(HandError, "empty.usda", "PhysicsRigidBodyAPI", "lost.usd"):
        gr.load_hand(tmp_path / "empty.usda")
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef Xform {")
    with refused(HandError, "broken.usda", "USD"):
        gr.load_hand(tmp_path / "broken.usda")
    # USD itself prints nothing beside.
    assert capfd.readouterr() == ("", "")
