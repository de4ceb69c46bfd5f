"""Rules by which a grasp holds: in how many directions, and what tables, JSON and the viewer say then."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason, Trials
from gripper import RADIUS, around, ball, gripper

HALF = replace(DEXGRASPBENCH, name="half", required_share=0.5)
LIMIT = DEXGRASPBENCH.mass * DEXGRASPBENCH.acceleration / (2 * DEXGRASPBENCH.friction)
"""Force in newtons with which two plates must press to hold by friction alone."""


def gripper_with_palm() -> HandModel:
    """The gripper, with a palm half a millimetre below the ball: without friction, it holds along +x, -x and -z."""
    made = gripper()
    palm = made.spec.body("palm").add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.005], mass=0.01)
    palm.pos = [0.0, 0.0, 0.1 - RADIUS - 0.005 - 0.0005]
    return made


def tried(protocol: Protocol, force: float, *, first_failure: bool = False) -> Trials:
    """One grasp in which each plate presses with a force."""
    world = build_world(gripper_with_palm(), ball(), Task(protocol))
    return simulate(world, around(force), first_failure=first_failure)


def test_half_of_the_directions_may_be_enough():
    """Plates that press too little for friction hold along their axis and against the palm: in three of six."""
    loose = {protocol.name: tried(protocol, 0.85 * LIMIT) for protocol in (DEXGRASPBENCH, HALF)}
    held = {name for name, reason in zip(DEXGRASPBENCH.directions, loose["half"].reason[0], strict=True) if not reason}
    assert held == {"+x", "-x", "-z"}
    np.testing.assert_array_equal(loose["half"].reason, loose["dexgraspbench"].reason)
    assert loose["half"].success.all() and not loose["dexgraspbench"].success.any()
    assert tried(replace(HALF, required_share=0.51), 0.85 * LIMIT).success.tolist() == [False], "four of six"
    assert tried(DEXGRASPBENCH, 1.15 * LIMIT).success.all()


@pytest.mark.parametrize("share", [1 / 6, 0.5, 4 / 6, 1.0])
def test_trials_may_end_once_the_verdict_is_known(share: float):
    protocol = replace(DEXGRASPBENCH, required_share=share)
    ended, whole = (tried(protocol, 0.85 * LIMIT, first_failure=early) for early in (True, False))
    assert ended.success.tolist() == whole.success.tolist() == [share <= 0.5]
    if share <= 0.5:
        np.testing.assert_array_equal(ended.reason, whole.reason)


def test_the_worst_direction_of_a_grasp_that_held_is_one_that_held():
    loose = tried(HALF, 0.85 * LIMIT)
    assert loose.reason[0, loose.worst[0]] == Reason.HELD and loose.outcome.tolist() == [Reason.HELD]
    assert 0 < loose.most("peak_m")[0] < HALF.farthest
    strict = tried(DEXGRASPBENCH, 0.85 * LIMIT)
    assert DEXGRASPBENCH.directions[strict.worst[0]] == "+y" and strict.outcome.tolist() == [Reason.MOVED]
