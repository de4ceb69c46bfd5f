"""Linkages: passive joints follow the driven one as the law of cosines says, exactly where a chain may not open."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.hands.linkages.linkages import linkages
from grasp_refine.hands.linkages.yielding import YieldingMode
from grasp_refine.objects.object import load_object
from grasp_refine.problem.facade import refine, simulate
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import links_of
from grasp_refine.validation.validate import model_of
from linkage_gripper import DRIVER_M, FINGER_M, INNER_M, PIVOTS_M, XML, passive_angles, write_gripper
from made_hands import BALL, joint, link, made_hand

DRIVEN = {"right_driver_joint", "left_driver_joint"}


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return load_hand(write_gripper(tmp_path_factory.mktemp("linkage")), candidates=512)


def model_of_text(text: str) -> mujoco.MjModel:
    return mujoco.MjSpec.from_string(text).compile()


def test_passive_joints_follow_as_the_law_of_cosines_says() -> None:
    (found,) = linkages(model_of_text(XML), DRIVEN).linkages
    assert found.driver == "right_driver_joint" and found.range == pytest.approx((0.0, 0.9)) and found.gap < 2e-6
    assert set(found.coefficients) == {
        f"{side}_{part}_joint" for side in ("left", "right") for part in ("finger", "inner")
    }
    q = np.linspace(0.0, 0.9, 50)
    finger, inner = passive_angles(q)
    assert np.abs(finger + q).max() > 0.01, "no parallelogram, whose fingers would not turn"
    for side in ("left", "right"):
        for part, expected in (("finger", finger), ("inner", inner)):
            values = np.polynomial.polynomial.polyval(q, found.coefficients[f"{side}_{part}_joint"])
            np.testing.assert_allclose(values, expected, atol=5e-5)


def test_a_chain_without_a_drive_stays_open_and_is_reported() -> None:
    found = linkages(model_of_text(XML), set())
    assert not found.linkages and "right_inner_joint" in found.open[0] and "driven" in found.open[0]
    none = linkages(
        model_of_text('<mujoco><worldbody><body name="a"><geom size="1"/></body></worldbody></mujoco>'), set()
    )
    assert none.linkages == none.open == ()


def test_links_that_only_a_spring_holds_hold_no_object_but_fingertips(hand: Hand) -> None:
    """A push at them moves them while the driven joint stands still: no force of the grasp may rely on them."""
    assert not linkages(model_of_text(XML), DRIVEN).linkages[0].modes and not hand.yielding
    prepared = HandObject(hand, load_object("sphere:0.01", candidates=64))
    T = prepared.chain(np.eye(4)[None], hand.rest[None]).T_world_link
    found_near = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
    near = replace(found_near, distance=np.full(found_near.distance.shape, 0.001))
    links = links_of(hand)
    none = np.zeros(2)
    twists = {name: np.zeros((2, 6)) for name in ("right_finger", "right_inner")}
    mode = YieldingMode("right_finger_joint", hand.joint_names[0], np.arange(2.0), twists, none, none, none)
    weak = replace(hand, modes=(mode,))
    # Fingertips may hold; nothing presses a palm that carries two fingers.
    for given, idle in ((hand, {"palm"}), (weak, {"palm", "right_inner"})):
        touches = ContactSelection().choose(given, links, near)[0]
        assert {link for link, one in zip(links, touches, strict=True) if not one} == idle


def test_a_range_over_which_the_chain_cannot_close_is_left_out() -> None:
    """The bars reach each other up to some value of a driver that could turn on."""
    text = XML.replace('range="0 0.9"', 'range="0 2.6"').replace('range="-1.6 1.6"', 'range="-1.2 1.2"')
    (found,) = linkages(model_of_text(text), DRIVEN).linkages
    assert 0.9 < found.range[1] < 1.6 and found.gap < 1e-4


def test_it_is_a_hand_of_one_joint(hand: Hand) -> None:
    assert hand.joint_names == ("right_driver_joint",) and (hand.lower, hand.upper) == (0.0, 0.9)
    assert [contact.link for contact in hand.contacts] == ["right_finger", "left_finger"], "inner bars close the chains"
    note = next(note for note in hand.notes if "closed chains" in note)
    assert "right_finger_joint" in note and "mm" in note
    # The servo of the file, with its control from 0 to 255, acts on both drivers at half.
    assert hand.actuator.kp == pytest.approx(50.0) and hand.actuator.force_limit == pytest.approx(5.0)


LINKS = ("right_inner", "right_finger", "left_inner", "left_finger")


def worst_gap(hand: Hand) -> float:
    """Largest distance in metres between the ends of a chain over the range of the drive."""
    q = np.linspace(hand.lower, hand.upper, 40)
    T = Chain(hand, LINKS)(np.tile(np.eye(4), (40, 1, 1)), q).T_world_link
    gaps = []
    for row, sign in ((0, 1.0), (2, -1.0)):
        tip = transform_points(T[:, row], np.array([sign * INNER_M[0], 0.0, INNER_M[1]]))
        ends = transform_points(T[:, row + 1], np.array([[-FINGER_M * sign, 0.0, 0.0]]))
        gaps.append(np.linalg.norm(tip - ends, axis=1).max())
    return max(gaps)


def test_chains_of_the_hand_are_closed(hand: Hand) -> None:
    assert worst_gap(hand) < 1e-5
    q = np.linspace(hand.lower, hand.upper, 5)
    T = Chain(hand, LINKS)(np.tile(np.eye(4), (5, 1, 1)), q).T_world_link
    torch_T = Kinematics(hand, LINKS)(torch.eye(4, dtype=torch.float64).repeat(5, 1, 1), torch.as_tensor(q))
    np.testing.assert_allclose(torch_T.numpy(), T, atol=1e-12)


def test_the_jacobian_is_that_of_the_curves(hand: Hand) -> None:
    links = ("right_finger", "left_inner", "right_driver")
    chain, q = Chain(hand, links), np.array([[0.1], [0.45], [0.8]])
    T = np.tile(np.eye(4), (3, 1, 1))
    frames = chain(T, q)
    point, force = np.array([0.01, 0.02, 0.05]), np.array([0.3, -0.2, 0.9])
    covector = np.broadcast_to(np.concatenate([force, np.cross(point, force)]), (3, 3, 6))
    found = chain.to_joint_space(frames, covector, np.arange(3))
    for column in range(7):
        ends = []
        for step in (1e-6, -1e-6):
            dx = step * np.eye(7)[column]
            moved = chain(integrate(T, np.tile(dx[:6], (3, 1))), q + dx[6:]).T_world_link
            # The point is fixed to each link.
            local = np.linalg.solve(frames.T_world_link, np.append(point, 1.0)[None, None, :, None])
            ends.append((moved @ local)[..., :3, 0] @ force)
        np.testing.assert_allclose(found[..., column], (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_mujoco_settles_where_the_curves_say(hand: Hand) -> None:
    """Driven by its own servo, its chains closed by its own equalities."""
    made = model_of(hand)
    model = made.spec.compile()
    assert made.curves is not None and not any("follow nothing" in note for note in made.notes)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    at = [int(model.joint(name).qposadr[0]) for name in made.joints]
    for value in (0.2, 0.7):
        q = np.array([value])
        data.qpos[at] = made.matrix @ q + made.offset + made.curves(q)
        data.ctrl[:] = value
        for _ in range(500):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(data.qpos[at], made.matrix @ q + made.offset + made.curves(q), atol=2e-3)


def test_its_jaws_are_nearly_parallel(hand: Hand) -> None:
    jaws = jaw_frame(hand, closure_frame(hand))
    assert jaws is not None and jaws.groups == ("right_finger", "left_finger")
    assert 0.085 < jaws.width[0] < 0.095 and jaws.width[-1] < 0.025 and np.abs(jaws.axis[0]) > 0.999


@pytest.mark.slow
def test_it_grasps_refines_and_holds(hand: Hand) -> None:
    obj = load_object("box:0.04,0.05,0.1", candidates=512)
    grasps = sample_grasps(hand, obj, 3)
    refined = refine(hand, obj, grasps)
    assert (refined.status == "converged").sum() >= 2
    assert simulate(refined).held[:, 1].sum() >= 2


def test_a_urdf_whose_axes_point_the_other_way_keeps_the_chains_closed(tmp_path: Path) -> None:
    """The drive turns backwards there, and so does one finger."""
    write_gripper(tmp_path)
    parts = [link("palm", BALL)]
    for side, sign in (("right", 1), ("left", -1)):
        driver, inner = PIVOTS_M
        for part, parent, (x, z), way in (
            ("driver", "palm", driver, -1), ("finger", f"{side}_driver", DRIVER_M, -sign), ("inner", "palm", inner, 1),
        ):  # fmt: skip
            name, turn = f"{side}_{part}", -sign * way
            limits = (-0.9, 0.0) if part == "driver" else (-1.6, 1.6)
            hinge = joint(
                f"{name}_joint", parent, name, at=(sign * x, 0, z), axis=(0, turn, 0), limits=limits, effort=5
            )
            parts += [link(name, BALL), hinge]
    hand = made_hand(tmp_path, *parts, name="linkage", toml='mjcf = "linkage.xml"')
    assert hand.joint_names == ("right_driver_joint",) and (hand.lower[0], hand.upper[0]) == pytest.approx((-0.9, 0.0))
    assert worst_gap(hand) < 1e-5
