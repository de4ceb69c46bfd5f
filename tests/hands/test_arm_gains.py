"""Gains of an arm that no file gives: by the inertia that each joint moves, and within its effort."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.hands.arm_gains import ARMATURE, BANDWIDTH_RAD_S, moved_inertia, with_arm_gains
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount, standing
from made_hands import inertial, joint, link, links, made_hand, slide, solid


@pytest.fixture(scope="module")
def gripper() -> Hand:
    """Return a hand of 0.76 kg."""
    return load_hand("franka_hand", candidates=16)


def arm(folder: Path, effort: float | None = 12, velocity: float | None = 2.4) -> Hand:
    """Return an arm of a slide and a hinge."""
    limits = {"limits": (-3, 3), "effort": effort, "velocity": velocity}
    return made_hand(
        folder,
        links("stand", "upper") + link("rod", inertial(2, (0.001, 0.06, 0.06), "0.3 0 0")),
        slide("lift", "stand", "upper", axis="0 0 1", limits=(0, 1), effort=90, velocity=0.5),
        joint("turn", "upper", "rod", at="0.1 0 0", rpy="0 0 1", axis="0 0 1", **limits),
        name="arm",
    )


def test_inertia_is_that_of_all_that_a_joint_moves(tmp_path: Path, gripper: Hand) -> None:
    """A slide moves masses; a hinge 0.06 + 2 x 0.3^2 kg m^2, and with a hand out at 0.6 m, what that has there."""
    alone = arm(tmp_path)
    np.testing.assert_allclose(moved_inertia(alone), [2.0, 0.06 + 2 * 0.3**2], rtol=1e-9)
    T = np.eye(4)
    T[0, 3] = 0.6
    mass = sum(link.mass or 0.0 for link in gripper.links)
    found = moved_inertia(mount(alone, gripper, "rod", T))
    np.testing.assert_allclose(found[0], 2.0 + mass, rtol=1e-9)
    assert abs(found[1] - (0.24 + mass * 0.6**2)) < 0.02


def test_inertia_of_turned_links_is_as_in_mujoco(tmp_path: Path) -> None:
    tool = inertial(2, (0.01, 0.02, 0.025), "0.03 -0.1 0.1")
    hand = made_hand(
        tmp_path,
        links("stand") + link("rod", inertial(1, (0.002, 0.01, 0.01), "0.2 0 0")) + link("tool", tool),
        joint("turn", "stand", "rod", at="0.1 0 0", rpy="0.2 0.1 1", axis="0 0.6 0.8", limits=(-3, 3)),
        joint("hold", "rod", "tool", "fixed", at="0.1 0.2 0.3", rpy="0.4 -0.3 0.8"),
        name="turned",
    )
    np.testing.assert_allclose(moved_inertia(hand), mujoco.MjModel.from_xml_path(str(hand.urdf)).dof_M0, rtol=1e-6)


def test_a_link_with_a_mass_alone_has_it_spread_over_its_shape(tmp_path: Path) -> None:
    """A box of 2 kg about its middle: m (a^2 + b^2) / 12."""
    bar = link("bar", '<inertial><mass value="2"/></inertial>' + solid("box 0.1 0.3 0.05"))
    hand = made_hand(tmp_path, links("stand") + bar, joint("turn", "stand", "bar", axis="0 0 1", limits=(-3, 3)))
    np.testing.assert_allclose(moved_inertia(hand), [2 / 12 * (0.1**2 + 0.3**2)], rtol=1e-9)


def test_damping_leaves_half_of_the_effort_at_half_speed(tmp_path: Path, gripper: Hand) -> None:
    """Before, 100 Nm s/rad took 120 Nm of a wrist of 12 Nm. Without an effort, it damps about critically."""
    whole = mount(arm(tmp_path), gripper, "rod")
    inertia = moved_inertia(whole)[:2] + np.array([ARMATURE / 0.1**2, ARMATURE])
    np.testing.assert_allclose(whole.actuator.kp[:2], inertia * BANDWIDTH_RAD_S**2)
    np.testing.assert_allclose(whole.actuator.damping[:2], [90 / 0.5, 12 / 2.4])
    np.testing.assert_array_equal(whole.actuator.kp[2:], gripper.actuator.kp)
    assert any("guessed" in note and "arm.toml" in note for note in whole.notes)
    strong = mount(arm(tmp_path, None, None), gripper, "rod")
    kp, damping = strong.actuator.kp[1], strong.actuator.damping[1]
    assert damping == pytest.approx(2 * np.sqrt(kp * (moved_inertia(strong)[1] + ARMATURE)))


def test_gains_of_a_file_are_kept(gripper: Hand) -> None:
    """Those of the UR5e, of a hand, and of one joint of which the file gives them."""
    ur5e = load_hand("ur5e", candidates=16)
    whole = mount(ur5e, gripper)
    np.testing.assert_array_equal(whole.actuator.kp[:6], ur5e.actuator.kp)
    assert not any("guessed" in note for note in whole.notes)
    one = replace(ur5e, actuator=replace(ur5e.actuator, kp=np.where(np.arange(6) == 2, 700.0, 5.0)))
    found = with_arm_gains(one, np.ones(6, dtype=bool)).actuator
    assert found.kp[2] == 700.0 and (np.delete(found.kp, 2) > 900.0).all()
    assert found.damping[2] == ur5e.actuator.damping[2]


def test_part_that_is_simulated_by_itself_has_the_gains_of_the_whole(tmp_path: Path, gripper: Hand) -> None:
    """An arm below a hand from an MJCF would else give way on the gains of fingers; so would one in a single file."""
    whole = mount(arm(tmp_path), gripper, "rod")
    np.testing.assert_array_equal(whole.parts[0].actuator.kp, whole.actuator.kp[:2])
    both = standing(arm(tmp_path), "rod")
    assert (both.actuator.kp > 1e3).all() and both.actuator.damping.tolist() == [180.0, 5.0]
