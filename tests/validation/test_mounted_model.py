"""Model for MuJoCo of a hand from its MJCF on an arm: it moves as the hand that is refined, and its parts collide."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.validate import model_of

MJCF = """
<mujoco model="jaws">
  <worldbody>
    <body name="palm" pos="0.1 0.2 0.3">
      <geom type="box" size="0.05 0.05 0.01"/>
      <body name="left" pos="0.04 0 0.06">
        <joint name="l" axis="0 1 0" range="-1 1"/>
        <geom type="box" size="0.01 0.01 0.05"/>
      </body>
      <body name="right" pos="-0.04 0 0.06">
        <joint name="r" axis="0 1 0" range="-1 1"/>
        <geom type="box" size="0.01 0.01 0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="l" kp="3" forcerange="-2 2" ctrlrange="-1 1"/>
    <position joint="r" kp="4" forcerange="-2 2" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""

T_MOUNT = transform(exp_so3(np.array([0.2, -0.4, 0.1])), np.array([0.01, 0.02, 0.03]))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Return the jaws on an arm."""
    file = tmp_path_factory.mktemp("jaws") / "jaws.xml"
    Path(file).write_text(MJCF)
    return mount(load_hand("ur5e", candidates=16), load_hand(file, candidates=16), "tool0", T_MOUNT)


def test_links_are_where_our_kinematics_have_them(whole: Hand) -> None:
    """All of them, at joint values within the limits; the servos of the file drive the jaws, ours the arm."""
    made = model_of(whole)
    model = made.spec.compile()
    data = mujoco.MjData(model)
    q = np.random.default_rng(0).uniform(np.maximum(whole.lower, -1.0), np.minimum(whole.upper, 1.0))
    for name, value in zip(made.joints, made.matrix @ q + made.offset, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    body_of = {link: body for body, link in made.links.items()}
    links = ["wrist_3_link", "palm", "left", "right"]
    T = Chain(whole, links)(np.eye(4)[None], q[None]).T_world_link[0]
    for link, pose in zip(links, T, strict=True):
        np.testing.assert_allclose(data.body(body_of[link]).xpos, pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose(data.body(body_of[link]).xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)
    np.testing.assert_allclose(made.actuator.kp, [10000.0, 10000.0, 10000.0, 2000.0, 2000.0, 2000.0, 3.0, 4.0])
    assert made.on_arm is whole and model.nu == 8


def test_arm_and_hand_collide_only_in_pairs_that_can(whole: Hand) -> None:
    """The palm rests on the flange without a contact; a finger that is bent onto the wrist touches it."""
    model = model_of(whole).spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touched = {
        frozenset(model.body(int(model.geom_bodyid[geom])).name for geom in pair) for pair in data.contact.geom.tolist()
    }
    assert not any("wrist_3_link" in pair and "jaws/palm" in pair for pair in touched)


def test_hand_alone_has_the_same_servos(whole: Hand) -> None:
    """Mounting changes none of them."""
    _, hand = whole.parts
    assert hand.mjcf is not None
    alone = mjcf_model(hand, hand.mjcf)
    np.testing.assert_array_equal(model_of(whole).actuator.force_limit[6:], alone.actuator.force_limit)
