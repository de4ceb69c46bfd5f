"""Poses of another frame are said before anything is done with them; those of the base link, and wild ones, are not."""

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, transform, transform_from_pose
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.problem.frame_check import frame_notes
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.scene import Scene
from refusals import assert_names

TIP_M = 0.1034
"""Distance of `panda_hand_tcp` from `panda_hand`, along z, metres."""


@pytest.fixture(scope="module")
def franka() -> Hand:
    return load_hand("franka_hand")


@pytest.fixture(scope="module")
def slab() -> Object:
    """An object that fits between the jaws one way only."""
    return load_object("box:0.12,0.03,0.12")


def opened(franka: Hand) -> np.ndarray:
    """Poses (8, 4, 4) of open jaws around the slab, from below and above."""
    along = np.linspace(-0.03, 0.03, 4)
    flip = exp_so3(np.array([np.pi, 0.0, 0.0]))
    below = [transform(np.eye(3), np.array([x, 0.002, -0.06 - TIP_M + 0.025])) for x in along]
    above = [transform(flip, np.array([x, -0.002, 0.06 + TIP_M - 0.025])) for x in along]
    return np.stack(below + above)


def notes(franka: Hand, slab: Object, T: np.ndarray, opening: float = 0.04) -> tuple[str, ...]:
    return frame_notes([Scene(franka, slab, T, np.full((len(T), 1), opening))])


def test_a_quarter_turn_is_said_with_its_figures(franka: Hand, slab: Object) -> None:
    T, turn = opened(franka), transform(exp_so3(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    assert not notes(franka, slab, T)
    (note,) = notes(franka, slab, T @ turn)
    assert_names(note, "panda_hand", "90 degrees about z", "0 of 8", "8 penetrate by", "8 of 8", "0 penetrate")


def test_poses_of_another_link_name_it(franka: Hand, slab: Object) -> None:
    tip = transform(np.eye(3), np.array([0.0, 0.0, TIP_M]))
    (note,) = notes(franka, slab, opened(franka) @ tip)
    assert_names(note, "panda_hand_tcp", "0 of 8", "8 of 8")


def test_wild_grasps_and_few_are_not_suspected(franka: Hand, slab: Object) -> None:
    rng = np.random.default_rng(0)
    T = opened(franka)
    wild = np.stack([transform(exp_so3(rng.normal(size=3)), rng.uniform(-0.1, 0.1, 3)) @ one for one in T])
    assert not notes(franka, slab, wild)
    turn = transform(exp_so3(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    assert not notes(franka, slab, np.repeat(T[:1], 8, axis=0) @ turn)


def test_grasps_of_many_fingers_are_checked_too() -> None:
    hand, ball = load_hand("leap"), load_object("box:0.06,0.06,0.1")
    grasps = sample_grasps(hand, ball, 6, seed=0)
    T = transform_from_pose(grasps.hand_pose)
    assert not frame_notes([Scene(hand, ball, T, grasps.q)])
    turn = transform(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), np.zeros(3))
    (note,) = frame_notes([Scene(hand, ball, T @ turn, grasps.q)])
    assert_names(note, "-90 degrees about x", "0 of 6")
