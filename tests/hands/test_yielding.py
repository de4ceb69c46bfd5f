"""Modes in which linkages yield: motions of five-bar linkages, what springs and limits hold, and their compliance."""

import mujoco
import numpy as np
import pytest

import linkage_gripper
from adaptive_gripper import BAR_M, PIVOT_M, SPRING_NM_PER_RAD, SPRING_RAD, adaptive_gripper, write_adaptive_gripper
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.linkages.linkages import CLOSED_M, Linkage, linkages
from grasp_refine.hands.linkages.transmission import TIMESTEP_S, transmission_compliance
from grasp_refine.hands.linkages.yielding import YieldingMode

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


def test_bounds_are_between_those_at_known_values_and_give_way_with_the_springs() -> None:
    """Where a limit holds at one of two values, the bound is the spring's torque at the other."""
    least, greatest = np.array([-1.0, -3.0, -np.inf]), np.array([np.inf, 2.0, 4.0])
    stiffness = np.array([10.0, 20.0, 60.0])
    mode = YieldingMode("spring", "drive", np.array([0.0, 1.0, 3.0]), {}, least, greatest, stiffness)
    at = np.array([0.0, 0.5, 1.0, 2.0, 9.0])
    np.testing.assert_allclose(mode.bounds(at), [[-1.0, -2.0, -3.0, -3.0, -3.0], [2.0, 2.0, 2.0, 3.0, 4.0]])
    more = 0.1 * np.array([10.0, 15.0, 20.0, 40.0, 60.0])
    np.testing.assert_allclose(mode.bounds(at, 0.1), mode.bounds(at) + np.array([-1.0, 1.0])[:, None] * more)


def test_compliance_is_in_series_with_the_actuator(hand: Hand) -> None:
    assert hand.compliance is not None
    assert hand.stiffness[0] == pytest.approx(1.0 / (1.0 / hand.actuator.kp[0] + hand.compliance[0]))


@pytest.mark.parametrize("seconds", [0.008, 0.012])
def test_compliance_is_the_work_of_soft_equalities(seconds: float) -> None:
    """In statics an equality of MuJoCo gives way by its force times R / (k d); the driven joint stands still."""
    soft = f'solref="{seconds} 1" solimp="0.99 0.99 0.001"'
    model = mujoco.MjSpec.from_string(linkage_gripper.XML.replace(linkage_gripper.STIFF, soft)).compile()
    (linkage,) = linkages(model, {"right_driver_joint", "left_driver_joint"}).linkages
    model.opt.timestep, data = TIMESTEP_S, mujoco.MjData(model)
    linkage.place(model, data, 0.5 * sum(linkage.range))
    mujoco.mj_forward(model, data)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    J = data.efc_J.reshape(-1, model.nv)[rows]
    give = (data.efc_R / (data.efc_KBIP[:, 0] * data.efc_KBIP[:, 2]))[rows]
    drive = model.joint("right_driver_joint").dofadr[0]
    passive = np.arange(model.nv) != drive
    # How all joints move with the driven one.
    rate = np.linalg.lstsq(J[:, passive], -J[:, drive], rcond=None)[0]
    jacobian, force, torque = np.zeros((3, model.nv)), np.zeros(model.nv), 0.0
    for side in ("right", "left"):
        mujoco.mj_jacBodyCom(model, data, jacobian, None, model.body(f"{side}_finger").id)
        way = jacobian[:, passive] @ rate + jacobian[:, drive]
        force += way @ jacobian / np.linalg.norm(way)
        torque += np.linalg.norm(way)
    held = np.linalg.lstsq(J[:, passive].T, force[passive], rcond=None)[0]
    expected = (give * held**2).sum() / torque**2
    tips = ["right_finger", "left_finger"]
    assert transmission_compliance(model, linkage, tips) == pytest.approx(expected, rel=0.05)
    assert transmission_compliance(model, linkage, ["palm"]) == 0.0


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
