"""Scenes: the grasps of a scene are chosen with all that belongs to them."""

import numpy as np

from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene


def test_grasps_are_chosen_with_their_targets():
    hand, ball = load_hand("allegro", candidates=16), load_object("sphere:0.03", candidates=16)
    q = np.linspace(hand.lower, hand.upper, 3)
    targets = np.arange(3.0)[:, None, None] + np.zeros((3, len(Scene(hand, ball, np.eye(4), hand.rest).links), 3))
    scene = Scene(hand, ball, np.tile(np.eye(4), (3, 1, 1)), q, targets, 2.0 * targets)
    chosen = scene.select(np.array([2, 0]))
    np.testing.assert_array_equal(chosen.q, q[[2, 0]])
    np.testing.assert_array_equal(chosen.target_link[:, 0, 0], [2.0, 0.0])
    np.testing.assert_array_equal(chosen.target_object[:, 0, 0], [4.0, 0.0])
    assert chosen.direction is None and len(scene.select(slice(1)).T_world_root) == 1
