"""Mass of the object: given, or by density, size and a largest mass; and what follows for the force that holds it."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import load_object
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_spec import TaskSpec
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason
from gripper import RADIUS, around, ball, gripper, two_balls
from refusals import refused

SIDES = np.array([0.1, 0.05, 0.03])
BOX, LARGER = "box:0.1,0.05,0.03", "box:0.2,0.1,0.06"


def weighed(protocol: Protocol, name: str = BOX) -> float:
    """What MuJoCo says that the object weighs, in kg."""
    world = build_world(gripper(), load_object(name, unit="m", candidates=16), Task(protocol))
    mass = float(world.model.body_mass[world.object_body])
    assert world.mass == pytest.approx(mass, rel=1e-12)
    return mass


def test_density_gives_the_mass_of_a_box():
    assert weighed(DEXGRASPBENCH) == pytest.approx(0.1, rel=1e-12)
    assert weighed(replace(DEXGRASPBENCH, density=700.0)) == pytest.approx(700.0 * SIDES.prod(), rel=1e-6)


def test_mass_has_a_bound():
    heavy = replace(DEXGRASPBENCH, density=7800.0)
    assert weighed(heavy) == pytest.approx(1.17, rel=1e-6)
    assert weighed(replace(heavy, largest_mass=0.5)) == pytest.approx(0.5, rel=1e-12)
    assert weighed(replace(heavy, largest_mass=2.0)) == pytest.approx(1.17, rel=1e-6)


def test_density_falls_with_the_square_of_the_size():
    """Twice as large, 8 times the volume at a quarter of the density: twice the mass."""
    size = float(np.linalg.norm(SIDES)) / 2
    by_size = replace(DEXGRASPBENCH, density=700.0, density_size=size)
    assert weighed(by_size) == pytest.approx(700.0 * SIDES.prod(), rel=1e-6)
    assert weighed(by_size, LARGER) == pytest.approx(2 * 700.0 * SIDES.prod(), rel=1e-6)


def test_pieces_add_up():
    """Two balls of 2 cm at 1000 kg/m^3."""
    world = build_world(gripper(), two_balls(), Task(replace(DEXGRASPBENCH, density=1000.0)))
    assert world.mass == pytest.approx(2 * 1000.0 * 4 / 3 * np.pi * 0.02**3, rel=1e-6)


@pytest.mark.parametrize("density", [1000.0, 3000.0])
def test_the_force_that_holds_grows_with_density(density: float):
    """Two plates hold a ball that weighs m and is pushed with m a as long as 2 friction N > m a."""
    protocol = replace(DEXGRASPBENCH, density=density)
    mass = density * 4 / 3 * np.pi * RADIUS**3
    limit = mass * protocol.acceleration / (2 * protocol.friction)
    world = build_world(gripper(), ball(), Task(protocol))
    across = ["xyz".index(name[1]) > 0 for name in protocol.directions]
    assert (simulate(world, around(1.15 * limit)).reason[:, across] == Reason.HELD).all()
    assert (simulate(world, around(0.85 * limit)).reason[:, across] == Reason.MOVED).all()


def test_a_replay_reports_the_force_that_acted():
    world = build_world(gripper(), ball(), Task(replace(DEXGRASPBENCH, density=1000.0, checks=1)))
    replay = record(world, around(8.0), "+y", name="ball", hand="gripper")
    assert replay is not None
    np.testing.assert_allclose(replay.force, [0.0, 10.0 * 1000.0 * 4 / 3 * np.pi * RADIUS**3, 0.0], rtol=1e-6)


def test_a_given_mass_replaces_a_density():
    by_density = replace(DEXGRASPBENCH, density=700.0, density_size=0.06, largest_mass=0.5)
    assert weighed(by_density.with_mass(0.2)) == pytest.approx(0.2, rel=1e-12)
    assert by_density.with_mass(None) is by_density
    assert TaskSpec(mass=0.2).chosen_protocol(in_scene=False) == replace(DEXGRASPBENCH, mass=0.2, palm="rigid")


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"density": 0.0}, ("density", "0")),
        ({"density": -1.0}, ("density", "-1")),
        ({"density": 700.0, "largest_mass": np.inf}, ("largest_mass", "inf")),
        ({"density": 700.0, "density_size": 0.0}, ("density_size", "0")),
        ({"largest_mass": 0.5}, ("largest_mass", "density")),
        ({"density_size": 0.06}, ("density_size", "density")),
    ],
)
def test_a_mass_that_cannot_be_is_refused(fields: dict, named: tuple[str, ...]):
    with refused(GraspRefineError, "Protocol", *named):
        Protocol(**fields)
