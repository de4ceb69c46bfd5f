"""Demand of tasks: mass of the simulated object, and what of it counts."""

from dataclasses import replace

import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.demand import TOTAL_PRESSURE_N, Demand
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.validate import model_of


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_the_force_moves_the_simulated_object_with_the_acceleration_of_the_task(name: str) -> None:
    box, task = load_object("box:0.05,0.04,0.12"), Task(name)
    protocol, demand = PROTOCOLS[name], Demand.of(Task(name), box)
    world = build_world(model_of(load_hand("franka_hand")), box, task)
    assert demand.force_n == pytest.approx(world.model.body_mass[world.object_body] * protocol.acceleration)
    assert demand.friction == world.model.geom_friction[0, 0]


def test_a_density_gives_the_mass_of_a_box() -> None:
    protocol = replace(PROTOCOLS["dexgraspbench"], density=500.0)
    assert Demand.of(Task(protocol), load_object("box:0.1,0.1,0.2")).mass_kg == pytest.approx(1.0)


def test_without_a_task_it_is_that_of_dexgraspbench() -> None:
    demand = Demand.of(Task(), load_object("sphere:0.03"))
    assert demand == Demand() and (demand.load, demand.grip, demand.effort) == (1.0, 1.0, 1.0)
    assert demand.pressure_n == TOTAL_PRESSURE_N


@pytest.mark.parametrize(("mass", "friction", "newtons"), [(1.0, 0.6, 60.0), (1.0, 0.3, 120.0), (0.2, 0.6, 30.0)])
def test_pressure_rises_with_the_force_and_with_slipperiness(mass: float, friction: float, newtons: float) -> None:
    demand = Demand(mass_kg=mass, friction=friction)
    assert demand.pressure_n == pytest.approx(newtons)
    assert demand.effort == pytest.approx(10.0 * mass * 0.6 / friction)
