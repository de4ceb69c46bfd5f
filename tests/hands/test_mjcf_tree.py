"""An MJCF as a hand: its links, joints, geometry, couplings and actuators are those of MuJoCo."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import inverse, transform
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.visuals import load_visuals
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.self_collision import candidate_pairs, touching_pairs
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.validate import model_of
from refusals import assert_names, refused

PUBLISHED = {
    "shadow_mjcf/right_hand.xml": ("rh_palm", 22, 18),
    "shadow_mjcf/right_hand_22dof_dgb.xml": ("rh_palm", 22, 18),
    "leap_mjcf/right_hand.xml": ("leap_mount", 16, 16),
    "allegro_mjcf/right_hand.xml": ("palm", 16, 16),
}
"""File -> base link, independent joints, actuators."""

PROBE_M = 0.004
"""Radius of the sphere whose distances are compared."""

FINGER = """<mujoco><worldbody>
  <body name="{name}2" pos="0.01 0 0.05" euler="0.2 0 0.1">
    <joint name="{name}2" axis="0 1 1" range="-0.5 1" class="knuckle"/><joint name="{name}3" axis="1 0 0" pos="0 0.01 0"
      ref="0.3" range="-0.4 1.1"/><geom type="ellipsoid" size="0.01 0.012 0.02"/>
    <body name="{name}4" pos="0 0 0.04"><joint name="{name}4" type="slide" axis="0 1 2" ref="0.01" range="0 0.03"/>
      <geom type="box" size="0.008 0.006 0.012" pos="0 0.002 0.01" euler="0 0.3 0"/>
      <body name="{name}5" pos="0 0 0.03"><joint name="{name}5" axis="1 0 0" range="-3 3"/>
        <geom type="mesh" mesh="wedge" pos="0.001 0 0.01" euler="1 0 0"/></body></body></body>
</worldbody></mujoco>"""

HAND = """<mujoco model="awkward"><compiler angle="radian" meshdir="meshes" autolimits="true"/>
  <default><default class="knuckle"><joint pos="0.003 0 -0.002" ref="-0.2" damping="0.3"/></default>
    <default class="seen"><geom contype="0" conaffinity="0" group="2" rgba="1 0 0 1"/></default></default>
  <asset><mesh name="wedge" file="wedge.obj" scale="0.5 0.5 0.5"/><mesh name="open" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>
    <texture name="t" type="2d" file="not_there.png"/><material name="m" texture="t" rgba="0 1 0 1"/></asset>
  <worldbody><geom name="floor" type="plane" size="1 1 1"/><light pos="0 0 1"/>
    <body name="thing" pos="1 0 0"><freejoint/><geom size="0.1"/></body>
    <body name="mount" pos="0.3 0.2 0.1" euler="0.3 0.2 0.1"><freejoint/><geom size="0.02"/>
      <body name="wrist" pos="0 0 0.02"><joint name="w" axis="0 0 1" pos="0.01 0 0" ref="0.2" range="-1 1"/>
        <geom type="cylinder" size="0.02 0.01"/>
        <body name="palm" pos="0 0 0.03" euler="0 0 0.4"><geom type="box" size="0.04 0.03 0.01"/>
          <geom class="seen" type="mesh" mesh="wedge"/><geom class="seen" material="m" size="0.01"/>
          <body name="a1" pos="0.02 0 0.02"><joint name="a1" axis="0 1 0" range="-1 1.5"/>
            <geom type="capsule" size="0.008" fromto="0 0 0 0.01 0 0.04"/>{a}</body>
          <body name="b1" pos="-0.03 0.01 0.02"><joint name="b1" axis="0 1 0" range="-1.5 1"/>
            <geom type="sphere" size="0.01"/>{b}</body>
          <frame pos="0 0.02 0" euler="0 0 1"><body name="c1"><joint name="c1" axis="1 0 0"/>
            <geom type="capsule" size="0.007 0.01"/></body></frame>
        </body></body></body></worldbody>
  <contact><exclude body1="a1" body2="b1"/><pair geom1="floor" geom2="floor"/></contact>
  <equality><joint joint1="b5" joint2="b4" polycoef="0.1 20 0 0 0"/></equality>
  <tendon><fixed name="pull"><joint joint="a4" coef="30"/><joint joint="a5" coef="1"/></fixed></tendon>
  <actuator><position name="pull" tendon="pull" kp="7" forcerange="-2 2"/><position joint="a1" kp="3"/>
    <position joint="c1" kp="2" gear="2" forcerange="-5 4"/></actuator></mujoco>"""


def awkward(folder: Path) -> Path:
    """A hand of an arm's wrist in a scene, with all that a MuJoCo joint can be; fingers are in files of their own."""
    (folder / "meshes").mkdir()
    (folder / "meshes" / "wedge.obj").write_text(
        "v 0 0 0\nv 0.04 0 0\nv 0 0.02 0\nv 0 0 0.06\nv 0.04 0 0.06\n"
        "f 1 3 2\nf 1 2 4\nf 2 5 4\nf 1 4 3\nf 2 3 5\nf 3 4 5\n"
    )
    fingers = {}
    for name in "ab":
        text = FINGER.format(name=name).replace("<mujoco><worldbody>", "<mujocoinclude>")
        (folder / f"{name}.xml").write_text(text.replace("</worldbody></mujoco>", "</mujocoinclude>"))
        fingers[name] = f'<include file="{name}.xml"/>'
    path = folder / "hand.xml"
    path.write_text(HAND.format(**fingers))
    return path


@pytest.fixture
def file(request: pytest.FixtureRequest, tmp_path: Path, shared_assets: Path) -> Path:
    return awkward(tmp_path) if request.param == "awkward" else shared_assets / "hands" / request.param


EVERY = pytest.mark.parametrize("file", ["awkward", *PUBLISHED], indirect=True)


def configurations(hand: Hand, count: int) -> np.ndarray:
    lower, upper = np.where(np.isinf(hand.lower), -4, hand.lower), np.where(np.isinf(hand.upper), 4, hand.upper)
    return np.random.default_rng(1).uniform(lower, upper, (count, len(lower)))


def placed(model: mujoco.MjModel, hand: Hand, q: np.ndarray) -> mujoco.MjData:
    """MuJoCo's kinematics of the hand's joints at q, all others at their reference."""
    data = mujoco.MjData(model)
    matrix, offset, names = hand.mimic_map()
    for name, value in zip(names, matrix @ q + offset, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    return data


def textless(path: Path) -> mujoco.MjSpec:
    """The file as MuJoCo reads it; a missing texture is left out."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    return spec


def pose(data: mujoco.MjData, body: str) -> np.ndarray:
    return transform(data.body(body).xmat.reshape(3, 3).copy(), data.body(body).xpos.copy())


@EVERY
def test_links_are_where_mujoco_has_the_bodies(file: Path) -> None:
    hand = load_hand(file, candidates=16)
    model = textless(file).compile()
    bodies = [link.name for link in hand.links if ":" not in link.name]
    assert len(bodies) >= 10
    chain = Chain(hand, bodies)
    for q in configurations(hand, 20):
        data = placed(model, hand, q)
        T_base = inverse(pose(data, hand.base_link))
        ours = chain(np.eye(4)[None], q[None]).T_world_link[0]
        for name, T in zip(bodies, ours, strict=True):
            np.testing.assert_allclose(T, T_base @ pose(data, name), atol=1e-9, err_msg=name)


@EVERY
def test_geometry_is_as_far_away_as_mujoco_has_it(file: Path) -> None:
    hand = load_hand(file, candidates=16)
    spec = textless(file)
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", size=[PROBE_M, 0, 0])
    model = spec.compile()
    geom = model.geom("probe").id
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    links = [link for link in hand.links if link.body is not None]
    chain = Chain(hand, [link.name for link in links])
    ball = build_body("probe", (sphere(PROBE_M),), candidates=1)
    table = Pairs(tuple(link.solid for link in links), (ball,) * len(links))
    rng = np.random.default_rng(2)
    compared = 0
    for q in configurations(hand, 5):
        data = placed(model, hand, q)
        base = pose(data, hand.base_link)
        T = base @ chain(np.eye(4)[None], q[None]).T_world_link[0]
        for _ in range(12):
            near = links[rng.integers(len(links))]
            at = pose(data, near.name)[:3, 3] + rng.uniform(-0.05, 0.05, 3)
            data.mocap_pos[0] = at
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            there = transform(np.eye(3), at)
            ours = query(table, T[None], np.tile(there, (1, len(links), 1, 1))).distance[0]
            for link, distance in zip(links, ours, strict=True):
                own = np.flatnonzero(solid & (model.geom_bodyid == model.body(link.name).id))
                theirs = min(mujoco.mj_geomDistance(model, data, i, geom, 1.0, None) for i in own)
                if theirs > 1e-3:
                    # Round geoms are inscribed polyhedra: a cylinder within 0.05 % of its radius, an ellipsoid 0.4 %.
                    assert distance == pytest.approx(theirs, abs=1.5e-4 if "ellipsoid" in kinds(model, own) else 3e-5)
                    compared += 1
    assert compared > 300


def kinds(model: mujoco.MjModel, geoms: np.ndarray) -> set[str]:
    return {mujoco.mjtGeom(model.geom_type[i]).name.removeprefix("mjGEOM_").lower() for i in geoms}


@pytest.mark.parametrize(("file", "facts"), PUBLISHED.items(), indirect=["file"])
def test_published_hands_are_read(file: Path, facts: tuple[str, int, int]) -> None:
    hand = load_hand(file, candidates=16)
    base, joints, actuators = facts
    assert (hand.base_link, len(hand.joint_names), hand.mjcf, hand.collision) == (base, joints, file, "mjcf")
    assert {contact.group for contact in hand.contacts} >= {"index", "middle", "ring", "thumb"}
    # It is simulated as it is, with the very servos that squeezes are planned for.
    made = model_of(hand)
    np.testing.assert_array_equal(made.matrix, np.eye(joints))
    assert made.spec.compile().nu == actuators and not made.offset.any()
    for name in ("kp", "force_limit", "damping", "armature", "frictionloss"):
        np.testing.assert_allclose(getattr(made.actuator, name), getattr(hand.actuator, name), err_msg=name)
    assert len(hand.joint_names) - sum(len(group.joints) - 1 for group in hand.coupled) == actuators
    masses = mujoco.MjModel.from_xml_path(str(file))
    for link in hand.links:
        assert link.mass == pytest.approx(masses.body(link.name).mass[0])
        np.testing.assert_allclose(link.inertia.principal()[0][::-1], masses.body(link.name).inertia, rtol=1e-6)


def test_what_a_file_says_becomes_the_hand(tmp_path: Path) -> None:
    hand = load_hand(awkward(tmp_path), candidates=16)
    assert hand.base_link == "palm"
    text = " ".join(hand.notes)
    assert_names(text, "palm", "w", "2 things", "'b5' follows 'b4'", "a4 + a5")
    joints = hand.joints_by_name
    assert "w" not in joints and joints["c1"].kind == "continuous" and joints["a4"].kind == "prismatic"
    # b5 - 0 = 0.1 + 20 (b4 - 0.01): within its own limits of 3 rad, b4 moves through its whole range.
    assert (joints["b5"].mimic.multiplier, joints["b5"].mimic.offset) == pytest.approx((20, 0.1 - 0.2))
    assert [(group.joints, group.ratio) for group in hand.coupled] == [(("a4", "a5"), (1.0, pytest.approx(1 / 30)))]
    row = {name: i for i, name in enumerate(hand.joint_names)}
    actuator = hand.actuator
    assert actuator.kp[[row["a1"], row["c1"], row["a4"]]] == pytest.approx([3, 8, 7 * 30**2])
    assert actuator.force_limit[[row["c1"], row["a4"]]] == pytest.approx([10, 60])
    assert actuator.damping[row["a2"]] == pytest.approx(0.3)
    assert hand.excluded == (("a1", "b1"),)
    assert not {frozenset(("a1", "b1"))} & {frozenset(pair) for pair in candidate_pairs(hand)}
    # Of the palm, one geom collides; two more are seen, a mesh and one in the colour of its material.
    assert len(hand.links_by_name["palm"].solid.pieces) == 1
    seen = [visual for visual in load_visuals(hand.urdf, ["palm"]) if visual.color is not None]
    assert [visual.color for visual in seen if visual.color[:2] in ((1, 0), (0, 1))] == [(1, 0, 0), (0, 1, 0)]


def test_the_simulated_hand_moves_as_it_does(tmp_path: Path) -> None:
    hand = load_hand(awkward(tmp_path), candidates=16)
    made = mjcf_model(hand, hand.urdf)
    model = made.spec.compile()
    data = mujoco.MjData(model)
    chain = Chain(hand, [name for name in made.links.values() if name in hand.links_by_name])
    for q in configurations(hand, 10):
        for name, value in zip(made.joints, made.matrix @ q + made.offset, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        T_base = inverse(pose(data, made.root) @ inverse(made.T_base_root))
        for name, T in zip(chain.links, chain(np.eye(4)[None], q[None]).T_world_link[0], strict=True):
            np.testing.assert_allclose(T, T_base @ pose(data, name), atol=1e-9, err_msg=name)


def test_motors_become_servos_with_their_torque(tmp_path: Path) -> None:
    path = awkward(tmp_path)
    servo = '<position joint="a1" kp="3"/>'
    path.write_text(path.read_text().replace(servo, '<motor joint="a1" gear="4" ctrlrange="-0.5 0.5"/>'))
    hand = load_hand(path, candidates=16)
    i = hand.joint_names.index("a1")
    assert hand.actuator.force_limit[i] == 2 and hand.actuator.kp[i] > 0
    made = mjcf_model(hand, path)
    assert_names(" ".join(made.notes), "servos")
    assert made.actuator.force_limit[i] == 2 and made.actuator.kp[i] == hand.actuator.kp[i]


BODY = '<mujoco>{}<worldbody><body name="p"><geom size="0.01"/>{}</body>{}</worldbody></mujoco>'
JOINT = '<body name="a"><joint name="j" range="-1 1"/><geom size="0.01"/></body>'


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (BODY.format("", JOINT.replace('range="-1 1"', 'type="ball"'), ""), ("'j'", "ball")),
        (BODY.format("", JOINT.replace('range="-1 1"', 'type="slide"'), ""), ("'j'", "prismatic", "limits")),
        (BODY.format("", JOINT, JOINT.replace('"a"', '"b"').replace('"j"', '"k"')), ("'p', 'b'",)),
        (BODY.format("", JOINT, "").replace("<geom", '<geom contype="0" conaffinity="0"'), ("contype", "conaffinity")),
        (BODY.format('<include file="hand.xml"/>', JOINT, ""), ("hand.xml", "included")),
        (BODY.format('<include file="none.xml"/>', JOINT, ""), ("none.xml",)),
        (BODY.format('<extension><plugin plugin="x.y"/></extension>', JOINT, ""), ("<extension>", "plugins")),
        (BODY.format("", 2 * '<replicate count="40">' + JOINT + 2 * "</replicate>", ""), ("1600",)),
        (BODY.format("", JOINT + '<geom type="mesh" mesh="m"/>', "").replace("<world", '<asset><mesh name="m" '
         'file="no.obj"/></asset><world'), ("no.obj",)),
        (BODY.format("", "<freejoint/>", ""), ("'p'", "free")),
        ("<mujoco><worldbody/></mujoco>", ("<worldbody>", "none")),
        ("<mujoco><nothing/></mujoco>", ("nothing",)),
        ("<package/>", ("<package>",)),
        ("<mujocoinclude/>", ("part", "include")),
        # MuJoCo reads a sign, spaces and an exponent.
        (BODY.format("", '<replicate count="+1000000">' + JOINT + "</replicate>", ""), ("1000000",)),
        (BODY.format("", '<replicate count=" 1e6">' + JOINT + "</replicate>", ""), ("1000000",)),
        # Other readers stop at what that of MuJoCo passes over.
        (BODY.format("", JOINT + '<site name="&zz;"/><replicate count="1000000"/>', ""), ("zz",)),
        (BODY.format("", JOINT + '<site name="<!--"/><replicate count="1000000"/><site name="-->"/>', ""), ("XML",)),
        (BODY.format("", JOINT, "") + "<mujoco/>", ("XML",)),
        (BODY.format("", JOINT, "<body/>" * 1001), ("1003", "1000")),
        # As many numbers as no memory holds.
        (BODY.format('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', JOINT, ""),
         ("4 GiB",)),
        (BODY.format('<size nuser_body="1000000000"/>', JOINT, ""), ("4 GiB",)),
        (BODY.format("", JOINT + '<inertial pos="0 -inf 0" mass="1" diaginertia="1 1 1"/>', ""), ("finite",)),
        (BODY.format('<asset><model name="m" file="/etc/passwd"/></asset>', JOINT, ""), ("<model>", "passwd")),
        (BODY.format('<include file="../hand.txt"/>', JOINT, ""), ("hand.txt",)),
        ("{}", ("XML",)),
    ],
)  # fmt: skip
def test_files_that_are_no_hand_are_refused(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(text)
    with refused(HandError, "hand.xml", *named):
        load_hand(path, candidates=16)


def test_an_object_with_joints_beside_the_hand_is_left_out(tmp_path: Path) -> None:
    """As in Gymnasium's scenes, where it hangs from the world by three slides and three hinges."""
    joints = "".join(f'<joint name="o{axis}" type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    two = JOINT.replace("</body>", JOINT.replace('"a"', '"b"').replace('"j"', '"k"') + "</body>")
    path = tmp_path / "hand.xml"
    path.write_text(BODY.format("", two, f'<body name="thing">{joints}<geom size="0.01"/></body>'))
    hand = load_hand(path, candidates=16)
    assert hand.joint_names == ("j", "k") and hand.base_link == "p"
    assert "thing" not in hand.links_by_name


@pytest.mark.parametrize(
    ("compiler", "span", "told"),
    [("", "-1 1.5", True), ("", "-1 90", False), ('<compiler angle="radian"/>', "-1 1.5", False)],
)
def test_limits_in_degrees_that_look_like_radians_are_reported(
    tmp_path: Path, compiler: str, span: str, told: bool
) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(BODY.format(compiler, JOINT.replace("-1 1", span), ""))
    notes = [note for note in load_hand(path, candidates=16).notes if "radian" in note]
    assert bool(notes) == told
    if told:
        assert_names(notes[0], "hand.xml", "1.5", 'angle="radian"')


def test_links_that_overlap_at_rest_are_kept_apart_unless_the_file_excludes_them(tmp_path: Path) -> None:
    """MuJoCo pushes apart what an MJCF does not exclude."""
    finger = """<body name="{0}" pos="0 {1} 0"><joint name="{0}" axis="0 1 0" range="-1.5 1.5"/>
      <geom type="capsule" size="0.01" fromto="0 0 0.05 0 0 0.1"/></body>"""
    fingers = finger.format("a", -0.009) + finger.format("b", 0.009)
    palm = f'<body name="palm"><geom size="0.005"/>{fingers}</body>'
    text = f'<mujoco><compiler angle="radian"/><worldbody>{palm}</worldbody>{{}}</mujoco>'
    path = tmp_path / "hand.xml"
    path.write_text(text.format(""))
    hand = load_hand(path, candidates=16)
    assert touching_pairs(hand, cache=None) == (("a", "b"),)
    path.write_text(text.format('<contact><exclude body1="b" body2="a"/></contact>'))
    assert touching_pairs(load_hand(path, candidates=16), cache=None) == ()


SMALL = """<mujoco><compiler angle="radian" meshdir="meshes"/><asset><mesh name="b" file="b.obj"/></asset><worldbody>
  <body name="palm"><geom type="mesh" mesh="b"/><include file="finger.xml"/></body></worldbody></mujoco>"""
"""A hand of a mesh and an included finger."""


def small(folder: Path, name: str) -> Path:
    (folder / "meshes").mkdir()
    (folder / "meshes/b.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    body = """<body name="f"><joint name="j" axis="0 1 0" range="-1 1"/><geom size=".01" pos="0 0 .15"/></body>"""
    (folder / "finger.xml").write_text(f"<mujocoinclude>{body}</mujocoinclude>")
    path = folder / name
    path.write_text(SMALL)
    return path


@pytest.mark.parametrize("name", ["hand.mjcf", "hand.XML", "hand"])
def test_the_suffix_of_an_mjcf_does_not_matter(tmp_path: Path, name: str) -> None:
    """MuJoCo goes by the suffix .xml; published hands are named .mjcf."""
    hand = load_hand(small(tmp_path, name), candidates=16)
    assert hand.joint_names == ("j",) and [link.name for link in hand.links] == ["palm", "f"]
    assert hand.links_by_name["palm"].solid.diagonal > 0.1
    assert model_of(hand).spec.compile().ngeom == 2


def test_a_mesh_that_is_a_git_lfs_pointer_is_named_as_one(tmp_path: Path) -> None:
    path = small(tmp_path, "hand.xml")
    (tmp_path / "meshes/b.obj").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n")
    with refused(HandError, "b.obj", "git lfs pull"):
        load_hand(path, candidates=16)
