"""Faults in files of hands that other programs take without a word: each is named, and a sound file has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from grasp_refine.hands.files.file_faults import file_faults
from grasp_refine.hands.files.usd import urdf_of_usd
from made_hands import BALL, joint, link, write_urdf

LIMIT = '<limit lower="0" upper="1" effort="1" velocity="{}"/>'


def urdf(folder: Path, velocity: str = "2", transmission: str = "") -> Path:
    turning = joint("bend", "palm", "tip", "revolute", LIMIT.format(velocity), axis="0 1 0")
    return write_urdf(folder, link("palm", BALL), link("tip", BALL), turning, transmission, name="finger")


def test_urdfs_without_speeds_or_with_transmissions_of_other_joints(tmp_path: Path):
    sound = '<transmission name="t"><joint name="bend"/></transmission>'
    assert file_faults(urdf(tmp_path, transmission=sound)) == ()
    (slow,) = file_faults(urdf(tmp_path, velocity="0"))
    assert "velocity" in slow and "bend" in slow
    (lost,) = file_faults(urdf(tmp_path, transmission=sound.replace("bend", "bend_old")))
    assert "bend_old" in lost


MJCF = """<mujoco><worldbody><body name="palm"><geom size="0.01"/>
<body name="tip" pos="0 0 0.05"><joint name="bend" axis="0 1 0" range="0 1" limited="true"/><geom size="0.01" {geom}/>
<site name="s"/></body></body></worldbody>
<actuator><position name="a" joint="bend" kp="{kp}"/>{more}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({}, ()),
        ({"geom": 'friction="0 0 0"'}, ("friction", "tip")),
        ({"geom": 'condim="1"'}, ("friction", "tip")),
        ({"more": '<general name="g" site="s" gear="0 0 1 0 0 0"/>'}, ("'g'", "no joint")),
        ({"kp": "0"}, ("'a'", "gain")),
    ],
)
def test_mjcfs_that_slip_or_have_actuators_without_effect(tmp_path: Path, changes: dict, named: tuple[str, ...]):
    path = tmp_path / "finger.xml"
    path.write_text(MJCF.format(**{"geom": "", "kp": "1", "more": "", **changes}))
    found = file_faults(path)
    assert len(found) == bool(named)
    assert all(word.strip("'") in found[0] for word in named)


STAGE = """#usda 1.0
(
    metersPerUnit = {metres}
    defaultPrim = "Hand"
)
def Xform "Hand" {{
    def Material "Skin" (prepend apiSchemas = ["PhysicsMaterialAPI"]) {{
        float physics:staticFriction = {friction}
        float physics:dynamicFriction = {friction}
    }}
    {bodies}
    def PhysicsRevoluteJoint "bend" (prepend apiSchemas = ["PhysicsDriveAPI:angular"]) {{
        rel physics:body0 = </Hand/palm>
        rel physics:body1 = </Hand/tip>
        uniform token physics:axis = "Y"
        float physics:lowerLimit = 0
        float physics:upperLimit = 60
        float drive:angular:physics:stiffness = {stiffness}
        {speed}
    }}
}}
"""
BODY = """def Xform "{}" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
        def Sphere "solid" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]) {{
            double radius = 0.01
            rel material:binding:physics = </Hand/Skin>
        }}
    }}
    """


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({}, ()),
        ({"stiffness": 0}, ("bend", "drive")),
        ({"speed": ""}, ("bend", "maxJointVelocity")),
        ({"friction": 0}, ("Skin", "friction")),
        ({"names": ("palm", "tip", "pad")}, ("pad", "no joint")),
        ({"metres": 0.01}, ("0.01 m",)),
    ],
)
def test_stages_whose_hands_go_limp_slip_or_fall_apart(tmp_path: Path, changes: dict, named: tuple[str, ...]):
    pytest.importorskip("pxr", reason="USD is not installed: pip install 'grasp-refine[usd]'")
    sound = {"metres": 1, "friction": 0.8, "stiffness": 2, "speed": "float physxJoint:maxJointVelocity = 90"}
    values = {**sound, "names": ("palm", "tip"), **changes}
    path = tmp_path / "hand.usda"
    path.write_text(STAGE.format(bodies="".join(BODY.format(name) for name in values.pop("names")), **values))
    found = file_faults(urdf_of_usd(path))
    assert len(found) == bool(named)
    assert all(word in found[0] for word in named)
