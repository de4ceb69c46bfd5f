"""The MuJoCo model of a URDF hand: it moves, weighs, collides and pulls as the hand says."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece, box
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.urdf_model import Parts, excluded_pairs, urdf_model
from made_hands import BALL, link, made_hand

SHARED = ("allegro", "robotiq3f", "shadow", "leap", "barrett")
"""Hands in the shared assets."""

LIMIT = '<limit lower="-1" upper="2" effort="3"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT, z: float = 0.05) -> str:
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
      <origin xyz="0.01 0 {z}" rpy="0.2 -0.3 0.1"/><axis xyz="0 1 0.5"/>{inside}</joint>"""


def follow(name: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'{LIMIT}<mimic joint="{name}" multiplier="{multiplier}" offset="{offset}"/>'


def weight(mass: float, ixx: float, iyy: float, izz: float) -> str:
    return f"""<inertial><origin xyz="0.01 0.02 0.03" rpy="0 0 0.5"/><mass value="{mass}"/>
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>"""


def build(folder: Path, links: dict[str, str], *joints: str, toml: str = "") -> Hand:
    return made_hand(folder, *(link(name, inside) for name, inside in links.items()), *joints, toml=toml)


def placed(made: HandModel, model: mujoco.MjModel, hand: Hand, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, value in zip(made.joints, made.matrix @ q + made.offset, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(model, data)
    return data


def check_poses(hand: Hand) -> None:
    """The bodies are where `Kinematics` has the links, at random joint values."""
    made = urdf_model(hand)
    model = made.spec.compile()
    assert set(made.links.values()) == {link.name for link in hand.links} and made.root == model.body(1).name
    names = list(made.links.values())
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(hand.lower, -3), np.minimum(hand.upper, 3), (5, len(hand.lower)))
    T = Kinematics(hand, names)(torch.eye(4, dtype=torch.float64).expand(5, 4, 4), torch.tensor(q)).numpy()
    for row, values in enumerate(q):
        data = placed(made, model, hand, values)
        for column, body in enumerate(made.links):
            np.testing.assert_allclose(data.body(body).xpos, T[row, column, :3, 3], atol=1e-6)
            np.testing.assert_allclose(data.body(body).xmat.reshape(3, 3), T[row, column, :3, :3], atol=1e-6)


@pytest.mark.parametrize("name", SHARED)
def test_hands_of_others_compile_and_move_as_they_should(name: str, shared_assets: Path) -> None:
    (path,) = (shared_assets / "hands" / name).glob("*.urdf")
    hand = load_hand(path, candidates=16)
    check_poses(hand)
    repaired = [note for note in urdf_model(hand).notes if "balanced" in note or "far outside" in note]
    assert bool(repaired) == (name in ("allegro", "robotiq3f"))


def test_our_hand_needs_no_repair() -> None:
    hand = load_hand("allegro", candidates=16)
    check_poses(hand)
    assert urdf_model(hand).notes == ()


@pytest.fixture
def chain(tmp_path: Path) -> Hand:
    """Joints of every kind: c follows b follows a; s slides; f is fixed; l is locked, and m follows it."""
    locked = '<limit lower="0.4" upper="0.4" effort="1"/>'
    return build(
        tmp_path,
        {"world": BALL, **dict.fromkeys("bcdefghi", BALL)},
        joint("c", "world", "b", inside=follow("b", 3, 0.5)),
        joint("b", "b", "c", inside=follow("a", -0.2, 0.25)),
        joint("f", "c", "d", "fixed", ""),
        joint("a", "d", "e"),
        joint("s", "e", "f", "prismatic", '<limit lower="0" upper="0.02" effort="1"/>'),
        joint("l", "f", "g", inside=locked),
        joint("m", "g", "h", inside=follow("l", 2, 0.1)),
        joint("t", "h", "i", "continuous", ""),
        toml="actuator = { kp = {default = 2, a = 7}, force_limit = { t = 0 }, damping = 0.3, armature = 0.001, "
        "frictionloss = { s = 0.5 } }",
    )


def test_mimic_chains_slides_and_locked_joints_move_as_they_should(chain: Hand) -> None:
    # A locked joint is at its only value.
    chain = replace(chain, lower=chain.lower.copy(), upper=chain.upper.copy())
    made = urdf_model(chain)
    assert made.joints == ("c", "b", "a", "s", "t") and chain.joint_names == ("a", "s", "l", "t")
    np.testing.assert_allclose(made.matrix, [[-0.6, 0, 0, 0], [-0.2, 0, 0, 0], *np.eye(4)[[0, 1, 3]]])
    np.testing.assert_allclose(made.offset, [1.25, 0.25, 0, 0, 0])
    check_poses(chain)


def test_a_link_may_be_called_world(chain: Hand) -> None:
    made = urdf_model(chain)
    assert made.root == "world_link" and made.links["world_link"] == "world" and made.links["b"] == "b"
    np.testing.assert_array_equal(made.T_base_root, np.eye(4))


def test_joints_have_the_limits_and_the_drive_of_the_hand(chain: Hand) -> None:
    model = urdf_model(chain).spec.compile()
    limits = {name: (bool(model.joint(name).limited[0]), *model.joint(name).range) for name in "cbast"}
    assert limits["a"] == (True, -1, 2) and limits["s"] == (True, 0, 0.02)
    assert not any(limits[name][0] for name in "cbt"), "a mimic joint has no limits of its own"
    for name in "cbast":
        at = model.joint(name)
        assert (at.damping[0], at.armature[0]) == (0.3, 0.001)
        assert at.frictionloss[0] == {"s": 0.5, "a": 0.01, "t": 0.01}.get(name, 0)
    drive = {model.actuator(i).name: model.actuator(i) for i in range(model.nu)}
    assert set(drive) == {"a", "s", "t"}
    for name, kp in (("a", 7), ("s", 2), ("t", 0)):
        np.testing.assert_array_equal(drive[name].gainprm[:3], [kp, 0, 0])
        np.testing.assert_array_equal(drive[name].biasprm[:3], [0, -kp, 0])
    np.testing.assert_array_equal(drive["a"].forcerange, [-3, 3])


def test_no_known_force_limit_is_none(tmp_path: Path) -> None:
    hand = build(tmp_path, {"a": BALL, "b": BALL}, joint("j", "a", "b", inside='<limit lower="0" upper="1"/>'))
    assert np.isinf(hand.actuator.force_limit[0])
    assert not urdf_model(hand).spec.compile().actuator_forcelimited[0]


def test_mimic_joints_follow_in_simulation(tmp_path: Path) -> None:
    hand = build(
        tmp_path,
        {"a": BALL, "b": BALL, "c": BALL},
        joint("1", "a", "b"),
        joint("2", "b", "c", inside=follow("1", -0.5, 0.25)),
    )
    made = urdf_model(hand)
    made.spec.option.timestep, made.spec.option.gravity = 0.004, [0, 0, 0]
    made.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = made.spec.compile()
    data = placed(made, model, hand, np.zeros(1))
    data.ctrl = 1.0

    def error() -> float:
        return abs(data.joint("2").qpos[0] - (0.25 - 0.5 * data.joint("1").qpos[0]))

    worst = 0.0
    for _ in range(500):
        mujoco.mj_step(model, data)
        worst = max(worst, error())
    assert worst < 4e-3, "the leader jumps by 1 rad with its greatest torque"
    assert data.joint("1").qpos[0] == pytest.approx(1, abs=0.01) and error() < 1e-9
    data.joint("2").qfrc_applied = 1.0
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert error() < 1e-3, "a torque of 1 Nm does not tear them apart"
    # Half of the torque reaches the leader, against a servo of 5 Nm/rad.
    assert data.joint("1").qpos[0] == pytest.approx(1 - 0.5 / 5, abs=3e-3)


def test_a_coupled_group_pulls_with_one_tendon(tmp_path: Path) -> None:
    hand = build(
        tmp_path,
        dict.fromkeys("abcd", BALL),
        joint("1", "a", "b"),
        joint("2", "b", "c"),
        joint("3", "c", "d"),
        toml="coupled = [{ joints = ['3', '2'], ratio = [1, -0.5] }]\nactuator = { kp = { 3 = 8 } }",
    )
    made = urdf_model(hand)
    model = made.spec.compile()
    assert [model.actuator(i).name for i in range(model.nu)] == ["1", "3+2"]
    assert model.actuator("3+2").gainprm[0] == 8 and model.actuator("3+2").forcerange.tolist() == [-3, 3]
    data = placed(made, model, hand, np.array([0.3, 0.2, 0.7]))
    np.testing.assert_allclose(data.actuator_length, [0.3, 0.7 - 0.5 * 0.2])
    data.ctrl = data.actuator_length + [0, 0.1]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [0, -0.5 * 0.8, 0.8], atol=1e-12)


# --- masses


def inertia_of(model: mujoco.MjModel, name: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and moments in the frame of the body."""
    body = model.body(name)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    turn = turn.reshape(3, 3)
    return body.mass[0], body.ipos, turn @ np.diag(body.inertia) @ turn.T


def test_masses_are_as_in_the_urdf(tmp_path: Path) -> None:
    hand = build(tmp_path, {"a": weight(1, 1, 1, 1), "b": weight(0.2, 2e-5, 3e-5, 4e-5)}, joint("j", "a", "b"))
    made = urdf_model(hand)
    assert made.notes == ()
    mass, centre, moments = inertia_of(made.spec.compile(), "b")
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert mass == 0.2
    np.testing.assert_allclose(centre, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(moments, turn @ np.diag([2e-5, 3e-5, 4e-5]) @ turn.T, atol=1e-16)


BALL_MASS = 1000 * 4 / 3 * np.pi * 0.01**3


OF_BALL = [0.4 * 1e-4] * 3
"""Moments of a ball of 1 cm over its mass."""


@pytest.mark.parametrize(
    ("link", "note", "mass", "moments"),
    [
        (weight(0.2, 1e-5, 2e-5, 7e-5), "triangle inequality", 0.2, [1.5e-4, 2e-4, 3.5e-4]),
        (BALL, "gives no mass", BALL_MASS, OF_BALL),
        (weight(0, 1, 1, 1) + BALL, "gives no mass", BALL_MASS, OF_BALL),
        (weight(0.03, 0, 0, 0) + BALL, "none above 0", 0.03, OF_BALL),
        ('<inertial><mass value="0.5"/></inertial>', "none above 0", 0.5, OF_BALL),
        (weight(0.12, 1e-5, 1e-5, 1e-5) + BALL, "denser than steel", 0.12, [1e-5 / 0.12] * 3),
        (weight(0.03, 1, 1, 1) + BALL, "far outside", 0.03, OF_BALL),
        ("", "1 g assumed", 1e-3, [1e-3] * 3),
    ],
)
def test_masses_that_cannot_be_are_repaired(
    tmp_path: Path, link: str, note: str, mass: float, moments: list[float]
) -> None:
    """One note says so; moments are over the mass."""
    hand = build(tmp_path, {"a": weight(1, 1, 1, 1), "b": link}, joint("j", "a", "b"))
    made = urdf_model(hand)
    (found,) = made.notes
    body = made.spec.compile().body("b")
    assert note in found and body.mass[0] == pytest.approx(mass)
    np.testing.assert_allclose(np.sort(body.inertia) / mass, moments, rtol=1e-6)


def test_what_is_fixed_to_a_link_weighs_for_it(tmp_path: Path) -> None:
    links = {"a": "", "b": "", "c": weight(0.2, 2e-5, 3e-5, 4e-5), "d": ""}
    hand = build(
        tmp_path, links, joint("j", "a", "b"), joint("f", "b", "c", "fixed", ""), joint("g", "a", "d", "fixed", "")
    )
    made = urdf_model(hand)
    assert made.notes == ("1 g assumed, as the URDF gives neither mass nor geometry: a",)
    model = made.spec.compile()
    assert [model.body(name).mass[0] for name in "abcd"] == [1e-3, 0, 0.2, 0]


# --- collisions


def may_meet(model: mujoco.MjModel) -> set[frozenset[str]]:
    """Names of the bodies whose geoms MuJoCo lets collide, once the root is free."""
    excluded = {int(signature) for signature in model.exclude_signature}
    weld, parents = model.body_weldid, model.body_parentid
    met = set()
    for a, b in combinations(range(1, model.nbody), 2):
        solid = model.body_geomnum[a] and model.body_geomnum[b]
        mounts = weld[parents[weld[a]]] == weld[b] or weld[parents[weld[b]]] == weld[a]
        if solid and weld[a] != weld[b] and not mounts and (a << 16) + b not in excluded:
            met.add(frozenset((model.body(a).name, model.body(b).name)))
    return met


def test_links_meet_where_they_can() -> None:
    hand = load_hand("allegro", candidates=16)
    made = urdf_model(hand)
    made.spec.body(made.root).add_freejoint()
    assert may_meet(made.spec.compile()) == {frozenset(pair) for pair in touching_pairs(hand)}


def test_what_is_fixed_to_a_neighbour_is_a_neighbour(tmp_path: Path) -> None:
    hand = build(tmp_path, dict.fromkeys("abc", BALL), joint("j", "a", "b"), joint("f", "a", "c", "fixed", ""))
    assert excluded_pairs(hand, Parts.by_joints(hand)) == []


def test_geometry_is_where_the_pieces_are() -> None:
    hand = load_hand("allegro", candidates=16)
    made = urdf_model(hand)
    model = made.spec.compile()
    data = placed(made, model, hand, np.zeros(len(hand.joint_names)))
    for body, name in made.links.items():
        link = hand.links_by_name[name]
        first, count = model.body(body).geomadr[0], model.body(body).geomnum[0]
        assert count == (len(link.body.pieces) if link.body else 0)
        for geom, piece in zip(range(first, first + count), link.body.pieces if link.body else (), strict=True):
            if len(piece.vertices) <= 2:
                assert model.geom_size[geom, 0] == pytest.approx(piece.radius)
                continue
            start = model.mesh_vertadr[model.geom_dataid[geom]]
            corners = model.mesh_vert[start : start + model.mesh_vertnum[model.geom_dataid[geom]]]
            world = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            local = (world - data.body(body).xpos) @ data.body(body).xmat.reshape(3, 3)
            gap = np.linalg.norm(piece.vertices[:, None] - local, axis=-1)
            assert gap.min(axis=1).max() < 1e-7 and gap.min(axis=0).max() < 1e-7


def reshaped(hand: Hand, *pieces: Piece) -> Hand:
    links = [replace(link, body=build_body(link.name, pieces, candidates=16)) for link in hand.links]
    return replace(hand, links=tuple(links))


def test_a_rounded_polytope_becomes_a_polyhedron_and_says_so(tmp_path: Path) -> None:
    light = weight(0.01, 1e-6, 1e-6, 1e-6)
    hand = build(tmp_path, {"a": light, "b": light}, joint("j", "a", "b"))
    sharp = box([0.02, 0.02, 0.02])
    made = urdf_model(reshaped(hand, Piece(sharp.vertices, sharp.faces, 0.005)))
    assert made.notes == ("rounded edges of a, b are polyhedra in the simulation",)
    model = made.spec.compile()
    np.testing.assert_allclose(model.mesh_vert.max(0) - model.mesh_vert.min(0), 0.03, atol=1e-5)
