"""Simulation in a scene: the object is lifted out of it, neighbours are pushed, walls are in the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, inverse, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.task import Task
from grasp_refine.validation.engine_table import engine_of
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason
from gripper import RADIUS, around, ball, gripper

TURN = exp_se3(np.array([0.3, -0.1, 0.7, 0.5, -0.8, 1.2]))
"""Pose of the object in the world: up is none of its axes."""

NEIGHBOUR = 0.025
"""Half of the sides of a cube that can be pushed, metres."""


def place(position: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = position
    return T


def scene(*more: EnvironmentBody) -> Environment:
    """A ball on a table, in a world whose axes are not those of the object."""
    upright = TURN.copy()
    upright[:3, :3] = np.eye(3)
    table = EnvironmentBody("table", build_body("table", [box([1.0, 1.0, 0.04])], candidates=16), np.eye(4))
    at = upright @ place([0.0, 0.0, -RADIUS - 0.02])
    others = [replace(one, T_world_body=upright @ one.T_world_body) for one in more]
    return Environment((replace(table, T_world_body=at), *others), TURN)


def cube(x: float, y: float, *, movable: bool) -> EnvironmentBody:
    body = build_body("cube", [box([2 * NEIGHBOUR] * 3)], candidates=16)
    mass = 0.05 if movable else None
    return EnvironmentBody("cube", body, place([x, y, NEIGHBOUR - RADIUS]), movable=movable, mass=mass)


def world_of(environment: Environment) -> World:
    return build_world(gripper(), ball(), Task(SCENE, scene=environment))


def upside(force: float = 4.0) -> Motion:
    """The gripper above the ball, its plates around it and above the table, upright in the world."""
    motion = around(force)
    # The hand is 10 cm below the ball along z in its own frame: turned over about x, it comes from above.
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    raised = place([0.0, 0.0, 0.015])
    T = inverse(TURN) @ place(TURN[:3, 3].tolist()) @ raised @ over @ motion.T_world_root
    return Motion(T, motion.q)


def test_a_ball_is_lifted_off_its_table_against_gravity_whichever_way_its_frame_is_turned() -> None:
    world = world_of(scene())
    assert transform_points(TURN, world.up) - TURN[:3, 3] == pytest.approx([0.0, 0.0, 1.0])
    assert world.model.opt.gravity == pytest.approx(-9.81 * world.up)
    held, dropped = simulate(world, upside()), simulate(world, upside(0.3))
    assert held.success.all() and held.peak_m.max() < 0.01
    # Friction 0.6 of twice 0.3 N does not carry 0.1 kg.
    assert dropped.reason.tolist() == [[Reason.MOVED]]
    assert held.pushed_m is None


def test_a_ball_rests_on_its_table() -> None:
    """A hand that never closes leaves it where it is."""
    far = upside()
    lifted = Motion(far.T_world_root, np.full_like(far.q, 0.2))
    found = simulate(world_of(scene()), lifted)
    assert found.reason.tolist() == [[Reason.MOVED]]
    assert found.closing_m.max() < 1e-3
    assert found.displacement_m.max() == pytest.approx(SCENE.farthest, abs=0.03)


@pytest.mark.parametrize("movable", [True, False])
def test_neighbours_are_pushed_and_walls_are_in_the_way(movable: bool) -> None:
    """A cube where a plate is at the pregrasp, by 8 mm; farther in, it is in the way."""
    opening = (2 * RADIUS + 0.01) / 2.0
    near = cube(opening + 0.01 + NEIGHBOUR - 0.008, 0.0, movable=movable)
    found = simulate(world_of(scene(near)), upside())
    if movable:
        assert found.success.all() and found.neighbours == ("cube",)
        assert found.pushed_m is not None and found.pushed_m.shape == (1, 1)
        assert 3e-3 < found.pushed_m[0, 0] < 0.1
        assert found.pushed(0).startswith("pushed cube")
    deep = cube(opening + NEIGHBOUR - 0.005, 0.0, movable=movable)
    assert simulate(world_of(scene(deep)), upside()).reason.tolist() == [[Reason.IN_TABLE]]


def test_pushes_are_in_empty_space_and_drake_refuses_scenes() -> None:
    environment = scene(cube(0.2, 0.0, movable=True))
    empty = build_world(gripper(), ball(), Task(DEXGRASPBENCH, scene=environment))
    assert empty.model.nbody == build_world(gripper(), ball(), Task(DEXGRASPBENCH)).model.nbody and not empty.scene
    pytest.importorskip("pydrake")
    with pytest.raises(GraspRefineError, match="scene"):
        engine_of("drake", world_of(environment))
