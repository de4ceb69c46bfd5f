"""Set points that an MJCF clips: how far they are beyond the ctrlrange, and that they press that much less."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.set_points import clipping_note, set_point_excess
from grasp_refine.validation.simulation import simulate
from gripper import KP, RADIUS, XML, around, ball, gripper

FORCE_N = 4.0
ALLOWED_N = 0.1
"""Force with which the left plate presses at the end of its range."""


@pytest.fixture(scope="module")
def world() -> World:
    """The gripper, with a range on the left plate's actuator, which is at -opening / 2."""
    reach = f'<position name="pull" joint="left" kp="{{kp}}" ctrlrange="-1 {-RADIUS + ALLOWED_N / KP}"/>'
    text = XML.replace('<position joint="left" kp="{kp}"/>', reach).format(kp=KP)
    return build_world(replace(gripper(), spec=mujoco.MjSpec.from_string(text)), ball(), Task(DEXGRASPBENCH))


def test_the_excess_is_the_force_that_is_missing(world: World) -> None:
    excess = set_point_excess(world, around(FORCE_N, count=2))
    np.testing.assert_allclose(KP * excess, [[FORCE_N - ALLOWED_N, 0.0]] * 2, atol=1e-9)
    assert not set_point_excess(world, around(ALLOWED_N / 2)).any()


def test_clipped_set_points_are_reported_with_their_actuator_and_press_less(world: World) -> None:
    strong, weak = around(FORCE_N), around(ALLOWED_N / 2)
    note = clipping_note([world, world], [strong, weak])
    assert "1 of 2 squeezes" in note and "pull" in note and "right" not in note
    assert clipping_note([world], [weak]) == "" and clipping_note([], []) == ""
    free = build_world(gripper(), ball(), Task(DEXGRASPBENCH))
    # Between servos of one stiffness the object comes to rest where both press alike.
    aside = (FORCE_N - ALLOWED_N) / KP / 2
    found = [simulate(each, strong).closing_m[0] for each in (free, world)]
    np.testing.assert_allclose(found, [0.0, aside], atol=0.2 * aside)


def test_grasps_that_are_not_finite_are_not_reported(world: World) -> None:
    motion = around(FORCE_N, count=2)
    motion.q[0] = np.nan
    assert "1 of 2 squeezes" in clipping_note([world], [motion])
    assert clipping_note([world], [motion.select(np.array([0]))]) == ""
