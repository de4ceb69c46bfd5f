"""Modes in which linkages yield: motions of five-bar linkages, what springs and limits hold, and their compliance."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptive_gripper import BAR_M, PIVOT_M, SPRING_NM_PER_RAD, SPRING_RAD, adaptive_gripper, write_adaptive_gripper
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.linkages.linkages import CLOSED_M, Linkage, linkages
from grasp_refine.hands.linkages.transmission import transmission_compliance

DRIVER = "right_driver"


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return load_hand(write_adaptive_gripper(tmp_path_factory.mktemp("adaptive")), candidates=512)


def solved(text: str) -> tuple[mujoco.MjModel, Linkage]:
    model = mujoco.MjSpec.from_string(text).compile()
    (found,) = linkages(model, {DRIVER, "left_driver"}).linkages
    return model, found


def test_a_finger_turns_about_where_its_bars_meet(hand: Hand) -> None:
    """Each end of a link moves across the bar that carries it (Burmester 1888), at the rate of that bar."""
    by_joint = {mode.joint: mode for mode in hand.modes}
    assert set(by_joint) == {"right_bar", "left_bar"}, "each finger has a mode of its own"
    model, linkage = solved(adaptive_gripper())
    assert linkage.gap < CLOSED_M
    assert np.abs(linkage.coefficients["right_coupler"]).max() < 1e-3, "the spring presses it against its limit"
    data = mujoco.MjData(model)
    for side in ("left", "right"):
        mode = by_joint[f"{side}_bar"]
        assert set(mode.twists) == {f"{side}_{part}" for part in ("bar", "coupler", "finger", "pad")}
        for value in (0.0, 0.11, 0.37, 0.5):
            linkage.place(model, data, value)
            finger, coupler, bar = (data.body(f"{side}_{part}") for part in ("finger", "coupler", "bar"))
            twist = mode.twist(f"{side}_finger", np.array([value]))[0]
            R = finger.xmat.reshape(3, 3)
            v, w = R @ twist[:3], R @ twist[3:]
            anchor = R @ np.array([0.02, 0.0, 0.0])
            assert abs(v @ (finger.xpos - bar.xpos)) < 2e-6 and np.linalg.norm(v) == pytest.approx(
                np.hypot(*BAR_M), rel=1e-3
            )
            assert abs((v + np.cross(w, anchor)) @ (finger.xpos + anchor - coupler.xpos)) < 2e-5


def test_springs_hold_what_limits_do_not(hand: Hand) -> None:
    """A finger that is turned by less than the bound of its mode stays; by more, it gives way, in MuJoCo."""
    (mode,) = [mode for mode in hand.modes if mode.joint == "right_bar"]
    q = np.array([0.25])
    least, greatest = (bound[0] for bound in mode.bounds(q))
    assert greatest == np.inf and least == pytest.approx(-SPRING_NM_PER_RAD * (SPRING_RAD + q[0]), rel=1e-3)
    softer = mode.bounds(q, 0.1)
    assert softer[0][0] == pytest.approx(least - 0.1 * SPRING_NM_PER_RAD) and softer[1][0] == np.inf
    model, linkage = solved(adaptive_gripper())
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_GRAVITY
    model.dof_armature[model.joint(DRIVER).dofadr] = model.dof_armature[model.joint("left_driver").dofadr] = 1e3
    off_limit = {}
    for share in (0.5, 2.0):
        data = mujoco.MjData(model)
        linkage.place(model, data, q[0])
        data.ctrl[:] = q[0]
        # The object makes the torque that is opposite to that of the hand.
        data.qfrc_applied[model.joint("right_bar").dofadr] = -share * least
        mujoco.mj_step(model, data, nstep=100)
        off_limit[share] = data.joint("right_coupler").qpos[0]
    assert off_limit[0.5] < 0.0 and off_limit[2.0] > 0.1


def test_slopes_are_as_in_the_twists(hand: Hand) -> None:
    mode, q, h = hand.modes[0], np.array([0.112, 0.333]), 1e-5
    for link in mode.twists:
        differences = (mode.twist(link, q + h) - mode.twist(link, q - h)) / (2 * h)
        np.testing.assert_allclose(mode.slope(link, q), differences, atol=1e-8)


def test_compliance_is_in_series_with_the_actuator(hand: Hand) -> None:
    assert hand.compliance is not None
    compliance = float(hand.compliance[0])
    assert 0.002 < compliance < 0.05
    assert hand.stiffness[0] == pytest.approx(1.0 / (1.0 / hand.actuator.kp[0] + compliance))
    softer, linkage = solved(adaptive_gripper(solref="0.02 1"))
    assert transmission_compliance(softer, linkage, ["right_pad", "left_pad"]) > 2.0 * compliance
    assert transmission_compliance(softer, linkage, ["palm"]) == 0.0


def test_hands_without_closed_chains_have_none(tmp_path: Path) -> None:
    file = tmp_path / "finger.xml"
    file.write_text(
        """<mujoco><worldbody><body name="palm"><geom size="0.03"/><body name="finger" pos="0.05 0 0">
        <joint name="bend" axis="0 1 0" range="0 90"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.05"/>
        </body></body></worldbody><actuator><position joint="bend" kp="3"/></actuator></mujoco>"""
    )
    plain = load_hand(file, candidates=64)
    assert not plain.modes and plain.compliance is None
    np.testing.assert_array_equal(plain.stiffness, plain.actuator.kp)


@pytest.mark.parametrize("longer", [-1e-7, 0.0, 1e-7])
@pytest.mark.parametrize("side", ["right", "left"])
def test_modes_come_in_the_order_of_the_file(side: str, longer: float) -> None:
    """They came as left, right and as right, left from two files that differed in a number."""
    x = (1 if side == "right" else -1) * PIVOT_M[0]
    there = f'<body name="{side}_bar" pos="{x} 0'
    text = adaptive_gripper()
    assert there in text
    _, linkage = solved(text.replace(there, f'<body name="{side}_bar" pos="{x + longer} 0'))
    assert [mode.joint for mode in linkage.modes] == ["right_bar", "left_bar"]
