"""Mass of the object: given, or by density, size and a largest mass; and what follows for the force that holds it."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import load_object
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_spec import TaskSpec
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.replay.record import record
from gripper import RADIUS, around, ball, gripper, two_balls
from refusals import refused

BOX, LARGER = "box:0.1,0.05,0.03", "box:0.2,0.1,0.06"


def weighed(protocol: Protocol, name: str = BOX) -> float:
    """What MuJoCo says that the object weighs, in kg."""
    world = build_world(gripper(), load_object(name, unit="m", candidates=16), Task(protocol))
    mass = float(world.model.body_mass[world.object_body])
    assert world.mass == pytest.approx(mass, rel=1e-12)
    return mass


def test_pieces_add_up():
    """Two balls of 2 cm at 1000 kg/m^3."""
    world = build_world(gripper(), two_balls(), Task(replace(DEXGRASPBENCH, density=1000.0)))
    assert world.mass == pytest.approx(2 * 1000.0 * 4 / 3 * np.pi * 0.02**3, rel=1e-6)


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
        *(({"required_share": share}, ("required_share", f"{share:g}")) for share in (0.0, 1.01, np.inf)),
        *(({"required_label": share}, ("required_label", f"{share:g}")) for share in (0.0, 1.5)),
    ],
)
def test_a_protocol_that_cannot_be_is_refused(fields: dict, named: tuple[str, ...]):
    with refused(GraspRefineError, "Protocol", *named):
        Protocol(**fields)


@pytest.mark.parametrize("fields", [{"count": -1}, {"offset": -0.1}, {"turn": np.inf}])
def test_offsets_that_cannot_be_are_refused(fields: dict):
    with refused(GraspRefineError, "Noise", *fields):
        Noise(**fields)
