"""Couplings that an MJCF tells: tendons of actuators become groups, joint equalities mimic joints."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.hands.hand import Coupled, Hand, Mimic, load_hand
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from made_hands import joint, links, made_hand, write_urdf
from refusals import assert_names

WIDE = {"limits": (-2, 2), "effort": 3, "velocity": None}
PARTS = (
    links("palm", "a1", "a2", "a3", "b1"),
    joint("A1", "palm", "a1", at="0.05 0 0.02", axis="0 1 0", **WIDE),
    joint("A2", "a1", "a2", at="0 0 0.04", axis="0 1 0", **WIDE),
    joint("A3", "a2", "a3", at="0 0 0.04", axis="0 1 0", **WIDE),
    joint("B1", "palm", "b1", at="-0.05 0.03 0.02", axis="1 0 0", **WIDE),
)

MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.01"/>
  <body name="a1" pos="0.05 0 0.02" euler="0 {turn} 0"><joint name="rh_A1" axis="0 {first} 0" ref="{ref}"/>
    <geom size="0.01"/>
    <body name="a2" pos="0 0 0.04"><joint name="rh_A2" axis="0 {sign} 0"/><geom size="0.01"/>
      <body name="a3" pos="0 0 0.04"><joint name="rh_A3" axis="0 1 0"/><geom size="0.01"/></body></body></body>
  <body name="b1" pos="-0.05 0.03 0.02"><joint name="rh_B1" axis="1 0 0"/><geom size="0.01"/></body>
  </body></worldbody>{parts}</mujoco>"""

TENDON = """<tendon><fixed name="pull"><joint joint="rh_A2" coef="{}"/><joint joint="rh_A3" coef="{}"/></fixed></tendon>
  <actuator><position name="first" joint="rh_A1" kp="3"/><position name="pull" tendon="pull" kp="3"/>
  <position name="other" joint="rh_B1" kp="3"/>{}</actuator>"""


def loaded(folder: Path, parts: str, *, sign: int = 1, first: int = 1, ref: float = 0.0, toml: str = "") -> Hand:
    """The hand of `PARTS` with an MJCF, in which A2 turns by `sign` x and A1 by `first` x as much."""
    text = MJCF.format(parts=parts, sign=sign, first=first, ref=ref, turn=first * ref)
    (folder / "r.xml").write_text(text)
    return made_hand(folder, *PARTS, name="r", toml=f'mjcf = "r.xml"\n{toml}')


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tendon_of_an_actuator_is_a_group_in_the_signs_of_the_urdf(tmp_path: Path, sign: int) -> None:
    hand = loaded(tmp_path, TENDON.format(2.0, 3.0, ""), sign=sign)
    assert hand.coupled == (Coupled(("A2", "A3"), (1.0, 1.5 * sign)),)
    assert_names(" ".join(hand.notes), "A2 + A3", "r.xml")
    # The actuator's torques on both joints are in that ratio.
    model = mjcf_model(hand, tmp_path / "r.xml")
    compiled = model.spec.compile()
    data = mujoco.MjData(compiled)
    data.ctrl[compiled.actuator("pull").id] = 0.1
    mujoco.mj_forward(compiled, data)
    torque = model.matrix.T @ [data.joint(name).qfrc_actuator[0] for name in model.joints]
    at = [hand.joint_names.index(name) for name in ("A2", "A3")]
    assert torque[at[1]] / torque[at[0]] == pytest.approx(1.5 * sign)


def test_without_an_mjcf_there_is_no_group(tmp_path: Path) -> None:
    loaded(tmp_path, TENDON.format(1.0, 1.0, ""))
    (tmp_path / "hand.toml").unlink()
    assert load_hand(tmp_path, candidates=16).coupled == ()
    assert len(load_hand(tmp_path, mjcf=tmp_path / "r.xml", candidates=16).coupled) == 1


@pytest.mark.parametrize(
    ("drive", "told"),
    [
        ('<position name="more" joint="rh_A3" kp="1"/>', True),
        ('<position name="more" tendon="pull" kp="1"/>', True),
        ('<position name="more" joint="rh_A1" kp="1"/>', False),
    ],
)
def test_joints_with_another_drive_are_no_group(tmp_path: Path, drive: str, told: bool) -> None:
    hand = loaded(tmp_path, TENDON.format(1.0, 1.0, drive))
    two_on_one_tendon = 'tendon="pull" kp="1"' in drive
    assert bool(hand.coupled) == (two_on_one_tendon or not told)


def test_a_tendon_without_an_actuator_is_no_group(tmp_path: Path) -> None:
    idle = TENDON.format(1.0, 1.0, "").replace('tendon="pull"', 'joint="rh_A2"')
    assert loaded(tmp_path, idle).coupled == ()


GROUP = '[[coupled]]\njoints = ["A2", "A3"]\nratio = [{}, {}]\n'


@pytest.mark.parametrize("scale", [1.0, -4.0])
def test_hand_toml_and_mjcf_that_agree_say_nothing(tmp_path: Path, scale: float) -> None:
    hand = loaded(tmp_path, TENDON.format(scale, 2 * scale, ""), toml=GROUP.format(1.0, 2.0))
    assert hand.coupled == (Coupled(("A2", "A3"), (1.0, 2.0)),)
    assert not any("r.xml" in note for note in hand.notes)


def test_hand_toml_counts_and_a_contradiction_is_reported(tmp_path: Path) -> None:
    other_ratio = loaded(tmp_path, TENDON.format(1.0, 1.0, ""), toml=GROUP.format(1.0, 2.0))
    assert other_ratio.coupled == (Coupled(("A2", "A3"), (1.0, 2.0)),)
    assert_names(" ".join(other_ratio.notes), "hand.toml", "A2 + A3 (1 : 2)", "r.xml")
    other_joints = loaded(tmp_path, TENDON.format(1.0, 1.0, ""), toml='[[coupled]]\njoints = ["A1", "A2"]\n')
    assert other_joints.coupled == (Coupled(("A1", "A2"), (1.0, 1.0)),)
    assert_names(" ".join(other_joints.notes), "A1 + A2", "A2 + A3", "r.xml")
    alone = '<actuator><position joint="rh_A2"/><position joint="rh_A3"/></actuator>'
    each_alone = loaded(tmp_path, alone, toml=GROUP.format(1.0, 1.0))
    assert each_alone.coupled and any("hand.toml" in note and "r.xml" in note for note in each_alone.notes)


EQUALITY = """<equality><joint joint1="rh_A2" joint2="rh_A1" polycoef="0.1 0.5 {} 0 0" active="{}"/></equality>
  <actuator><position name="first" joint="rh_A1" kp="3"/><position name="third" joint="rh_A3" kp="3"/>
  <position name="other" joint="rh_B1" kp="3"/></actuator>"""


@pytest.mark.parametrize("bend", [0.0, 0.3])
@pytest.mark.parametrize(("first", "sign"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_joint_equality_is_a_mimic_joint_that_moves_as_in_the_mjcf(
    tmp_path: Path, first: int, sign: int, bend: float
) -> None:
    """There x2 = 0.1 + 0.5 (x1 - 0.3) + bend (x1 - 0.3)^2, and either joint may turn the other way."""
    hand = loaded(tmp_path, EQUALITY.format(bend, "true"), sign=sign, first=first, ref=0.3)
    assert hand.joint_names == ("A1", "A3", "B1")
    q = np.array([[0.8, 0.2, -0.4], [-0.9, 0.2, 0.1], [0.3, 0.0, 0.0]])
    matrix, offset, names = hand.mimic_map()
    values = q @ matrix.T + offset + hand.curves(q)
    x = first * q[:, 0] - 0.3
    np.testing.assert_allclose(values[:, names.index("A2")], sign * (0.1 + 0.5 * x + bend * x**2), atol=1e-12)
    model = mjcf_model(hand, tmp_path / "r.xml")
    compiled = model.spec.compile()
    data = mujoco.MjData(compiled)
    there = model.matrix @ q[0] + model.offset + (0.0 if model.curves is None else model.curves(q[0]))
    for name, value in zip(model.joints, there, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(compiled, data)
    residual = data.efc_pos[: data.ne]
    assert len(residual) == 1 and abs(residual[0]) < 1e-12


def test_a_tendon_does_not_tie_what_follows_the_other_way_in_the_urdf(tmp_path: Path) -> None:
    follower = joint("B1", "palm", "b1", at="-0.05 0.03 0.02", axis="1 0 0", follow=("A2", 2), **WIDE)
    write_urdf(tmp_path, *PARTS[:-1], follower, name="r")
    tied = """<tendon><fixed name="t"><joint joint="rh_A2" coef="2"/><joint joint="rh_B1" coef="-1"/></fixed></tendon>
      <equality><tendon tendon1="t"/></equality><actuator><position joint="rh_B1"/></actuator>"""
    (tmp_path / "r.xml").write_text(MJCF.format(parts=tied, sign=1, first=1, ref=0.0, turn=0.0))
    hand = load_hand(tmp_path / "r.urdf", mjcf=tmp_path / "r.xml", candidates=16)
    assert hand.joint_names == ("A1", "A2", "A3")


def test_limits_hold_for_mimic_joints_of_the_mjcf(tmp_path: Path) -> None:
    steep = EQUALITY.format(0, "true").replace("0.1 0.5", "0 4")
    hand = loaded(tmp_path, steep)
    np.testing.assert_allclose([hand.lower[0], hand.upper[0]], [-0.5, 0.5])


def test_an_equality_that_is_not_active_leaves_joints_independent(tmp_path: Path) -> None:
    hand = loaded(tmp_path, EQUALITY.format(0, "false"))
    assert "A2" in hand.joint_names and not any("'A2'" in note for note in hand.notes)


def test_a_joint_with_settings_in_hand_toml_stays_independent(tmp_path: Path) -> None:
    hand = loaded(tmp_path, EQUALITY.format(0, "true"), toml="[rest_pose]\nA2 = 0.2\n")
    assert "A2" in hand.joint_names
    assert_names(" ".join(hand.notes), "'A2'", "'A1'", "hand.toml", "r.xml")


def test_equalities_in_a_circle_leave_one_joint_independent(tmp_path: Path) -> None:
    both = """<equality><joint joint1="rh_A2" joint2="rh_A1"/><joint joint1="rh_A1" joint2="rh_A2"/></equality>"""
    hand = loaded(tmp_path, both)
    assert hand.joint_names == ("A1", "A3", "B1")
    assert hand.joints_by_name["A2"].mimic == Mimic("A1", 1.0, 0.0)


def test_a_tendon_pulls_what_its_mimic_joint_follows(tmp_path: Path) -> None:
    parts = """<equality><joint joint1="rh_A2" joint2="rh_A1" polycoef="0 0.5 0 0 0"/></equality>"""
    hand = loaded(tmp_path, parts + TENDON.format(1.0, 1.0, "").replace('joint="rh_A1" kp', 'joint="rh_B1" kp'))
    assert hand.coupled == (Coupled(("A1", "A3"), (1.0, 2.0)),)


def test_an_mjcf_that_cannot_be_used_is_reported_and_nothing_more(tmp_path: Path) -> None:
    loaded(tmp_path, "")
    (tmp_path / "r.xml").write_text(
        "<mujoco><worldbody><body><joint name='x'/><geom size='1'/></body></worldbody></mujoco>"
    )
    hand = load_hand(tmp_path, candidates=16)
    assert hand.coupled == () and len(hand.joint_names) == 4
    assert any("A1" in note and "r.xml" in note for note in hand.notes)


def test_an_mjcf_that_moves_otherwise_is_reported_though_it_looks_the_same_at_rest(tmp_path: Path) -> None:
    """There the third link hangs from the first."""
    loaded(tmp_path, "")
    third = """<body name="a3" pos="0 0 0.04"><joint name="rh_A3" axis="0 1 0"/><geom size="0.01"/></body>"""
    text = (tmp_path / "r.xml").read_text()
    assert third + "</body></body>" in text
    other = text.replace(third + "</body></body>", "</body>" + third.replace("0 0 0.04", "0 0 0.08") + "</body>")
    (tmp_path / "r.xml").write_text(other)
    assert any("moves unlike" in note and "A3" in note for note in load_hand(tmp_path, candidates=16).notes)


def test_the_makers_shadow_hand_shares_actuators_between_the_outer_joints(shared_assets: Path) -> None:
    urdf, mjcf = shared_assets / "hands/shadow/shadow_right.urdf", shared_assets / "hands/shadow_mjcf/right_hand.xml"
    hand = load_hand(urdf, mjcf=mjcf, candidates=16)
    assert hand.coupled == load_hand("shadow", urdf=urdf, candidates=16).coupled
