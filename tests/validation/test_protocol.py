"""What the named protocols do to an object: where it is pushed, what it weighs, what slips and what turns."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, pi

import numpy as np
import pytest
from mujoco.batch import Batch

from grasp_refine.closing.motion import Motion
from grasp_refine.geometry.pieces import Piece
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
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.robustness import holds_at
from grasp_refine.validation.simulation import close, push
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.simulation_options import Robustness, Simulation
from gripper import RADIUS, around, ball, gripper

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
    lasts = {"graspqp": 0.5, "isaacgym": 1.664}.get(protocol.name, 2.0)
    assert len(path) * protocol.timestep == pytest.approx(lasts), "each push lasts as long as its protocol says"
    expected = fallen(protocol.acceleration, steps, protocol.timestep)[:, None, None] * np.array(
        [UNIT[name] for name in trials.directions], dtype=float
    )
    np.testing.assert_allclose(path[..., :3], np.repeat(expected[:, None], count, axis=1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(path[..., 3:], np.broadcast_to([1, 0, 0, 0], (*path.shape[:-1], 4)), atol=1e-9)


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


def with_own_friction() -> HandModel:
    """The gripper, whose geoms have a friction of their own, which is not for the hand to say."""
    made = gripper()
    for geom in made.spec.geoms:
        geom.friction, geom.priority, geom.condim = [2.0, 0.1, 0.1], 1, 6
    return made


def turns(world: World, motion: Motion) -> np.ndarray:
    """How the grasps end when the push has a lever about the axis of the plates, up and down (N, 2)."""
    closed = close(world, motion, Conditions.nominal(world, len(motion)))
    return push(world, closed, directions=("+z", "-z")).reason


@pytest.mark.parametrize("hand", [gripper, with_own_friction])
@pytest.mark.parametrize(("protocol", "friction"), [("dexgraspbench", None), ("dexgraspbench", 1.2), ("strict", 0.2)])
def test_torsional_friction_decides_in_proportion_to_the_coefficient(
    hand: Callable[[], HandModel], protocol: str, friction: float | None
) -> None:
    """The force that keeps the object from turning is the one that the published coefficients say, for each option."""
    published = {"dexgraspbench": (0.6, 0.02), "strict": (0.3, 0.002)}[protocol]
    at = published[0] if friction is None else friction
    torsion = published[1] * at / published[0]
    thing, arm = lever()
    limit = critical_force(at, torsion, 1.0, arm)
    assert limit > 1.25 * critical_force(at, np.inf, 1.0, arm), "torsion, not sliding, decides"
    parts = around(1.3 * limit), around(0.8 * limit)
    motion = Motion(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("T_world_root", "q")))
    expected = [[Reason.HELD] * 2, [Reason.ROTATED] * 2]
    # Half of the time is enough to turn away.
    asked = Simulation(seconds=1.0).changed(load_protocol(protocol).with_friction(friction))
    np.testing.assert_array_equal(turns(build_world(hand(), thing, Task(asked)), motion), expected)
    if friction is not None:
        # `--frictions`: the same world, other rows.
        only_turned = replace(Simulation(seconds=1.0).changed(load_protocol(protocol)), directions=("+z", "-z"))
        world = build_world(hand(), thing, Task(only_turned))
        np.testing.assert_array_equal(holds_at(world, motion, (friction,)), [[True], [False]])
