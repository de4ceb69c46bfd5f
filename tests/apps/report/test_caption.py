"""What pictures say is what was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.validation.replay.replay import Replay, Stage
from grasp_refine_apps.report.film import state_of
from recorded_gripper import recorded_gripper


@pytest.fixture(scope="module")
def replay() -> Replay:
    """Nothing moves."""
    replay = recorded_gripper().replay
    return replace(replay, qpos=np.tile(replay.qpos[0], (len(replay), 1)))


def test_a_caption_says_how_far_the_object_was_moved(replay: Replay) -> None:
    qpos = replay.qpos.copy()
    qpos[60:, :7] = [0.003, 0.004, qpos[0, 2], np.cos(0.05), 0.0, 0.0, np.sin(0.05)]
    qpos[-1, 0] = 3.0
    moved = replace(replay, qpos=qpos)
    assert state_of(moved, 0, 0) == "0.00 s, closing: moved 0.0 mm, turned 0.0°, 0 contacts"
    assert state_of(moved, 100, 2) == "0.40 s, squeezing: moved 5.0 mm, turned 5.7°, 2 contacts"
    assert state_of(moved, 125, 1) == "0.50 s, pushed +y: moved 5.0 mm, turned 5.7°, 1 contact"
    assert state_of(moved, 225, 1).startswith("0.90 s, pushed +y: moved 3.0 m,")


def test_a_caption_of_a_lift_says_how_far_the_object_is_from_where_the_hand_should_have_taken_it(
    replay: Replay,
) -> None:
    stage = np.where(replay.stage == Stage.PUSH, Stage.LIFT, replay.stage)
    mocap_pos, qpos = replay.mocap_pos.copy(), replay.qpos.copy()
    mocap_pos[101:, 2] += np.linspace(0.0, 0.1, 125)
    lying = replace(replay, stage=stage, mocap_pos=mocap_pos)
    assert state_of(lying, 225, 0) == "0.90 s, hand lifted 100.0 mm: object 100.0 mm off, turned 0.0°, 0 contacts"
    qpos[:, 2] += mocap_pos[:, 2] - mocap_pos[0, 2]
    carried = replace(lying, qpos=qpos)
    assert state_of(carried, 225, 2) == "0.90 s, hand lifted 100.0 mm: object 0.0 mm off, turned 0.0°, 2 contacts"
