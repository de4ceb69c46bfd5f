"""MuJoCo follows trajectories: objects held and lifted, hit and pushed, and the tracking error of the palm."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import grasp_refine as gr
from ball_hand import ball_hand
from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, pose_from_transform, transform
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.execution import execute
from grasp_refine.motion.executions import NUMBERS, Executions
from grasp_refine.motion.plan import LEGS, MotionPlan, PlanStatus, TrajectoryOptions, plan_motions
from grasp_refine.motion.trajectory import Trajectory, trajectory
from grasp_refine.motion.trajectory_files import PlannedTrajectories
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.validate import model_of

THING = load_object("box:0.05,0.05,0.12")
T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])


def body(name: str, size: list[float], place: tuple[float, float, float], *, movable: bool = False) -> EnvironmentBody:
    """Return a box of a scene whose world is the frame of the object."""
    T = np.eye(4)
    T[:3, 3] = place
    return EnvironmentBody(name, build_body(name, [box(size)], candidates=16), T, movable=movable)


TABLE = body("table", [0.6, 0.6, 0.02], (0.0, 0.0, -0.07))


@pytest.fixture(scope="module", params=[False, True], ids=["floats", "on an arm"])
def hand(request: pytest.FixtureRequest) -> Hand:
    """Return a gripper, alone or on an arm."""
    alone = load_hand("franka_hand", candidates=32)
    return mount(load_hand("ur5e", candidates=32), alone) if request.param else alone


@pytest.fixture(scope="module")
def timed(hand: Hand) -> Trajectory:
    """Return the trajectory of a grasp of the box from above, planned above the table alone."""
    T_palm, fingers = transform_from_rpy([0.0, 0.0, 0.1434, 180.0, 0.0, 0.0]), np.array([[0.036], [0.025], [0.0]])
    T, q = np.tile(T_palm, (3, 1, 1)), fingers
    if hand.arm is not None:
        ours = GraspSet.of(hand, T_palm[None], np.zeros((1, len(hand.joint_names))))
        placed, _ = on_arm(replace(ours, base_link=hand.palm, joint_names=hand.joint_names[-1:], q=q[:1]), hand, T_BASE)
        q = np.concatenate([np.tile(placed.q[:, hand.arm_joints], (3, 1)), fingers], axis=1)
        T = np.tile(T_BASE, (3, 1, 1))
    scene = Scene(hand, THING, T[1], q[1], task=Task(scene=Environment((TABLE,), np.eye(4))))
    (plan,) = plan_motions(scene, Motion(T[None], q[None]), TrajectoryOptions(approach=0.08))
    assert plan.free, plan.why
    return trajectory(hand, plan)


def world_of(hand: Hand, *bodies: EnvironmentBody, protocol: Protocol = SCENE, obj: Object = THING) -> World:
    """Return the world of the hand and an object among bodies on the table."""
    environment = Environment((TABLE, *bodies), np.eye(4))
    return build_world(model_of(hand), obj, Task(protocol, scene=environment))


def followed(hand: Hand, timed: list[Trajectory | None], *bodies: EnvironmentBody, **settings: Any) -> Executions:
    """Return what happens on trajectories in such a world."""
    return execute(world_of(hand, *bodies, **settings), hand, timed, threads=1)


def test_free_trajectory_lifts_the_object_as_in_a_plain_simulation(hand: Hand, timed: Trajectory) -> None:
    """By 0.1 m, hitting nothing; all numbers are those of MuJoCo's own steps, and independent of other grasps."""
    far = body("far", [0.04, 0.04, 0.04], (0.2, 0.2, -0.037), movable=True)
    world = world_of(hand, far)
    found = execute(world, hand, [None, timed], threads=1)
    assert found.followed.tolist() == [False, True] and found.held.tolist() == [False, True]
    assert found.hits[1] == () and np.isnan(found.lifted_m[0]) and found.document(0) is None
    model, made = world.model, world.hand
    data = mujoco.MjData(model)
    _, _, path, leg = timed.sampled(0.04)
    joints = path.q @ made.matrix.T + made.offset
    roots = pose_from_transform(path.T_world_root @ made.T_base_root)
    wanted = palm_poses(hand, path.T_world_root, path.q)
    if world.root_at is not None:
        data.qpos[world.root_at : world.root_at + 7] = roots[0]
    data.qpos[world.joints_at], tracking = joints[0], []
    data.mocap_pos[0], data.mocap_quat[0] = np.split(roots[0], [3])
    for tick in range(1, len(path)):
        data.ctrl[:] = world.control @ joints[tick]
        data.mocap_pos[0], data.mocap_quat[0] = np.split(roots[tick], [3])
        mujoco.mj_step(model, data, nstep=10)
        mujoco.mj_kinematics(model, data)
        tracking.append(apart(wanted[tick], data.body(f"hand/{hand.palm}")))
    thing, moved = data.body("object"), data.body("scene/far").xpos - [0.2, 0.2, -0.037]
    rise = wanted[-1, 2, 3] - wanted[np.flatnonzero(leg < LEGS.index("lift"))[-1], 2, 3]
    away, turned = apart(transform(np.eye(3), np.array([0.0, 0.0, rise])), thing)
    expected = [thing.xpos[2], away, turned, *np.max(tracking, axis=0), np.linalg.norm(moved)]
    numbers = [getattr(found, name)[1] for name in NUMBERS]
    np.testing.assert_allclose([*numbers, found.pushed_m[1, 0]], expected, rtol=1e-3, atol=1e-6)
    # It lags behind, but comes to rest.
    assert abs(found.lifted_m[1] - 0.1) < 3e-3 and 0.0 < found.tracking_m[1] < 0.01 and found.tracking_rad[1] < 0.02
    if hand.arm is None:
        limits = {"farthest": float(found.displacement_m[1]), "steepest": float(found.angle_rad[1])}
        for lower, held in (({}, True), ({"farthest": 0.99}, False), ({"steepest": 0.99}, False)):
            at = {name: lower.get(name, 1.01) * value for name, value in limits.items()}
            strict = replace(world, protocol=replace(world.protocol, **at))
            assert execute(strict, hand, [timed], threads=1).held.tolist() == [held]


def test_objects_are_lifted_along_up_of_the_scene(hand: Hand, timed: Trajectory) -> None:
    """In a scene that is tilted by 20 degrees, a movement along z of the object by 0.1 m lifts by cos 20 of it."""
    if hand.arm is not None:
        return
    tilt = transform_from_rpy([0.0, 0.0, 0.0, 20.0, 0.0, 0.0])
    environment = Environment((replace(TABLE, T_world_body=tilt @ TABLE.T_world_body),), tilt)
    world = build_world(model_of(hand), THING, Task(SCENE, scene=environment))
    found = execute(world, hand, [timed], threads=1)
    assert abs(found.lifted_m[0] - 0.1 * np.cos(np.radians(20.0))) < 2e-3


def apart(T: np.ndarray, found: Any) -> tuple[float, float]:
    """Return the distance and the rotation between a pose and a body in MuJoCo."""
    there = transform(found.xmat.reshape(3, 3), found.xpos)
    (away,), (turned,) = distances(T[None], there[None])
    return away, turned


def test_object_in_the_way_of_the_approach_is_named_with_each_link_once(hand: Hand, timed: Trajectory) -> None:
    """A box that is wider than the open jaws; one that fits is touched without a hit."""
    (hits,) = followed(hand, [timed], obj=load_object("box:0.05,0.08,0.12")).hits
    assert any(hit.startswith("approach: panda_") and "finger and box" in hit for hit in hits)
    assert len(set(hits)) == len(hits)
    assert not any(hit.startswith(("close", "squeeze")) and "box" in hit for hit in hits)


def test_an_obstacle_is_named_with_its_leg(hand: Hand, timed: Trajectory) -> None:
    """A bar that the planner did not know stops a finger as the hand comes; a ledge above, the box as it rises."""
    bar = body("bar", [0.3, 0.012, 0.01], (0.0, 0.05, 0.05))
    found = followed(hand, [timed], bar)
    assert any(hit.startswith("approach: panda_") and hit.endswith("and bar") for hit in found.hits[0])
    # Beside the fingers and below the palm.
    ledge = body("ledge", [0.05, 0.01, 0.006], (0.042, 0.0, 0.067))
    (hits,) = followed(hand, [timed], ledge).hits
    assert hits and hits[0] == f"lift: {THING.name} and ledge"


def test_neighbours_that_are_pushed_are_reported_by_how_far(hand: Hand, timed: Trajectory) -> None:
    """A plate between a finger and the box is taken along; a block out of the way stays."""
    near = body("near", [0.04, 0.006, 0.12], (0.0, 0.0285, 0.0), movable=True)
    far = body("far", [0.04, 0.04, 0.04], (0.2, 0.2, -0.04), movable=True)
    found = followed(hand, [timed], near, far)
    pushed = dict(zip(found.neighbours, found.pushed_m[0].tolist(), strict=True))
    assert pushed["near"] > 0.08 and pushed["far"] < 1e-3
    assert any("and near" in hit for hit in found.hits[0]) and "pushed near" in " ".join(found.lines())


def test_object_that_slips_is_not_held(hand: Hand, timed: Trajectory) -> None:
    """Without friction it stays on the table, 0.1 m from where it should be."""
    found = followed(hand, [timed], protocol=replace(SCENE, friction=1e-3))
    assert not found.held[0] and abs(found.lifted_m[0]) < 0.02 and found.displacement_m[0] > 0.08
    assert "lost" in " ".join(found.lines())


def test_protocols_that_push_are_refused(hand: Hand, timed: Trajectory) -> None:
    """Those that lift are named."""
    with pytest.raises(GraspRefineError, match=r"dexgraspbench.*scene"):
        followed(hand, [timed], protocol=DEXGRASPBENCH)


def test_trajectories_of_another_hand_are_not_followed(tmp_path: Path) -> None:
    """Both hands are named."""
    hand = load_hand("franka_hand", candidates=32)
    refined = gr.refine(hand, THING, GraspSet.of(hand, np.eye(4)[None], np.zeros((1, 1))), gr.Config(starts=1))
    labels = np.array(["box"]), np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    other = PlannedTrajectories(ball_hand(tmp_path), *labels, (MotionPlan(PlanStatus.NO_GRASP, "", ()),))
    with pytest.raises(GraspRefineError, match="balls.*franka_hand"):
        gr.follow_trajectories(refined, other)
