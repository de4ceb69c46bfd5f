"""Grasps of a hand as grasps on an arm: of the solutions the first with room around it."""

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import ROOM_M, on_arm
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.hands.mount import mount

T_BASE = transform(exp_so3(np.array([0.1, -0.2, 0.5])), np.array([0.3, -0.4, 0.1]))


@pytest.fixture(scope="module")
def whole() -> Hand:
    return mount(load_hand("ur5e", candidates=32), load_hand("franka_hand", candidates=32))


@pytest.mark.parametrize(
    ("rooms", "chosen"),
    [
        (None, 0),
        ([0.01, ROOM_M, 1.0], 1),
        ([0.5 * ROOM_M, 0.9 * ROOM_M, 0.01], 0),
        ([0.0, -0.1, 1e-3], 2),
        ([0.0, -0.1, 0.0], None),
    ],
)
def test_the_first_solution_with_room_is_taken_else_one_that_is_clear(
    whole: Hand, rooms: list[float] | None, chosen: int | None
) -> None:
    kinematics, hand = ArmKinematics(whole), whole.parts[1]
    T = kinematics.palm(T_BASE[None], whole.rest[None])
    ways = kinematics.solve(T_BASE, hand.rest[None], T).q[0]
    grasps = GraspSet.of(hand, T, hand.rest[None])
    seen: list[np.ndarray] = []

    def clearance(T_object_base: np.ndarray, q: np.ndarray) -> np.ndarray:
        np.testing.assert_allclose(T_object_base, np.tile(T_BASE, (len(q), 1, 1)))
        seen.append(q)
        return np.array([*rooms, *[0.0] * len(q)])[: len(q)]  # type: ignore[misc]

    found, _ = on_arm(grasps, whole, T_BASE, clearance=None if rooms is None else clearance)
    assert (found.base_link, found.joint_names) == (whole.base_link, whole.joint_names) and len(ways) > 3
    np.testing.assert_allclose(found.q[0, ~whole.arm_joints], hand.rest)
    expected = np.full(6, np.nan) if chosen is None else ways[chosen, whole.arm_joints]
    np.testing.assert_allclose(found.q[0, whole.arm_joints], expected, atol=1e-9)
    assert on_arm(found, whole, T_BASE)[0] is found


def test_grasps_of_another_link_are_refused(whole: Hand) -> None:
    hand = load_hand("franka_hand", candidates=32)
    grasps = GraspSet.of(hand, np.eye(4), hand.rest)
    with pytest.raises(GraspFileError, match="panda_leftfinger"):
        on_arm(type(grasps)(**{**vars(grasps), "base_link": "panda_leftfinger"}), whole, T_BASE)
