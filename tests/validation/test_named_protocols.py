"""Named protocols by their consequences: what friction holds and just does not, what turns, what weighs how much.

All numbers are written out once more, as their sources have them.
"""

from dataclasses import replace
from math import pi, radians, sqrt

import numpy as np
import pytest
from mujoco.batch import Batch

from grasp_refine.core.se3 import distances, transform_from_pose
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.protocols.contact_model import ContactModel
from grasp_refine.scene.protocols.get_a_grip import GET_A_GRIP
from grasp_refine.scene.protocols.hugs import HUGS
from grasp_refine.scene.protocols.mujoco_default import MUJOCO_DEFAULT
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine.validation.creep import creep_of
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import close, push, simulate
from grasp_refine.validation.trials import Reason
from gripper import RADIUS, around, ball, gripper, lifted, weighing
from validation.test_protocol import critical_force, lever

PUSHED = {
    "dexgraspbench": (0.6, 1.0),
    "strict": (0.3, 1.0),
    "graspqp": (1.0, 3.0),
    "isaacgym": (3.0, 500.0 * 4.0 / 3.0 * pi * RADIUS**3 * 9.8),
}
"""Protocol -> sliding friction, and force of a push on the ball in newtons."""

LIFTED = {
    "tabletop": (0.6, 9.81, 0.1),
    "scene": (0.6, 9.81, 0.1),
    "hugs": (0.8, 10.0, 0.1),
    "get-a-grip": (0.9, 9.8, 0.2),
}
"""Protocol -> sliding friction, gravity in m/s^2, and height of the lift in metres."""

DEFAULTS = ContactModel("pyramidal", impratio=1.0, noslip_iterations=0)
"""Defaults of MuJoCo, written out once more."""

ACROSS = ("+y", "-y", "+z", "-z")
"""Directions along the plates."""


def centred(protocol: Protocol) -> Protocol:
    """The protocol without offsets of the object."""
    return replace(protocol, noise=Noise())


def test_all_are_tested() -> None:
    assert {*PUSHED, *LIFTED, MUJOCO_DEFAULT.name} == set(PROTOCOLS)


@pytest.mark.parametrize(
    ("name", "seconds", "check_s", "farthest", "degrees", "share", "closing_s"),
    [
        ("dexgraspbench", 2.0, 0.2, 0.05, 15, 1.0, 0.4),
        ("strict", 2.0, 0.2, 0.05, 15, 1.0, 0.4),
        ("graspqp", 0.5, 0.1, 0.03, 360, 0.5, 0.4),
        ("isaacgym", 1.664, 0.208, 0.1, 360, 1.0, 0.4),
        ("hugs", 1.0, 0.2, 0.05, 15, 1.0, 1.0),
        ("get-a-grip", 2.0, 0.2, 0.1, 45, 1.0, 0.4),
    ],
)
def test_times_and_limits_are_as_published(
    name: str, seconds: float, check_s: float, farthest: float, degrees: float, share: float, closing_s: float
) -> None:
    """Of the pushes or the lift, from one check to the next, and from one stage of closing to the next."""
    one = PROTOCOLS[name]
    step = one.timestep
    assert one.seconds == pytest.approx(seconds) and one.steps_per_check * step == pytest.approx(check_s)
    assert one.moves * one.steps_per_move * step == pytest.approx(closing_s)
    assert (one.farthest, one.required_share) == (farthest, share)
    assert one.steepest == pytest.approx(radians(degrees))


@pytest.mark.parametrize("name", PUSHED)
def test_friction_holds_a_push_up_to_twice_its_share_of_the_force(name: str) -> None:
    """Two plates that press with N hold a push F along them as long as 2 friction N > F."""
    friction, push = PUSHED[name]
    world = build_world(gripper(), ball(), Task(PROTOCOLS[name]))
    across = [direction in ACROSS for direction in world.protocol.directions]
    limit = push / (2 * friction)
    for factor, reason in ((1.2, Reason.HELD), (0.85, Reason.MOVED)):
        trials = simulate(world, around(factor * limit))
        assert (trials.reason[:, across] == reason).all(), factor
        assert (trials.reason[:, ~np.array(across)] == Reason.HELD).all(), "plates do not give way"


def test_in_the_default_contacts_of_mujoco_friction_creeps() -> None:
    """Plates that press with 1.2 times the limit lose the object slowly along them; without a push it stays."""
    assert MUJOCO_DEFAULT == replace(PROTOCOLS["dexgraspbench"], name="mujoco-default", palm="rigid", contact=DEFAULTS)
    world, motion = build_world(gripper(), ball(), Task(MUJOCO_DEFAULT)), around(1.2 * 1.0 / (2 * 0.6))
    trials = simulate(world, motion)
    across = [direction in ACROSS for direction in world.protocol.directions]
    assert (trials.reason[:, across] == Reason.MOVED).all() and (trials.time_s[:, across] > 0.5).all()
    creep = creep_of(world, motion, trials)
    assert creep is not None and (creep[0] < (1e-4, 1e-3)).all()
    # What firm contacts lose as well is no creep, and firm contacts have none.
    slipping = around(0.8 * 1.0 / (2 * 0.6))
    creep = creep_of(world, slipping, simulate(world, slipping))
    assert creep is not None and np.isnan(creep).all()
    assert creep_of(build_world(gripper(), ball(), Task(PROTOCOLS["strict"])), motion, trials) is None


@pytest.mark.parametrize("name", LIFTED)
def test_the_heaviest_object_that_friction_lifts(name: str) -> None:
    """Two plates that press with 4 N lift a mass m as long as 2 friction N > m g; a lost one stays on the table."""
    friction, gravity, lift = LIFTED[name]
    limit = 2 * friction * 4.0 / gravity
    for factor, held in ((0.8, True), (1.15, False)):
        protocol = centred(PROTOCOLS[name]).with_mass(factor * limit)
        trials = simulate(build_world(gripper(), ball(), Task(protocol)), lifted(around(4.0)))
        assert trials.success.tolist() == [held], factor
    assert PROTOCOLS[name].lift == lift


@pytest.mark.parametrize(("name", "friction", "gravity"), [("tabletop", 0.6, 9.81), ("hugs", 0.8, 10.0)])
def test_torsional_friction_carries_the_torque_of_a_lever(name: str, friction: float, gravity: float) -> None:
    """Its weight, lifted beside its middle, turns it in plates that press less than sliding and torsion need."""
    thing, arm = lever()
    limit = critical_force(friction, 0.02, 0.1 * gravity, arm)
    world = build_world(gripper(), thing, Task(PROTOCOLS[name].with_mass(0.1)))
    assert simulate(world, lifted(around(1.3 * limit))).success.all()
    assert (simulate(world, lifted(around(0.8 * limit))).reason == Reason.ROTATED).all()


def weighed(protocol: Protocol, obj: Object) -> float:
    return build_world(gripper(), obj, Task(protocol)).mass


def test_hugs_weighs_by_density_and_size() -> None:
    """At a size of 6 cm 700 kg/m^3, at twice the size a quarter of that; 0.5 kg at most."""
    side = 2 * 0.06 / sqrt(3)
    for factor in (0.5, 1.0, 1.2):
        cube = load_object(f"box:{','.join(3 * [str(factor * side)])}", unit="m", candidates=16)
        assert weighed(HUGS, cube) == pytest.approx(700.0 * side**3 * factor, rel=1e-6)
    sides = 0.3, 0.3, 0.2
    size = np.linalg.norm(sides) / 2
    heavy = load_object(f"box:{','.join(map(str, sides))}", unit="m", candidates=16)
    assert 700.0 * np.prod(sides) * (0.06 / size) ** 2 > 0.5
    assert weighed(HUGS, heavy) == pytest.approx(0.5, rel=1e-9)
    assert weighed(HUGS.with_mass(0.8), heavy) == pytest.approx(0.8, rel=1e-9)


def test_get_a_grip_weighs_by_density_alone() -> None:
    box = load_object("box:0.3,0.3,0.2", unit="m", candidates=16)
    assert weighed(GET_A_GRIP, box) == pytest.approx(500.0 * 0.018, rel=1e-6)


# --- the palm under load


def palm_under_load(protocol: Protocol, hand_kg: float) -> tuple[float, float]:
    """Largest shift in metres and turn in radians of the palm from its course while 1 kg is pushed or lifted.

    Shifts while it is lifted are those across the lift, on which it follows its set points a little later.
    """
    world = build_world(weighing(hand_kg), ball(), Task(centred(protocol)))
    motion = around(25.0)
    motion = lifted(motion, y=0.01) if protocol.tabletop else motion
    off: list[tuple[float, float]] = []

    def watch(batch: Batch) -> None:
        course = transform_from_pose(np.concatenate([batch.mocap_pos[:, 0], batch.mocap_quat[:, 0]], axis=1))
        palm = transform_from_pose(batch.qpos[:, world.root_at : world.root_at + 7])
        axes = slice(2 if protocol.tabletop else 3)
        shift = np.linalg.norm((palm - course)[:, axes, 3], axis=1)
        off.append((float(shift.max()), float(distances(palm, course)[1].max())))

    closed = close(world, motion, Conditions.nominal(world, 1))
    assert push(world, closed, on_step=watch).success.all()
    shift, turn = np.max(off, axis=0)
    return float(shift), float(turn)


@pytest.mark.parametrize("name", sorted({*PUSHED, *LIFTED} - {"dexgraspbench"}))
@pytest.mark.parametrize("hand_kg", [0.05, 5.0])
def test_the_palm_gives_way_to_no_load_whatever_it_weighs(name: str, hand_kg: float) -> None:
    """A weld as stiff as the hand is heavy once turned the palm of a light one by 14 degrees, the object with it."""
    shift, turn = palm_under_load(PROTOCOLS[name].with_mass(1.0), hand_kg)
    assert shift < 1e-4 and turn < radians(0.1)


def test_another_load_than_that_of_the_published_outcomes_is_held_rigidly() -> None:
    published = PROTOCOLS["dexgraspbench"]
    assert published.with_mass(published.mass).with_friction(published.friction) == published
    for changed in (published.with_mass(1.0), published.with_friction(0.8).with_mass(1.0)):
        shift, turn = palm_under_load(changed, 0.05)
        assert shift < 1e-4 and turn < radians(0.1)
    # Its own weld gives way, as in the program whose outcomes it reproduces.
    assert palm_under_load(replace(published, mass=1.0), 0.05)[1] > radians(5)
