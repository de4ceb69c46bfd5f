"""Hands on arms: one tree of two robots, whose kinematics are those of both parts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adaptive_gripper import write_adaptive_gripper
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import exp_so3, inverse, matvec, transform
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount, standing
from grasp_refine.hands.self_collision import touching_pairs
from made_hands import joint, link, links, solid, write_urdf

DH = np.array(
    [
        [0.1625, 0.0, np.pi / 2],
        [0.0, -0.425, 0.0],
        [0.0, -0.3922, 0.0],
        [0.1333, 0.0, np.pi / 2],
        [0.0997, 0.0, -np.pi / 2],
        [0.0996, 0.0, 0.0],
    ]
)
"""Rows d, a, alpha of the maker's table of the UR5e."""

T_MOUNT = transform(exp_so3(np.array([0.3, -0.2, 0.9])), np.array([0.02, -0.01, 0.05]))


@pytest.fixture(scope="module")
def arm() -> Hand:
    """Return the arm that comes with the program."""
    return load_hand("ur5e", candidates=64)


@pytest.fixture(scope="module")
def hand() -> Hand:
    """Return a hand with names that the arm has, too."""
    return load_hand("allegro", candidates=64)


def random_q(hand: Hand, count: int, seed: int = 0) -> np.ndarray:
    """Return joint values (count, n) within the limits."""
    return np.random.default_rng(seed).uniform(hand.lower, hand.upper, (count, len(hand.lower)))


def test_flange_of_the_ur5e_is_where_the_makers_table_puts_it(arm: Hand) -> None:
    """T = prod Rz(q) Tz(d) Tx(a) Rx(alpha), in the maker's frame, which looks the other way than base_link."""
    q = random_q(arm, 20)
    x, _, z = np.eye(3)
    expected = np.tile(transform(exp_so3(np.pi * z), np.zeros(3)), (20, 1, 1))
    for column, (d, a, alpha) in zip(q.T, DH, strict=True):
        turn = transform(exp_so3(column[:, None] * z), np.zeros((20, 3)))
        expected = expected @ turn @ transform(exp_so3(alpha * x), np.array([a, 0.0, d]))
    found = Chain(arm, ["tool0"])(np.tile(np.eye(4), (20, 1, 1)), q).T_world_link[:, 0]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_hand_on_an_arm_moves_as_both_parts_do(arm: Hand, hand: Hand) -> None:
    """Poses of the hand's links are those of the hand alone, at the pose where the arm alone brings its base."""
    whole = mount(arm, hand, "tool0", T_MOUNT)
    q = random_q(whole, 5)
    base = np.tile(transform(exp_so3(np.array([0.1, 0.2, 0.3])), np.array([0.5, 0.0, 0.1])), (5, 1, 1))
    tips = [contact.link for contact in hand.contacts]
    T_flange = Chain(arm, ["tool0"])(base, q[:, :6]).T_world_link[:, 0]
    expected = Chain(hand, tips)(T_flange @ T_MOUNT, q[:, 6:]).T_world_link
    np.testing.assert_allclose(Chain(whole, tips)(base, q).T_world_link, expected, atol=1e-12)


def test_linkage_hand_on_an_arm_keeps_its_chains_modes_and_compliance(arm: Hand, tmp_path: Path) -> None:
    hand = load_hand(write_adaptive_gripper(tmp_path), candidates=64)
    whole = mount(arm, hand, "tool0", T_MOUNT)
    q, base, links = random_q(whole, 3), np.tile(np.eye(4), (3, 1, 1)), ["left_pad", "right_finger", "right_bar"]
    T_flange = Chain(arm, ["tool0"])(base, q[:, :6]).T_world_link[:, 0]
    expected = Chain(hand, links)(T_flange @ T_MOUNT, q[:, 6:]).T_world_link
    np.testing.assert_allclose(Chain(whole, links)(base, q).T_world_link, expected, atol=1e-12)
    assert hand.compliance is not None and hand.compliance[0] > 0.0
    np.testing.assert_array_equal(whole.compliance, [*np.zeros(6), *hand.compliance])
    np.testing.assert_allclose(whole.stiffness, [*arm.actuator.kp, *hand.stiffness])
    assert whole.modes == hand.modes and whole.yielding == hand.yielding
    apart = (("forearm_link", "wrist_3_link"),)
    assert whole.excluded == hand.excluded != ()
    assert mount(replace(arm, excluded=apart), hand, "tool0").excluded == (*apart, *hand.excluded)


def test_names_that_both_have_get_the_prefix_of_the_arm(arm: Hand, hand: Hand) -> None:
    """Files of the hand's grasps name its links, so that those keep their names."""
    whole = mount(arm, hand)
    assert whole.base_link == "ur5e_base_link" and whole.palm == hand.base_link == "base_link"
    assert whole.joint_names == (*arm.joint_names, *hand.joint_names)
    assert np.flatnonzero(whole.arm_joints).tolist() == list(range(len(arm.joint_names)))
    assert whole.arm is not None and whole.arm.links.isdisjoint(hand.links_by_name)
    assert whole.contacts == hand.contacts


def test_mujoco_places_the_links_of_a_hand_on_an_arm_where_we_do(arm: Hand, hand: Hand) -> None:
    """The model that is simulated, by another implementation of kinematics."""
    mujoco = pytest.importorskip("mujoco")
    from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model

    whole = mount(arm, hand, "tool0", T_MOUNT)
    made = urdf_model(whole)
    model = made.spec.compile()
    data = mujoco.MjData(model)
    q = random_q(whole, 1, seed=1)
    for name, value in zip(made.joints, made.matrix @ q[0] + made.offset, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    links = ["wrist_3_link", "base_link", *(contact.link for contact in whole.contacts)]
    T = Chain(whole, links)(np.eye(4)[None], q).T_world_link[0]
    for name, pose in zip(links, T, strict=True):
        np.testing.assert_allclose(data.body(name).xpos, pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)


def test_fingers_and_forearm_are_pairs_that_can_collide(arm: Hand, hand: Hand) -> None:
    """Self-collision is that of the whole: a fingertip reaches the forearm, the palm is a neighbour of the wrist."""
    whole = mount(arm, hand)
    pairs = {frozenset(pair) for pair in touching_pairs(whole)}
    tip = hand.contacts[0].link
    assert frozenset(("forearm_link", tip)) in pairs and frozenset(("wrist_3_link", "base_link")) not in pairs
    own = {frozenset(pair) for pair in touching_pairs(hand)}
    assert {pair for pair in pairs if pair <= set(hand.links_by_name)} == own


def test_flange_of_a_hand_toml_is_where_the_arm_takes_hold(arm: Hand, hand: Hand) -> None:
    """The Allegro hand's palm stands on the flange, not in it."""
    whole = mount(arm, hand)
    T = Chain(whole, ["tool0", "base_link"])(np.eye(4)[None], whole.rest[None]).T_world_link[0]
    np.testing.assert_allclose((inverse(T[0]) @ T[1])[:3, 3], [0.0, 0.0, 0.095], atol=1e-12)
    points = np.concatenate([piece.vertices for piece in hand.links_by_name["base_link"].solid.pieces])
    seen = matvec(inverse(T[0])[:3, :3] @ T[1][:3, :3], points) + (inverse(T[0]) @ T[1])[:3, 3]
    assert abs(seen[:, 2].min()) < 1e-3


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"link": "tool1"}, ("tool1", "tool0")),
        ({"link": "base"}, ("base",)),
        ({"T_link_hand": 2.0 * np.eye(4)}, ("T_link_hand", "2.")),
    ],
)
def test_what_cannot_be_mounted_is_refused(arm: Hand, hand: Hand, change: dict, named: tuple[str, ...]) -> None:
    """The message names the value, and the links that there are."""
    with pytest.raises(HandError) as error:
        mount(arm, hand, **change)
    assert all(part in str(error.value) for part in named)


def test_hand_on_an_arm_is_mounted_once(arm: Hand, hand: Hand) -> None:
    """An arm on an arm is refused."""
    with pytest.raises(HandError, match="allegro_on_ur5e"):
        mount(arm, mount(arm, hand))


ARM_AND_HAND = (
    links("stand", "upper"),
    link("palm", solid("box 0.1 0.1 0.02")),
    links("left", "right", inside=solid("box 0.02 0.02 0.1")),
    joint("lift", "stand", "upper", "prismatic", axis="0 0 1", limits=(0, 1), effort=9, velocity=0.5),
    joint("turn", "upper", "palm", axis="0 0 1", limits=(-3, 3), effort=9, velocity=2),
    joint("l", "palm", "left", at="0.04 0 0.06", axis="0 1 0", limits=(-1, 1)),
    joint("r", "palm", "right", at="-0.04 0 0.06", axis="0 1 0", limits=(-1, 1)),
)


def test_file_with_arm_and_hand_stands_on_the_base_of_its_arm(tmp_path: Path) -> None:
    """Joints above the palm are the arm's; without one, the message says how to give it."""
    file = write_urdf(tmp_path, *ARM_AND_HAND, name="both")
    whole = standing(load_hand(file, base_link="stand", candidates=16))
    assert whole.palm == "palm" and dict(zip(whole.joint_names, whole.arm_joints.tolist(), strict=True)) == {
        "lift": True, "turn": True, "l": False, "r": False
    }  # fmt: skip
    assert whole.joints_by_name["lift"].velocity == 0.5
    assert whole.arm is not None and whole.arm.links == {"stand", "upper"}
    with pytest.raises(HandError, match="`arm`"):
        standing(load_hand(file, candidates=16))
    # An arm with the gains of fingers would give way.
    assert (whole.actuator.kp[:2] > 1e3).all() and whole.actuator.kp[2:].tolist() == [5.0, 5.0]


def test_root_twist_and_arm_joint_agree_where_they_are_the_same_motion(arm: Hand, hand: Hand) -> None:
    """Turning the base about its z moves every link as the first joint does."""
    whole = mount(arm, hand)
    chain = Chain(whole, ["wrist_3_link", hand.contacts[1].link])
    q = random_q(whole, 1, seed=5)
    turned = integrate(np.eye(4)[None], np.array([[0, 0, 0, 0, 0, 0.2]]))
    step = np.zeros_like(q)
    step[:, 0] = 0.2
    a, b = chain(turned, q).T_world_link, chain(np.eye(4)[None], q + step).T_world_link
    np.testing.assert_allclose(a, b, atol=1e-12)


def test_set_points_end_where_both_parts_end(arm: Hand, hand: Hand) -> None:
    ends = np.stack([hand.lower, hand.upper], axis=1)
    limited = replace(hand, actuator=replace(hand.actuator, set_points=ends))
    both = mount(arm, limited, "tool0").actuator
    np.testing.assert_array_equal(both.kp, np.concatenate([arm.actuator.kp, hand.actuator.kp]))
    np.testing.assert_array_equal(both.set_points[: len(arm.lower)], np.tile([-np.inf, np.inf], (len(arm.lower), 1)))
    np.testing.assert_array_equal(both.set_points[len(arm.lower) :], ends)
    assert (
        mount(arm, replace(hand, actuator=replace(hand.actuator, set_points=None)), "tool0").actuator.set_points is None
    )
