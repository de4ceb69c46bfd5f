"""Joints that fixed tendons of an MJCF tie to another one."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from refusals import assert_names

HAND = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.02"/>
  <body name="a1" pos="0.05 0 0.02"><joint name="A1" axis="0 1 0" range="-0.5 1.5" ref="{ref}"/><geom size="0.01"/>
    <body name="a2" pos="0 0 0.04"><joint name="A2" axis="0 1 0" range="{range}" ref="-0.1"/><geom size="0.01"/>
      <body name="a3" pos="0 0 0.04"><joint name="A3" axis="0 1 0" range="-2 2"/><geom size="0.01"/></body>
    </body></body>
  <body name="b1" pos="-0.05 0 0.02"><joint name="B1" axis="0 1 0" range="-1 1"/><geom size="0.01"/></body>
  </body></worldbody>
  <tendon>
    <fixed name="t12" {limits}><joint joint="A1" coef="0.4"/><joint joint="A2" coef="-0.8"/></fixed>
    <fixed name="t23"><joint joint="A2" coef="1"/><joint joint="A3" coef="2"/></fixed>
    <fixed name="t1"><joint joint="A1" coef="3"/></fixed><fixed name="t2"><joint joint="A2" coef="0.5"/></fixed>
  </tendon>
  <equality>{equalities}</equality>
  <actuator><position joint="A1" kp="3"/><position joint="B1" kp="3"/>{more}</actuator></mujoco>"""


def loaded(
    folder: Path, equalities: str = "", *, limits: str = "", ref: float = 0.3, span: str = "-2 2", more: str = ""
) -> Hand:
    text = HAND.format(equalities=equalities, limits=limits, ref=ref, range=span, more=more)
    (folder / "hand.xml").write_text(text)
    return load_hand(folder / "hand.xml", candidates=16)


def worst_equality(hand: Hand, q: np.ndarray) -> float:
    """Largest error of the equalities of the simulated hand at joint values of the hand."""
    model = mjcf_model(hand, hand.urdf)
    compiled = model.spec.compile()
    data = mujoco.MjData(compiled)
    for name, value in zip(model.joints, model.matrix @ q + model.offset, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(compiled, data)
    assert data.ne > 0
    return float(np.abs(data.efc_pos[: data.ne]).max())


@pytest.mark.parametrize(
    ("equalities", "independent"),
    [
        ('<tendon tendon1="t12"/>', ("A1", "A3", "B1")),
        ('<tendon tendon1="t12" polycoef="0.05 0 0 0 0"/>', ("A1", "A3", "B1")),
        ('<tendon tendon1="t1" tendon2="t2" polycoef="0.1 7 0 0 0"/>', ("A1", "A3", "B1")),
        ('<tendon tendon1="t2" tendon2="t1" polycoef="0.1 0.2 0 0 0"/>', ("A1", "A3", "B1")),
        ('<tendon tendon1="t23"/><tendon tendon1="t12"/>', ("A1", "B1")),
    ],
)
def test_joints_tied_by_equalities_of_tendons_move_as_in_mujoco(
    tmp_path: Path, equalities: str, independent: tuple[str, ...]
) -> None:
    hand = loaded(tmp_path, equalities)
    assert hand.joint_names == independent
    rng = np.random.default_rng(0)
    assert max(worst_equality(hand, q) for q in rng.uniform(hand.lower, hand.upper, (5, len(independent)))) < 1e-12


@pytest.mark.parametrize(
    "equalities",
    [
        "",
        '<tendon tendon1="t12" active="false"/>',
        '<tendon tendon1="t1"/>',
        '<tendon tendon1="t2" tendon2="t1" polycoef="0 1 0.5 0 0"/>',
    ],
)
def test_other_tendons_tie_nothing(tmp_path: Path, equalities: str) -> None:
    assert loaded(tmp_path, equalities).joint_names == ("A1", "A2", "A3", "B1")


def test_both_joints_may_have_actuators(tmp_path: Path) -> None:
    hand = loaded(tmp_path, '<tendon tendon1="t12"/>', more='<position joint="A2" kp="1"/>')
    assert hand.joint_names == ("A1", "A2", "A3", "B1")


def test_limits_with_hardly_any_play_tie_the_middle(tmp_path: Path) -> None:
    hand = loaded(tmp_path, limits='limited="true" range="-0.02 0.1"')
    assert hand.joint_names == ("A1", "A3", "B1")
    # 0.4 A1 - 0.8 A2 = 0.04 +- 0.06, which leaves A2 0.075 rad: 4 degrees.
    mimic = hand.joints_by_name["A2"].mimic
    assert mimic is not None
    np.testing.assert_allclose([mimic.multiplier, mimic.offset], [0.5, -0.05])
    assert_names(" ".join(hand.notes), "t12", "'A2'", "4 degrees")
    wide = loaded(tmp_path, limits='limited="true" range="-0.2 0.2"')
    assert "A2" in wide.joint_names


def test_ties_that_limits_forbid_are_left_out_and_reported(tmp_path: Path) -> None:
    hand = loaded(tmp_path, '<tendon tendon1="t12" polycoef="-1 0 0 0 0"/>', span="-0.2 0.2")
    assert "A2" in hand.joint_names
    assert_names(" ".join(hand.notes), "t12", "A2", "A1")


def test_joints_that_nothing_drives_make_no_torque(tmp_path: Path) -> None:
    hand = loaded(tmp_path, '<tendon tendon1="t12"/>')
    at = hand.joint_names.index("A3")
    assert hand.actuator.kp[at] == 0.0 and hand.actuator.force_limit[at] == 0.0
    assert np.isinf(hand.actuator.force_limit[[0, 2]]).all()
    (note,) = (note for note in mjcf_model(hand, hand.urdf).notes if "follow" in note)
    assert_names(note, "A3")
    assert "A2" not in note
