"""Joint torques of contact forces: the work that they do, and their share of what actuators can make."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from claw import around, capsule, claw
from grasp_refine.core.se3 import transform_points
from grasp_refine.forces.torques import GIVE_RAD, joint_torques, limit_shares, torque_bounds
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.scene import links_of


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"))


def test_torques_do_the_work_of_the_forces(hand: Hand) -> None:
    """The derivative of sum f . x in a joint value is its torque, for forces at rest on points of the links."""
    scene = around(hand, capsule(), 4, 0)
    chain, rng = Chain(hand, links_of(hand)), np.random.default_rng(1)
    N, L = len(scene.q), len(chain.links)
    on_link, force = 0.02 * rng.normal(size=(N, L, 3)), rng.normal(size=(N, 3, L, 3))

    def points(q: np.ndarray) -> np.ndarray:
        return transform_points(chain(scene.T_world_root, q).T_world_link, on_link)

    link = np.tile(np.arange(L), (N, 1))
    found = joint_torques(chain, chain(scene.T_world_root, scene.q), force, points(scene.q), link)
    h = 1e-6
    for j in range(scene.q.shape[1]):
        step = np.zeros_like(scene.q)
        step[:, j] = h
        work = (force * (points(scene.q + step) - points(scene.q - step))[:, None]).sum(axis=(-2, -1)) / (2 * h)
        np.testing.assert_allclose(found[..., j], work, rtol=1e-6, atol=1e-8)


def test_shares_are_of_each_limit(hand: Hand) -> None:
    n = len(hand.joint_names)
    limit = np.arange(1.0, n + 1.0)
    limit[0] = np.inf
    torque, q = np.full((2, 3, n), -3.0), np.zeros((2, 1, n))
    shares = limit_shares(replace(hand, actuator=replace(hand.actuator, force_limit=limit)), torque, q)
    np.testing.assert_allclose(shares, np.broadcast_to(3.0 / limit, shares.shape))
    assert (shares[..., 0] == 0.0).all()
    nothing = limit_shares(replace(hand, actuator=replace(hand.actuator, force_limit=np.zeros(n))), torque, q)
    assert np.isfinite(nothing).all() and (nothing > 1e3).all()


def test_a_tendon_has_the_share_of_its_tension(tmp_path: Path) -> None:
    """The torque that it cannot make at all is none of its tension."""
    hand = claw(tmp_path, coupled=True)
    group = hand.coupled[0]
    at = [hand.joint_names.index(name) for name in group.joints]
    ratio, rng = np.array(group.ratio), np.random.default_rng(2)
    across = rng.normal(size=len(at))
    across -= ratio * (across @ ratio) / (ratio @ ratio)
    torque = np.zeros((1, len(hand.joint_names)))
    q = np.zeros_like(torque)
    torque[0, at] = 2.0 * ratio + across
    limit = np.full(len(hand.joint_names), 4.0)
    shares = limit_shares(replace(hand, actuator=replace(hand.actuator, force_limit=limit)), torque, q)
    assert shares.sum() == pytest.approx(0.5) and shares[0, at[0]] == pytest.approx(0.5)


@pytest.mark.parametrize("side", [0, 1], ids=["lower", "upper"])
def test_set_points_that_end_near_the_joint_value_bound_one_direction(hand: Hand, side: int) -> None:
    """Rest 0.1 rad before the last set point: kp x 0.1 that way, and after giving way more; any torque the other way.

    A slide gives way by 0.1 m per radian, and an actuator without stiffness makes nothing, wherever its set points end.
    """
    n, sign = len(hand.joint_names), (-1.0, 1.0)[side]
    slide, last = int(np.flatnonzero(hand.slides)[0]), n - 1
    ends, kp = np.tile([-np.inf, np.inf], (n, 1)), np.full(n, 4.0)
    ends[[0, slide, last], side] = sign * np.array([0.3, 0.03, 0.0])
    kp[last] = 0.0
    actuator = replace(hand.actuator, kp=kp, force_limit=np.full(n, 3.0), set_points=ends)
    bounded, q = replace(hand, actuator=actuator), np.zeros((2, n))
    q[:, 0], q[:, slide] = sign * np.array([0.2, 0.35]), sign * 0.02
    bounds = torque_bounds(bounded, q)
    others = np.setdiff1d(np.arange(n), [0, slide, last])
    np.testing.assert_allclose(sign * bounds[side][:, 0], [0.4, 0.0], atol=1e-12)
    np.testing.assert_allclose(sign * bounds[side][:, slide], 0.04, atol=1e-12)
    assert (sign * bounds[side][:, others] == 3.0).all() and (-sign * bounds[1 - side][:, :last] == 3.0).all()
    assert not bounds[side][:, last].any()
    shares = limit_shares(bounded, sign * np.ones((2, n)), q)
    np.testing.assert_allclose(shares[:, 0], 1.0 / (4.0 * np.array([0.1 + GIVE_RAD, GIVE_RAD - 0.05])))
    np.testing.assert_allclose(shares[:, slide], 1.0 / (4.0 * (0.01 + 0.1 * GIVE_RAD)))
    np.testing.assert_allclose(limit_shares(bounded, -sign * np.ones((2, n)), q)[:, :last], 1.0 / 3.0)


def test_set_points_of_a_tendon_end_where_its_length_does(tmp_path: Path) -> None:
    """Its length is the sum of ratio x joint value, the same for all of its joints."""
    hand = claw(tmp_path, coupled=True)
    group, n = hand.coupled[1], len(hand.joint_names)
    at, ratio = [hand.joint_names.index(name) for name in group.joints], np.array(group.ratio)
    q = np.random.default_rng(3).normal(size=(5, n)) * 0.1
    ends = np.tile([-np.inf, np.inf], (n, 1))
    ends[at] = [-0.2, 0.3]
    bounded = replace(hand, actuator=replace(hand.actuator, force_limit=np.full(n, np.inf), set_points=ends))
    least, greatest = torque_bounds(bounded, q)
    length = np.tile((q[:, at] @ ratio)[:, None], (1, len(at)))
    np.testing.assert_allclose(greatest[:, at], bounded.stiffness[at] * np.maximum(0.3 - length, 0.0))
    np.testing.assert_allclose(least[:, at], bounded.stiffness[at] * np.minimum(-0.2 - length, 0.0))
