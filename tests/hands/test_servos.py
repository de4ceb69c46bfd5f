"""Servos of an MJCF as actuators of independent joints: stiffness, limits and set points in closed form."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from grasp_refine.hands.hand import Actuator, load_hand

HAND = """<mujoco><compiler angle="radian" inertiafromgeom="false"/>
  <default><joint axis="0 1 0" range="-2 2"/></default>
  <worldbody><body name="palm"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom size="0.02"/>{bodies}</body>
  </worldbody>
  <tendon><fixed name="pull"><joint joint="a2" coef="2"/><joint joint="a3" coef="-1"/></fixed></tendon>
  <equality><joint joint1="m" joint2="a1" polycoef="0.1 0.5 0 0 0"/></equality>
  <actuator>{actuators}</actuator></mujoco>"""

INERTIAL = '<inertial pos="0 0 0.1" mass="0.5" diaginertia="0.01 0.02 0.03"/><geom size="0.01"/>'
BODIES = f"""
  <body name="a1" pos="0.05 0 0"><joint name="a1" damping="0.3" armature="0.004" frictionloss="0.02"/>{INERTIAL}</body>
  <body name="m" pos="-0.05 0 0"><joint name="m"/>{INERTIAL}</body>
  <body name="s" pos="0 0.05 0"><joint name="s" type="slide" range="0 0.05"/>{INERTIAL}</body>
  <body name="a2" pos="0 -0.05 0"><joint name="a2"/>{INERTIAL}
    <body name="a3" pos="0 0 0.1"><joint name="a3" actuatorfrclimited="true" actuatorfrcrange="-0.4 0.5"/>{INERTIAL}
    </body></body>"""

SERVOS = """
  <position joint="a1" gear="2" kp="3" kv="0.1" forcerange="-5 4" ctrlrange="-1 0.6"/>
  <position joint="a1" kp="2" forcerange="-1 1" ctrlrange="-0.4 1"/>
  <position joint="m" kp="8" forcerange="-2 3" ctrlrange="-0.2 0.5"/>
  <position tendon="pull" kp="7" kv="0.2" forcerange="-6 6" ctrlrange="-0.6 0.8"/>
  <general joint="s" biastype="affine" gainprm="2" biasprm="0 -50 -3" ctrlrange="0 255"/>"""


def actuator(folder: Path, actuators: str) -> dict[str, SimpleNamespace]:
    """Return the actuators of the hand by joint."""
    path = folder / "hand.xml"
    path.write_text(HAND.format(bodies=BODIES, actuators=actuators))
    hand = load_hand(path, candidates=16)
    assert hand.joint_names == ("a1", "s", "a2", "a3")
    return {name: _row(hand.actuator, i) for i, name in enumerate(hand.joint_names)}


def _row(all_of: Actuator, i: int) -> SimpleNamespace:
    return SimpleNamespace(**{key: None if value is None else value[i] for key, value in vars(all_of).items()})


def test_servos_act_with_the_squares_of_their_arms(tmp_path: Path) -> None:
    """A gear, a second servo, one at a follower (0.5 a1 + 0.1), a tendon over 2 a2 - a3, and controls up to 255."""
    found = actuator(tmp_path, SERVOS)
    a1, s, a2, a3 = found["a1"], found["s"], found["a2"], found["a3"]
    assert a1.kp == pytest.approx(3 * 2**2 + 2 + 8 * 0.5**2) and s.kp == 50
    assert a1.force_limit == pytest.approx(5 * 2 + 1 + 3 * 0.5) and np.isinf(s.force_limit)
    assert (a1.damping, s.damping) == pytest.approx((0.3 + 0.1 * 2**2, 3.0))
    assert (a1.armature, a1.frictionloss) == (0.004, 0.02)
    np.testing.assert_allclose(a1.set_points, [-0.4, 0.3])
    np.testing.assert_allclose(s.set_points, [0.0, 255 * 2 / 50])
    # Of a group, all of the tendon of a2 - 0.5 a3; the joint a3 may take 0.5 N m, half of the tendon's force.
    for one in (a2, a3):
        assert (one.kp, one.force_limit, one.damping) == pytest.approx((7 * 2**2, 0.5 / 0.5, 0.2 * 2**2))
        np.testing.assert_allclose(one.set_points, [-0.3, 0.4])


def test_servos_in_place_of_motors_are_critically_damped(tmp_path: Path) -> None:
    """At the inertia about the joint with the follower's share; armature and friction stay."""
    found = actuator(tmp_path, '<motor joint="a1"/><motor joint="s"/><motor tendon="pull"/>')
    about = 0.02 + 0.5 * 0.1**2
    assert (found["a1"].kp, found["s"].kp) == pytest.approx((5.0, 500.0))
    assert found["a1"].damping == pytest.approx(2 * np.sqrt(5 * (1.25 * about + 0.004)))
    assert found["s"].damping == pytest.approx(2 * np.sqrt(500 * (0.5 + 0.02)))
    assert found["a3"].damping == pytest.approx(2 * np.sqrt(5 * 0.5**2 * (about + 0.0002)))
    assert (found["a1"].armature, found["s"].armature) == pytest.approx((0.004, 0.02))
    assert (found["a1"].frictionloss, found["s"].frictionloss) == (0.02, 0.0)
