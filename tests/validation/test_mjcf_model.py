"""MJCF hands matched to URDF hands: the published maps, mirrored and turned files, and files that do not fit."""

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from grasp_refine.core.errors import HandError
from grasp_refine.forces.squeeze import set_point_offsets
from grasp_refine.forces.torques import torque_bounds
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.hands.linkages.servos import moments
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from made_hands import joint, links, made_hand, slide
from refusals import assert_names, refused

NAMES = {"shadow": "shadow", "shadow_22": "shadow", "allegro": "allegro", "leap": "leap"}
"""Maps in joint_maps.json -> hands of ours."""

CLIPPED = "set points beyond the ctrlrange of the MJCF are clipped"


def facts(shared_assets: Path, name: str) -> tuple[dict, Hand, Path]:
    fact = json.loads((shared_assets / "facts/joint_maps.json").read_text())[name]
    urdf = shared_assets / "hands" / fact["urdf"]
    hand = load_hand(NAMES[name], urdf=urdf, base_link=fact["urdf_base"], candidates=16)
    return fact, hand, shared_assets / "hands" / fact["mjcf"]


def check_poses(hand: Hand, made: HandModel, tolerance: float) -> None:
    """What stands for a link has its joint where the link's origin is, at random joint values."""
    model = made.spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    child = {joint.child for joint in hand.joints if joint.movable}
    links = {body: link for body, link in made.links.items() if link in child}
    assert len(links) == len(made.joints)
    kinematics = Kinematics(hand, list(links.values()))
    for _ in range(5):
        q = rng.uniform(hand.lower, hand.upper)
        for name, value in zip(made.joints, made.matrix @ q + made.offset, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        root = np.eye(4)
        root[:3, :3], root[:3, 3] = data.body(made.root).xmat.reshape(3, 3), data.body(made.root).xpos
        T_world_base = torch.tensor(root @ np.linalg.inv(made.T_base_root))[None]
        T = kinematics(T_world_base, torch.tensor(q)[None])[0].numpy()
        rows = np.array([model.body(body).jntadr[0] for body in links])
        # MuJoCo's anchor of a slide is where it begins.
        slid = (model.jnt_type[rows] == mujoco.mjtJoint.mjJNT_SLIDE) * data.qpos[rows]
        anchors = data.xanchor[rows] + slid[:, None] * data.xaxis[rows]
        np.testing.assert_allclose(anchors, T[:, :3, 3], atol=tolerance)


@pytest.mark.parametrize("name", NAMES)
def test_published_hands_match(name: str, shared_assets: Path) -> None:
    fact, hand, path = facts(shared_assets, name)
    made = mjcf_model(hand, path)
    assert set(made.notes) <= {CLIPPED}
    assert dict(zip(hand.mimic_map()[2], made.joints, strict=True)) == {
        ours: theirs["mjcf_joint"] for ours, theirs in fact["joints"].items()
    }
    np.testing.assert_array_equal(made.matrix[made.matrix != 0], [theirs["sign"] for theirs in fact["joints"].values()])
    assert not made.offset.any()
    model = made.spec.compile()
    check_poses(hand, made, 1e-4)
    # The facts are about the body that stands for the base link, which need not be the root.
    (base,) = [body for body, link in made.links.items() if link == hand.base_link]
    assert base == fact["mjcf_base"]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T = [np.eye(4), np.eye(4)]
    for pose, body in zip(T, (made.root, base), strict=True):
        pose[:3, :3], pose[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
    T_base = made.T_base_root @ np.linalg.inv(T[0]) @ T[1]
    published = fact["T_urdfbase_from_mjcfbase"]
    np.testing.assert_allclose(T_base[:3, :3], published["R"], atol=1e-3)
    np.testing.assert_allclose(T_base[:3, 3], published["t"], atol=2e-4)
    # What pulls, weighs and collides is that of the file, less what is only seen.
    theirs = mujoco.MjModel.from_xml_path(str(path))
    assert bool(made.notes) == theirs.actuator_ctrllimited.any()
    assert (model.nu, model.nv, model.ntendon, model.nexclude) == (
        theirs.nu,
        theirs.nv,
        theirs.ntendon,
        theirs.nexclude,
    )
    assert model.body_mass.sum() == pytest.approx(theirs.body_mass.sum())
    assert model.ngeom == np.count_nonzero(theirs.geom_contype | theirs.geom_conaffinity)
    for body in made.links:
        np.testing.assert_allclose(model.body(body).inertia, theirs.body(body).inertia)
    assert (model.nkey, model.nsensor, model.ncam, model.nlight) == (0, 0, 0, 0)


def test_a_hand_that_begins_at_the_palm_keeps_its_forearm_rigid(shared_assets: Path) -> None:
    hand = load_hand("shadow", urdf=shared_assets / "hands/shadow/shadow_right.urdf", base_link="palm", candidates=16)
    made = mjcf_model(hand, shared_assets / "hands/shadow_mjcf/right_hand.xml")
    assert_names(made.notes[0], "rh_WRJ2, rh_WRJ1", "fixed")
    assert made.notes[1:] == (CLIPPED,)
    assert made.root == "rh_forearm" and made.links["rh_palm"] == "palm" and made.links["rh_wrist"] == "rh_wrist"
    model = made.spec.compile()
    assert (model.nv, model.nu) == (22, 18)
    check_poses(hand, made, 1e-4)


def test_the_mjcf_of_another_hand_is_refused(shared_assets: Path) -> None:
    _, hand, _ = facts(shared_assets, "allegro")
    with refused(HandError, "allegro", hand.joint_names[0], "[mjcf_joints]"):
        mjcf_model(hand, facts(shared_assets, "leap")[2])


# --- a hand of our own


TREE = """<body name="{palm}" pos="1 2 3" euler="0 90 30">{root}
    <geom name="seen" size="0.02" contype="0" conaffinity="0" mass="0.3"/><geom size="0.01" mass="0.1"/>
    <body name="a1" pos="0.05 0 0.02" euler="0 0 22.918311805232932"><joint name="rh_a1_j" axis="0 {sign} 0"/>
      <geom size="0.01"/>
      <body name="a2" pos="0 0 {reach}"><joint name="rh_a2_j" axis="1 0 0"/><geom size="0.01"/>
        <body name="tip" pos="0 0 0.01"><geom size="0.01"/>{tip}</body></body></body>
    <body name="b1" pos="-0.05 0.03 0.02"><joint name="rh_b1_j" type="slide" axis="1 0 0"/><geom size="0.01"/></body>
  </body>"""

SERVOS = """<actuator><position name="p1" joint="rh_a1_j" kp="3"/><position name="p2" joint="rh_a2_j" kp="3"/>
  <position name="p3" joint="rh_b1_j" kp="3"/></actuator>"""


def ours(folder: Path, mimic: str = "", toml: str = "") -> Hand:
    turns = {"limits": (-1, 1.5), "effort": 3, "velocity": None}
    return made_hand(
        folder,
        links("palm", "a1", "a2", "b1"),
        joint("a1_j", "palm", "a1", at="0.05 0 0.02", rpy="0 0 0.4", axis="0 1 0", **turns),
        joint("a2_j", "a1", "a2", "revolute", mimic, at="0 0 0.04", axis="1 0 0", **turns),
        slide("b1_j", "palm", "b1", at="-0.05 0.03 0.02", axis="1 0 0", limits=(0, 0.03), effort=3, velocity=None),
        toml=toml,
    )


def written(
    folder: Path,
    *,
    palm: str = "palm",
    root: str = "",
    sign: int = 1,
    reach: float = 0.04,
    tip: str = "",
    world: str = "",
    rest: str = SERVOS,
) -> Path:
    path = folder / "hand.xml"
    tree = TREE.format(palm=palm, root=root, sign=sign, reach=reach, tip=tip)
    path.write_text(f"<mujoco><worldbody>{world}{tree}</worldbody>{rest}</mujoco>")
    return path


def test_pose_and_signs_are_found(tmp_path: Path) -> None:
    hand = ours(tmp_path)
    for sign in (1, -1):
        made = mjcf_model(hand, written(tmp_path, sign=sign))
        assert made.joints == ("rh_a1_j", "rh_a2_j", "rh_b1_j") and made.notes == ()
        np.testing.assert_array_equal(made.matrix, np.diag([sign, 1, 1]))
        np.testing.assert_allclose(made.T_base_root, np.eye(4), atol=1e-9)
        assert made.links == {"palm": "palm", "a1": "a1", "a2": "a2", "b1": "b1", "tip": "tip"}
        check_poses(hand, made, 1e-9)


def test_what_is_no_part_of_the_hand_is_left_out(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        root='<freejoint/><camera name="c"/>',
        world="""<geom type="plane" size="1 1 1"/><light/><body name="table"><geom size="1"/>
          <body name="leg"><geom size="1"/></body></body><body mocap="true" name="target"/>""",
        rest=SERVOS
        + '<equality><weld body1="target" body2="palm"/><weld body1="palm"/></equality>'
        + '<contact><exclude body1="leg" body2="a1"/><exclude body1="palm" body2="a2"/></contact>'
        + '<keyframe><key qpos="0 0 0 1 0 0 0 0 0 0"/></keyframe><sensor><jointpos joint="rh_a1_j"/></sensor>',
    )
    made = mjcf_model(ours(tmp_path), path)
    model = made.spec.compile()
    assert (model.nq, model.ngeom, model.nkey, model.nsensor, model.ncam, model.nlight) == (3, 5, 0, 0, 0, 0)
    (note,) = made.notes
    assert_names(note, "hand.xml", " 3 ")
    assert (model.neq, model.nexclude, model.nbody) == (0, 1, 6)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_array_equal([*data.body("palm").xpos, *data.body("palm").xquat], [0, 0, 0, 1, 0, 0, 0])
    # What is only seen has gone, its mass has not.
    assert model.body("palm").mass[0] == pytest.approx(0.4)
    expected = 0.4 * (0.3 * 0.02**2 + 0.1 * 0.01**2)
    np.testing.assert_allclose(model.body("palm").inertia, expected)


def test_joints_that_the_hand_lacks_are_fixed_with_what_moves_them(tmp_path: Path) -> None:
    more = """<tendon><fixed name="t"><joint joint="extra" coef="1"/><joint joint="rh_a1_j" coef="1"/></fixed></tendon>
      <equality><joint joint1="extra" joint2="rh_a2_j"/><tendon tendon1="t"/></equality>"""
    servos = SERVOS.replace(
        "</actuator>", '<position name="e" joint="extra"/><position name="f" tendon="t"/></actuator>'
    )
    made = mjcf_model(ours(tmp_path), written(tmp_path, tip='<joint name="extra"/>', rest=servos + more))
    model = made.spec.compile()
    assert (model.nv, model.nu, model.ntendon, model.neq) == (3, 3, 0, 0)
    (note,) = made.notes
    assert_names(note, " extra ", "fixed")


def test_without_actuators_the_hand_s_are_added(tmp_path: Path) -> None:
    hand = ours(
        tmp_path,
        toml="coupled = [{ joints = ['a1_j', 'a2_j'], ratio = [1, 0.5] }]\n"
        "actuator = { kp = { default = 4, b1_j = 6 }, force_limit = 2 }",
    )
    made = mjcf_model(hand, written(tmp_path, sign=-1, rest=""))
    (note,) = made.notes
    assert_names(note, "hand.xml", "actuators")
    model = made.spec.compile()
    assert [model.actuator(i).name for i in range(model.nu)] == ["rh_b1_j", "rh_a1_j+rh_a2_j"]
    data = mujoco.MjData(model)
    q = np.array([0.3, 0.2, 0.01])
    for name, value in zip(made.joints, made.matrix @ q, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.actuator_length, [0.01, 0.3 + 0.5 * 0.2], atol=1e-12)
    np.testing.assert_array_equal(model.actuator_forcerange, [[-2, 2], [-2, 2]])
    np.testing.assert_allclose(made.actuator.kp, hand.actuator.kp)
    np.testing.assert_allclose(made.actuator.force_limit, hand.actuator.force_limit)


def test_mimic_joints_follow_in_the_file_or_it_says_that_they_do_not(tmp_path: Path) -> None:
    hand = ours(tmp_path, '<mimic joint="a1_j" multiplier="-0.5" offset="0.2"/>')
    servos = SERVOS.replace('<position name="p2" joint="rh_a2_j" kp="3"/>', "")
    loose = mjcf_model(hand, written(tmp_path, rest=servos))
    (note,) = loose.notes
    assert_names(note, "a2_j", "hand.xml", "actuator", "equality")
    tie = '<equality><joint joint1="rh_a2_j" joint2="rh_a1_j" polycoef="0.2 -0.5 0 0 0"/></equality>'
    made = mjcf_model(hand, written(tmp_path, rest=servos + tie))
    assert made.notes == ()
    np.testing.assert_array_equal(made.matrix, [[1, 0], [-0.5, 0], [0, 1]])
    np.testing.assert_array_equal(made.offset, [0, 0.2, 0])
    check_poses(hand, made, 1e-9)


def test_a_mimic_joint_that_turns_the_other_way_has_its_offset_turned(tmp_path: Path) -> None:
    hand = ours(tmp_path, '<mimic joint="a1_j" multiplier="-0.5" offset="0.2"/>')
    path = written(tmp_path)
    path.write_text(path.read_text().replace('name="rh_a2_j" axis="1 0 0"', 'name="rh_a2_j" axis="-1 0 0"'))
    made = mjcf_model(hand, path)
    np.testing.assert_array_equal(made.matrix, [[1, 0], [0.5, 0], [0, 1]])
    np.testing.assert_array_equal(made.offset, [0, -0.2, 0])
    check_poses(hand, made, 1e-9)


@pytest.mark.parametrize(
    "said",
    [
        '<option timestep="0.01" cone="elliptic" impratio="7"><flag eulerdamp="disable"/></option>',
        '<size nuserdata="3" nuser_body="2" memory="1M"/>',
        '<size njmax="100" nconmax="50" nkey="2"/>',
        '<statistic meansize="3"/><visual><global fovy="30"/><quality shadowsize="64"/></visual>',
    ],
)
def test_a_hand_that_is_put_into_a_world_causes_no_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    made = mjcf_model(ours(tmp_path), written(tmp_path, rest=SERVOS + said))
    world = mujoco.MjSpec()
    world.option.timestep, world.nuserdata, world.stat.meansize, world.visual.global_.fovy = 0.004, 1, 0.1, 50
    world.attach(made.spec, prefix="hand/", frame=world.worldbody.add_frame())
    model = world.compile()
    assert model.opt.timestep == 0.004 and model.nu == 3 and model.nuserdata == 1
    assert not list(Path.cwd().iterdir()), "MuJoCo writes its warnings to a file in the current folder"


# --- how it is driven


def torques(hand: Hand, made: HandModel, q: np.ndarray, aim: np.ndarray) -> np.ndarray:
    """What the servos pull with at q when they are sent to `aim`, as torques at the joints of the hand."""
    model = made.spec.compile()
    data = mujoco.MjData(model)
    dof = [model.joint(name).dofadr[0] for name in made.joints]
    data.qpos[dof] = made.matrix @ q + made.offset
    data.ctrl = moments(model)[:, dof] @ (made.matrix @ aim + made.offset)
    mujoco.mj_forward(model, data)
    return made.matrix.T @ data.qfrc_actuator[dof]


def test_servos_pull_as_the_file_says_and_not_as_hand_toml(tmp_path: Path) -> None:
    """An MJCF with a weaker kp than hand.toml once squeezed with that share of the force that was asked for."""
    hand = ours(tmp_path, toml="actuator = { kp = 5, force_limit = 3 }")
    rest = """<actuator><general name="g" joint="rh_a2_j" gear="3" biastype="affine" gainprm="1" biasprm="0 -1 -0.2"
        forcerange="-0.1 0.2"/>
      <position name="s" joint="rh_a1_j" kp="0.25" ctrlrange="-9 9"/><position name="b" joint="rh_b1_j" kp="7"/>
    </actuator>"""
    path = written(tmp_path, sign=-1, rest=rest)
    path.write_text(
        path.read_text()
        .replace('name="rh_a1_j"', 'name="rh_a1_j" actuatorfrcrange="-1.5 1.5" damping="0.3" frictionloss="0.02"')
        .replace('name="rh_a2_j"', 'name="rh_a2_j" armature="0.001" damping="0.1"')
    )
    made = mjcf_model(hand, path)
    assert made.notes == (CLIPPED,)
    np.testing.assert_allclose(made.actuator.kp, [0.25, 9.0, 7.0])
    np.testing.assert_allclose(made.actuator.force_limit, [1.5, 0.6, np.inf])
    np.testing.assert_allclose(made.actuator.damping, [0.3, 0.1 + 9 * 0.2, 0.0])
    np.testing.assert_allclose(made.actuator.armature, [0.0, 0.001, 0.0])
    np.testing.assert_allclose(made.actuator.frictionloss, [0.02, 0.0, 0.0])
    wanted, q = np.array([0.7, 0.25, -3.0]), np.array([0.1, 0.2, 0.01])
    aim = q + set_point_offsets(replace(hand, actuator=made.actuator), wanted[None], q[None])[0]
    np.testing.assert_allclose(torques(hand, made, q, aim), wanted, atol=1e-9)
    asked = q + set_point_offsets(hand, wanted[None], q[None])[0]
    assert np.abs(torques(hand, made, q, asked) - wanted).max() > 0.5


def test_a_tendon_pulls_as_the_file_says_for_its_group(tmp_path: Path) -> None:
    """The tendon of the file is twice as long as the sum of ratio x joint value, and one joint turns the other way."""
    hand = ours(tmp_path, toml="coupled = [{ joints = ['a1_j', 'a2_j'], ratio = [1, 0.5] }]")
    rest = """<tendon><fixed name="t"><joint joint="rh_a1_j" coef="-2"/><joint joint="rh_a2_j" coef="1"/></fixed>
      </tendon><actuator><position tendon="t" kp="0.5" forcerange="-4 4"/><position joint="rh_b1_j" kp="7"/>
      </actuator>"""
    made = mjcf_model(hand, written(tmp_path, sign=-1, rest=rest))
    np.testing.assert_allclose(made.actuator.kp, [2.0, 2.0, 7.0])
    np.testing.assert_allclose(made.actuator.force_limit, [8.0, 8.0, np.inf])
    wanted, q = 1.2 * np.array([1.0, 0.5, 0.0]), np.array([0.1, 0.2, 0.01])
    aim = q + set_point_offsets(replace(hand, actuator=made.actuator), wanted[None], q[None])[0]
    np.testing.assert_allclose(torques(hand, made, q, aim), wanted, atol=1e-9)


SINGLE = """<actuator><general name="g" joint="rh_a2_j" gear="-3" biastype="affine" gainprm="1" biasprm="0 -1 0"
    ctrlrange="-1.5 1.2"/><position joint="rh_a1_j" kp="0.5" ctrlrange="-0.2 0.3"/>
    <position joint="rh_b1_j" kp="7"/></actuator>"""
TENDON = """<tendon><fixed name="t"><joint joint="rh_a1_j" coef="-2"/><joint joint="rh_a2_j" coef="1"/></fixed></tendon>
    <actuator><position tendon="t" kp="0.5" ctrlrange="-0.6 0.9" forcerange="-0.4 0.4"/>
    <position joint="rh_b1_j" kp="7"/></actuator>"""


@pytest.mark.parametrize("rest", [SINGLE, TENDON], ids=["single", "tendon"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_bounds_of_torques_are_what_actuators_make_of_the_farthest_set_points(
    tmp_path: Path, rest: str, side: float
) -> None:
    """Through gears, tendons and joints that turn the other way; MuJoCo clips controls to ctrlrange."""
    toml = "coupled = [{ joints = ['a1_j', 'a2_j'], ratio = [1, 0.5] }]" if rest is TENDON else ""
    hand = ours(tmp_path, toml=toml)
    made = mjcf_model(hand, written(tmp_path, sign=-1, rest=rest))
    driven, q = replace(hand, actuator=made.actuator), np.array([0.1, 0.2, 0.01])
    ratio = np.array([1.0, 0.5 if rest is TENDON else 1.0])
    bound = torque_bounds(driven, q)[int(side > 0)]
    found = torques(hand, made, q, q + side * 50.0 * np.array([1.0, ratio[1], 0.0]))
    np.testing.assert_allclose(found[:2], ratio * bound[:2], atol=1e-9)
    assert np.isinf(bound[2]) and (np.abs(bound[:2]) < 9.0).all()
    # A squeeze asks for no more than that.
    wanted = side * np.array([9.0, 9.0 * ratio[1], 0.0])
    asked = q + set_point_offsets(driven, wanted[None], q[None])[0]
    np.testing.assert_allclose(torques(hand, made, q, asked), found * [1, 1, 0], atol=1e-9)
    data = asked if rest is SINGLE else np.array([asked[:2] @ ratio] * 2 + [0.0])
    inside = made.actuator.set_points[:, int(side > 0)] * side - data * side
    assert (inside > -1e-9).all()


@pytest.mark.parametrize(
    "actuator",
    [
        *("motor", "velocity kv='0.01'", "general", "cylinder", "intvelocity kp='3' actrange='-1 1'", ""),
        "position kp='3' timeconst='0.1'",
        "general biastype='affine' gainprm='3' biasprm='0.5 -3 0'",
        "general biastype='affine' gainprm='3' biasprm='0 2 0'",
    ],
)
def test_servos_in_place_of_other_actuators_come_to_rest(tmp_path: Path, actuator: str) -> None:
    """Joints with motors often have no damping: with servos they swung for ever, and threw objects by metres."""
    hand, names = ours(tmp_path), ("a1", "a2", "b1")
    actuators = "".join(f"<{actuator} joint='rh_{name}_j'/>" for name in names) if actuator else ""
    made = mjcf_model(hand, written(tmp_path, rest=f"<actuator>{actuators}</actuator>"))
    assert_names(" ".join(made.notes), *([f"rh_{name}_j" for name in names] if actuator else ["no actuators"]))
    model = made.spec.compile()
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    model.opt.timestep, model.opt.integrator = 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    dof = [model.joint(f"rh_{name}_j").dofadr[0] for name in names]
    np.testing.assert_allclose(made.actuator.kp, hand.actuator.kp)
    np.testing.assert_allclose(made.actuator.force_limit, hand.actuator.force_limit)
    assert (model.dof_damping[dof] >= hand.actuator.damping).all()
    assert (model.dof_armature[dof] >= hand.actuator.armature).all()
    np.testing.assert_allclose(made.actuator.damping, model.dof_damping[dof])
    data.qvel[dof] = 5.0
    mujoco.mj_step(model, data, nstep=1000)
    assert np.abs(data.qvel[dof]).max() < 1e-3


def test_a_servo_whose_control_has_other_units_is_one_with_set_points(tmp_path: Path) -> None:
    """Menagerie's grippers have a control from 0 to 255: its force is gain x control - stiffness x length."""
    servo = '<general name="p1" joint="rh_a1_j" biastype="affine" gainprm="0.06" biasprm="0 -3 0" ctrlrange="0 255"/>'
    path = written(tmp_path, rest=SERVOS.replace('<position name="p1" joint="rh_a1_j" kp="3"/>', servo))
    made = mjcf_model(ours(tmp_path), path)
    model = made.spec.compile()
    at = model.actuator("p1").id
    assert model.actuator_gainprm[at, 0] == 3.0 and made.actuator.kp[0] == pytest.approx(3.0)
    np.testing.assert_allclose(model.actuator_ctrlrange[at], [0.0, 255 * 0.06 / 3.0])


def test_hand_toml_says_which_joint_is_which(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("rh_a1_j", "thumb").replace("rh_a2_j", "index"))
    with refused(HandError, "a1_j, a2_j", "thumb, index", "mjcf_joints"):
        mjcf_model(ours(tmp_path), path)
    made = mjcf_model(ours(tmp_path, toml="mjcf_joints = { a1_j = 'thumb', a2_j = 'index' }"), path)
    assert made.joints == ("thumb", "index", "rh_b1_j")
    with refused(HandError, "a1_j (tumb)"):
        mjcf_model(ours(tmp_path, toml="mjcf_joints = { a1_j = 'tumb', a2_j = 'index' }"), path)
    with refused(HandError, "'rh_b1_j'", "a1_j and b1_j"):
        mjcf_model(ours(tmp_path, toml="mjcf_joints = { a1_j = 'rh_b1_j', a2_j = 'index' }"), path)


def test_a_small_difference_is_reported_and_a_large_one_refused(tmp_path: Path) -> None:
    """Of a place by its millimetres, of an axis by its degrees."""
    hand = ours(tmp_path)
    (off,) = re.findall(r"(\d\.\d+) mm", mjcf_model(hand, written(tmp_path, reach=0.0406)).notes[0])
    assert 0.5 < float(off) < 1
    far, crooked = written(tmp_path, reach=0.05).read_text(), written(tmp_path).read_text()
    crooked = crooked.replace('name="rh_a2_j" axis="1 0 0"', 'name="rh_a2_j" axis="1 0 0.1"')
    for text, unit, most in ((far, "mm", 15), (crooked, "degrees", 6)):
        (tmp_path / "hand.xml").write_text(text)
        with refused(HandError, "'a2_j'", "2") as caught:
            mjcf_model(hand, tmp_path / "hand.xml")
        (off,) = re.findall(rf"(\d+\.\d\d) {unit}", str(caught.value))
        assert 2 < float(off) < most


def test_joints_on_one_line_are_aligned_by_their_axes(tmp_path: Path) -> None:
    def finger(first: str, second: str, reach: str) -> tuple[Hand, str]:
        limit = '<limit lower="-1" upper="1.5" effort="3"/>'
        (tmp_path / "hand.urdf").write_text(
            f'<robot name="r"><link name="p"/><link name="a"/><link name="b"/>'
            f'<joint name="1" type="revolute"><parent link="p"/><child link="a"/><axis xyz="{first}"/>{limit}</joint>'
            f'<joint name="2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 {reach}"/>'
            f'<axis xyz="{second}"/>{limit}</joint></robot>'
        )
        tree = f"""<mujoco><worldbody><body name="p" euler="40 50 60"><geom size="0.01"/><body name="a">
          <joint name="1" axis="{first}"/><geom size="0.01"/><body name="b" pos="0 0 {reach}">
          <joint name="2" axis="{second}"/><geom size="0.01"/></body></body></body></worldbody></mujoco>"""
        return load_hand(tmp_path / "hand.urdf", candidates=16), tree

    path = tmp_path / "hand.xml"
    for first, second, reach in (("1 0 0", "1 0 0", "0.04"), ("1 0 0", "0 1 0", "0.04"), ("1 0 0", "0 1 0", "0")):
        hand, tree = finger(first, second, reach)
        path.write_text(tree)
        made = mjcf_model(hand, path)
        np.testing.assert_allclose(made.matrix, np.eye(2))
        np.testing.assert_allclose(made.T_base_root, np.eye(4), atol=1e-9)
        check_poses(hand, made, 1e-9)
    hand, tree = finger("0 0 1", "0 0 1", "0.04")
    path.write_text(tree)
    with refused(HandError, "hand.xml", "joints", "line"):
        mjcf_model(hand, path)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (None, ("MJCF",)),
        ("{}", ("MuJoCo", "XML")),
        ('<!-- <mujoco> --><robot name="r"><link name="a"/></robot>', ("URDF", "MJCF")),
        ('<mujoco><worldbody><body foo="1"/></worldbody></mujoco>', ("'foo'",)),
        ("mesh", ("no.obj",)),
        ("<mujoco><worldbody><body/></worldbody></mujoco>", ("<worldbody>", "none")),
        (
            '<mujoco><worldbody><body name="a"><joint/></body><body><joint/></body></worldbody></mujoco>',
            ("<worldbody>", "'a', ''"),
        ),
        ('<mujoco><worldbody><body name="a"><freejoint/></body></worldbody></mujoco>', ("'a'", "free")),
    ],
)
def test_files_that_cannot_be_used_are_refused_in_one_line(
    tmp_path: Path, text: str | None, named: tuple[str, ...]
) -> None:
    hand, path = ours(tmp_path), tmp_path / "hand.xml"
    if text == "mesh":
        geom = '<geom type="mesh" mesh="m"/>'
        written(tmp_path, tip=geom, rest=SERVOS + '<asset><mesh name="m" file="no.obj"/></asset>')
    elif text is not None:
        path.write_text(text)
    with refused(HandError, "hand.xml", *named):
        mjcf_model(hand, path)
