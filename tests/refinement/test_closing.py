"""Open hands close by the motion that they have until they touch; nothing else of a grasp changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.closing.motion import closing_motion
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import transform
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.closing import close_hands, closing_notes, is_open
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import JAW_DEPTH_M, refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of

TIP_M = 0.105
"""Distance of the middle between the tips of the Franka hand from its base link, along z, metres."""
WIDTH_M = 0.03
"""Width of the block, metres."""


@pytest.fixture(scope="module")
def franka() -> Hand:
    return load_hand("franka_hand")


@pytest.fixture(scope="module")
def block() -> Object:
    return load_object(f"box:0.03,{WIDTH_M},0.05")


def around(hand: Hand, thing: Object, *offsets: float, opening: float = 0.04) -> Scene:
    """Grasps of a block from below, the jaws open, the middle between them at `offsets` along their motion."""
    T = np.stack([transform(np.eye(3), np.array([0.0, offset, -TIP_M])) for offset in offsets])
    return Scene(hand, thing, T, np.full((len(T), len(hand.rest)), opening))


def distances(scene: Scene) -> np.ndarray:
    prepared = HandObject.of(scene)
    T = prepared.chain(scene.T_world_root, scene.q).T_world_link
    return query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape)).distance


def test_jaws_that_move_together_close_to_the_width_of_the_object(franka: Hand, block: Object) -> None:
    """Off the middle one jaw touches first, and both do once it has pushed the object there."""
    scene = around(franka, block, 0.0, 0.006, -0.011)
    closed = close_hands(scene, HandObject.of(scene))
    np.testing.assert_allclose(closed.q, WIDTH_M / 2, atol=2e-5)
    np.testing.assert_allclose(closed.moved_m, 0.04 - WIDTH_M / 2, atol=2e-5)
    left, right, _ = distances(replace(scene, q=closed.q)).T
    np.testing.assert_allclose(left, [0.0, 0.006, -0.011], atol=5e-5)
    np.testing.assert_allclose(right, -left, atol=5e-5)


def test_jaws_with_a_motor_each_stop_where_they_touch(block: Object) -> None:
    hand = load_hand(Path(__file__).parents[1] / "two_jaws.urdf")
    scene = around(hand, block, 0.004, 0.02, opening=0.05)
    base = HandObject.of(scene)
    closed = close_hands(scene, base)
    both = distances(replace(scene, q=closed.q))[0, :2]
    assert (np.abs(both) < 1e-4).all()
    # The hand is 4 mm aside, so that one jaw moves 8 mm farther.
    assert abs(np.ptp(closed.q[0]) - 0.008) < 1e-4
    # 20 mm aside, one jaw touches; the other one would close beyond the middle, and stays where it was.
    np.testing.assert_allclose(np.sort(closed.q[1]), [WIDTH_M / 2 + 0.02, 0.05], atol=2e-5)
    np.testing.assert_allclose(closed.moved_m, [0.05 - WIDTH_M / 2 + 0.004, 0.05 - WIDTH_M / 2 - 0.02], atol=2e-5)


def test_jaws_are_open_unless_both_are_within_two_millimetres() -> None:
    """A box that stands on the palm touches the palm, too, which is no finger."""
    hand = load_hand(Path(__file__).parents[1] / "two_jaws.urdf", candidates=16)
    T = np.tile(transform(np.eye(3), np.array([0.0, 0.0, -0.085])), (4, 1, 1))
    q = 0.025 + np.array([[1e-3, 1e-3], [1e-3, 0.02], [0.02, 1e-3], [5e-3, 5e-3]])
    scene = Scene(hand, load_object("box:0.05,0.05,0.05"), T, q)
    assert np.abs(distances(scene)[:, 2]).max() < 1e-6
    assert is_open(scene, HandObject.of(scene)).tolist() == [False, True, True, True]


def test_grasps_that_touch_and_jaws_around_nothing_stay(franka: Hand, block: Object) -> None:
    aside = around(franka, block, 0.0, 0.2, 0.0)
    q = aside.q.copy()
    q[2] = WIDTH_M / 2 + 1e-3
    scene = replace(aside, q=q)
    assert is_open(scene, HandObject.of(scene)).tolist() == [True, True, False]
    closed = close_hands(scene, HandObject.of(scene))
    np.testing.assert_array_equal(closed.q[1:], q[1:])
    assert np.isnan(closed.moved_m[1]) and closed.moved_m[2] == 0.0
    first, second = closing_notes(closed.moved_m, jaws=True)
    assert "1 of 3" in first and "25.0 mm" in first and "1 of 3" in second
    assert not closing_notes(np.zeros(3), jaws=True)


def test_an_invalid_grasp_does_not_disturb_the_others(franka: Hand, block: Object) -> None:
    scene = around(franka, block, 0.0, 0.0)
    broken = replace(scene, T_world_root=np.stack([scene.T_world_root[0] * np.nan, scene.T_world_root[1]]))
    closed = close_hands(broken, HandObject.of(broken))
    np.testing.assert_allclose(closed.q[1], WIDTH_M / 2, atol=2e-5)
    np.testing.assert_array_equal(closed.q[0], scene.q[0])


def test_an_open_hand_with_many_fingers_closes_until_they_touch() -> None:
    hand = load_hand("leap")
    ball = load_object("sphere:0.03", candidates=64)
    frame = closure_frame(hand)
    T = transform(np.eye(3), -frame.center)[None]
    opened = np.where(frame.closing == 0.0, hand.rest, frame.opened)
    scene = Scene(hand, ball, T, opened[None])
    prepared = HandObject.of(scene)
    assert is_open(scene, prepared).all()
    closed = close_hands(scene, prepared)
    assert (closed.q >= hand.lower - 1e-12).all() and (closed.q <= hand.upper + 1e-12).all()
    still = frame.closing == 0.0
    np.testing.assert_array_equal(closed.q[:, still], scene.q[:, still])
    distance = distances(replace(scene, q=closed.q))[0]
    assert (np.abs(distance) < 1e-3).sum() >= 3 and distance.min() > -1e-3


def test_open_jaws_hold_what_is_between_them_and_nothing_else(franka: Hand, block: Object) -> None:
    scene = around(franka, block, 0.0, 0.004, 0.2)
    motion = closing_motion(scene)
    assert motion.closed_m is not None
    np.testing.assert_allclose(motion.closed_m[:2], 0.04 - WIDTH_M / 2, atol=2e-5)
    # They begin as open as they are given.
    np.testing.assert_allclose(motion.q[:2, 0], 0.04, atol=1e-3)
    world = build_world(model_of(franka), block, Task(replace(DEXGRASPBENCH, checks=2, multiccd=True)))
    assert simulate(world, motion).success.tolist() == [True, True, False]


def test_frozen_jaws_stay_open(block: Object) -> None:
    """The other jaw closes as without them; a refinement keeps their bits."""
    hand = load_hand(Path(__file__).parents[1] / "two_jaws.urdf")
    scene = around(hand, block, 0.004, opening=0.05)
    free, still = close_hands(scene, HandObject.of(scene)).q, np.array([True, False])
    closed = close_hands(scene, HandObject.of(scene), frozen=still).q
    np.testing.assert_array_equal(closed, np.where(still, scene.q, free))
    config = Config(LevenbergMarquardt(iterations=10), starts=2, freeze=hand.joint_names[:1])
    found = refine(scene, config)
    np.testing.assert_array_equal(found.q[:, 0], scene.q[:, 0])
    assert found.q[0, 1] < 0.045
    found = refine(scene, replace(config, freeze=hand.joint_names))
    np.testing.assert_array_equal(found.q, scene.q)
    np.testing.assert_array_equal(found.closed_m, 0.0)


def test_refinement_closes_jaws_before_it_moves_the_hand(franka: Hand, block: Object) -> None:
    scene = around(franka, block, 0.0, 0.008)
    refined = refine(scene)
    moved = np.linalg.norm(refined.T_world_root[:, :3, 3] - scene.T_world_root[:, :3, 3], axis=1)
    # A jaw that is brought to the block without closing takes the hand along by 25 mm.
    np.testing.assert_allclose(moved, [0.0, 0.008], atol=5e-4)
    assert refined.closed_m is not None
    np.testing.assert_allclose(refined.closed_m, 0.04 - WIDTH_M / 2 + JAW_DEPTH_M, atol=2e-5)
