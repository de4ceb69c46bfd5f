"""What the named protocols do to an object: where it is pushed, what it weighs, what slips and what turns."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, pi
from pathlib import Path

import numpy as np
import pytest
from mujoco.batch import Batch

from grasp_refine.closing.motion import Motion
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.robustness import holds_at
from grasp_refine.validation.simulation import close, push, simulate
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.simulation_options import Robustness, Simulation
from gripper import KP, RADIUS, around, ball, gripper
from made_hands import inertial, link, made_hand, slide, solid

UNIT = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
"""The six directions, written out once more."""

PUSHED = [protocol for protocol in PROTOCOLS.values() if not protocol.tabletop]


def away(count: int = 1) -> Motion:
    """A gripper far away from the object, which never moves."""
    motion = around(0.0, count=count)
    T, q = motion.T_world_root.copy(), np.full_like(motion.q, 0.2)
    T[..., :3, 3] += 100.0
    return Motion(T, q)


def fallen(acceleration: float, steps: int | np.ndarray, timestep: float) -> float | np.ndarray:
    """Way after so many steps from rest: velocity first, then position, a dt^2 (1 + 2 + ... + n)."""
    return acceleration * timestep**2 * steps * (steps + 1) / 2


@pytest.mark.parametrize("protocol", [*PUSHED, replace(DEXGRASPBENCH, mass=0.3, acceleration=4.0)])
def test_a_free_object_is_pushed_along_the_named_direction(protocol: Protocol) -> None:
    """A push along -z that acted along +z once failed no test."""
    world = build_world(gripper(), ball(), Task(protocol))
    count = 2
    closed = close(world, away(count), Conditions.nominal(world, count))
    paths: list[np.ndarray] = []

    def watch(batch: Batch) -> None:
        paths.append(batch.qpos[:, world.object_at : world.object_at + 7].copy())

    trials = push(world, closed, to_the_end=True, on_step=watch)
    assert sorted(trials.directions) == sorted(UNIT)
    assert (trials.reason == Reason.MOVED).all()
    path = np.stack(paths).reshape(-1, count, len(UNIT), 7)
    steps = np.arange(1, len(path) + 1)
    lasts = 0.5 if protocol.name == "graspqp" else 2.0
    assert len(path) * protocol.timestep == pytest.approx(lasts), "each push lasts two seconds, or half a second"
    expected = fallen(protocol.acceleration, steps, protocol.timestep)[:, None, None] * np.array(
        [UNIT[name] for name in trials.directions], dtype=float
    )
    np.testing.assert_allclose(path[..., :3], np.repeat(expected[:, None], count, axis=1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(path[..., 3:], np.broadcast_to([1, 0, 0, 0], (*path.shape[:-1], 4)), atol=1e-9)


def test_a_heavier_object_needs_so_much_more_force() -> None:
    """The object pushes with its own mass: three times of it slip off a force that held one."""
    heavy = replace(DEXGRASPBENCH, mass=3 * DEXGRASPBENCH.mass)
    limit = heavy.mass * heavy.acceleration / (2 * heavy.friction)
    world = build_world(gripper(), ball(), Task(heavy))
    across = ["xyz".index(name[1]) > 0 for name in heavy.directions]
    assert (simulate(world, around(1.15 * limit)).reason[:, across] == Reason.HELD).all()
    assert (simulate(world, around(0.85 * limit)).reason[:, across] == Reason.MOVED).all()


def test_options_are_in_the_units_that_they_say() -> None:
    asked = Simulation(seconds=0.6).changed(TABLETOP.with_mass(0.25))
    assert (asked.mass, asked.checks * asked.steps_per_check * asked.timestep) == (0.25, pytest.approx(0.6))
    assert asked == replace(TABLETOP, mass=0.25, checks=asked.checks)
    noise = Robustness(noise=3, noise_offset=0.01, noise_degrees=90.0).checks(None).noise
    assert (noise.count, noise.offset, noise.turn) == (3, 0.01, pytest.approx(pi / 2))
    assert Robustness(noise=3).checks(None).noise == Noise(3)


def test_on_a_tabletop_the_object_falls_and_the_hand_does_not() -> None:
    world = build_world(gripper(), ball(), Task(TABLETOP, table=Plane(offset=-50.0)))
    poses: list[np.ndarray] = []
    motion = away()
    closed = close(
        world, motion, Conditions.nominal(world, 1), on_step=lambda batch: poses.append(batch.qpos[0].copy())
    )
    assert closed.reason.tolist() == [Reason.EJECTED_WHILE_CLOSING]
    path = np.stack(poses[1:])
    falls = fallen(9.81, np.arange(1, len(path) + 1), TABLETOP.timestep)
    np.testing.assert_allclose(path[:, world.object_at : world.object_at + 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(path[:, world.object_at + 2], -falls, rtol=1e-9)
    np.testing.assert_allclose(
        path[:, world.root_at : world.root_at + 3], np.tile(motion.T_world_root[0, 0, :3, 3], (len(path), 1)), atol=1e-6
    )


# --- what turns


SIDE = 0.15
"""How far to the side of the ball between the plates a second one hangs, in metres."""


def lever() -> tuple[Object, float]:
    """A ball with another one at its side, and how far beside the first its centre of mass is, in metres."""
    none = np.zeros((0, 3), dtype=int)
    pieces = [Piece(np.zeros((1, 3)), none, RADIUS), Piece(np.array([[0.0, SIDE, 0.0]]), none, 0.025)]
    made = Object("lever", ball().mesh, convex=False, supplied=tuple(pieces), candidates=16)
    volumes = RADIUS**3, 0.025**3
    return made, SIDE * volumes[1] / sum(volumes)


def critical_force(friction: float, torsion: float, push: float, arm: float) -> float:
    """The force in newtons with which two plates must press so that a push beside them turns nothing.

    Each carries half of the push F and half of its torque F d; a contact with an elliptic cone holds them as long as
    (f / friction)^2 + (t / torsion)^2 is below the square of the normal force.
    """
    return push / 2 * hypot(1 / friction, arm / torsion)


def plates(folder: Path) -> Hand:
    """The gripper of `gripper.py` as a URDF: plates that slide together, one joint each."""

    def plate(name: str, side: int) -> str:
        place, block = (0, 0.02 * side, 0.1), solid("box 0.01 0.08 0.08", (0.005 * side, -0.02 * side, 0))
        return link(name, inertial(0.05, (1e-4, 1e-4, 1e-4)), block) + slide(
            f"{name}_j", "palm", name, at=place, axis=(side, 0, 0), limits=(-0.2, 0.2), effort=1000, velocity=None
        )

    toml = f"actuator = {{ kp = {KP}, damping = 5, frictionloss = 0 }}"
    palm = link("palm", inertial(1, (0.01, 0.01, 0.01)))
    return made_hand(folder, palm, plate("left", -1), plate("right", 1), name="plates", toml=toml)


def plates_mjcf(folder: Path) -> HandModel:
    """The same hand from an MJCF, whose geoms have a friction of their own, which is not for the hand to say."""
    hand, path = plates(folder), folder / "plates.xml"
    parts = "".join(
        f'<body name="{name}" pos="0 {0.02 * side} 0.1">'
        f'<joint name="{name}_j" type="slide" axis="{side} 0 0" damping="5"/>'
        f'<geom type="box" size="0.005 0.04 0.04" pos="{0.005 * side} {-0.02 * side} 0" mass="0.05"'
        ' friction="2 0.1 0.1" priority="1" condim="6"/></body>'
        for name, side in (("left", -1), ("right", 1))
    )
    servos = "".join(f'<position joint="{name}_j" kp="{KP}"/>' for name in ("left", "right"))
    path.write_text(
        '<mujoco><worldbody><body name="palm"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        f"{parts}</body></worldbody><actuator>{servos}</actuator></mujoco>"
    )
    return mjcf_model(hand, path)


def pressing(hand: HandModel, *forces: float) -> Motion:
    """Closing on the ball until each plate presses with one of the forces, in newtons, for any of the grippers."""
    motions = [around(force) for force in forces]
    T, q = (np.concatenate([getattr(motion, name) for motion in motions]) for name in ("T_world_root", "q"))
    return Motion(T, q if hand.matrix.shape[1] == 1 else np.concatenate([q, q], axis=-1) / 2)


HANDS: dict[str, Callable[[Path], HandModel]] = {
    "gripper": lambda folder: gripper(),
    "urdf": lambda folder: urdf_model(plates(folder)),
    "mjcf": plates_mjcf,
}


def turns(world: World, motion: Motion) -> np.ndarray:
    """How the grasps end when the push has a lever about the axis of the plates, up and down (N, 2)."""
    closed = close(world, motion, Conditions.nominal(world, len(motion)))
    return push(world, closed, directions=("+z", "-z")).reason


@pytest.mark.parametrize("kind", HANDS)
@pytest.mark.parametrize("protocol", ["dexgraspbench", "strict"])
@pytest.mark.parametrize("friction", [None, 0.2, 1.2])
def test_torsional_friction_decides_in_proportion_to_the_coefficient(
    tmp_path: Path, kind: str, protocol: str, friction: float | None
) -> None:
    """The force that keeps the object from turning is the one that the published coefficients say, for each option."""
    published = {"dexgraspbench": (0.6, 0.02), "strict": (0.3, 0.002)}[protocol]
    at = published[0] if friction is None else friction
    torsion = published[1] * at / published[0]
    thing, arm = lever()
    limit = critical_force(at, torsion, 1.0, arm)
    assert limit > 1.25 * critical_force(at, np.inf, 1.0, arm), "torsion, not sliding, decides"
    hand = HANDS[kind](tmp_path)
    motion = pressing(hand, 1.3 * limit, 0.8 * limit)
    expected = [[Reason.HELD] * 2, [Reason.ROTATED] * 2]
    # Half of the time is enough to turn away.
    asked = Simulation(seconds=1.0).changed(load_protocol(protocol).with_friction(friction))
    np.testing.assert_array_equal(turns(build_world(hand, thing, Task(asked)), motion), expected)
    if friction is not None:
        # `--frictions`: the same world, other rows.
        only_turned = replace(Simulation(seconds=1.0).changed(load_protocol(protocol)), directions=("+z", "-z"))
        world = build_world(hand, thing, Task(only_turned))
        np.testing.assert_array_equal(holds_at(world, motion, (friction,)), [[True], [False]])
