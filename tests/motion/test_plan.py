"""Plans of grasps: swept for collisions, and timed by the speed limits of the joints."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import grasp_refine as gr
from grasp_refine.closing.motion import Motion
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, exp_se3, transform_from_pose
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.paths import HandPath, straight
from grasp_refine.motion.plan import LEGS, WAYPOINTS, MotionPlan, PlanStatus, TrajectoryOptions, plan_motions
from grasp_refine.motion.sweep import Sweep
from grasp_refine.motion.trajectory import PALM_SPEED, SPEED_SHARE, speed_limits, trajectory
from grasp_refine.motion.trajectory_files import PlannedTrajectories
from grasp_refine.objects.object import Object, load_object
from grasp_refine.problem.arms import arm_clearance
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task

T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])
OPEN_M = 0.036


@pytest.fixture(scope="module")
def hand() -> Hand:
    """Return a gripper."""
    return load_hand("franka_hand", candidates=32)


@pytest.fixture(scope="module")
def whole(hand: Hand) -> Hand:
    """Return it on an arm."""
    return mount(load_hand("ur5e", candidates=32), hand)


@pytest.fixture(scope="module")
def thing() -> Object:
    """Return a box that the gripper takes along y."""
    return load_object("box:0.05,0.05,0.12")


def obstacle(name: str, size: tuple[float, float, float], place: tuple[float, float, float]) -> EnvironmentBody:
    """Return a box beside the object."""
    T = np.eye(4)
    T[:3, 3] = place
    return EnvironmentBody(name, build_body(name, [box(size)], candidates=16), T)


def grasp(hand: Hand, thing: Object, *bodies: EnvironmentBody) -> tuple[Scene, Motion]:
    """Return a grasp from above, the tips 2 cm below the top, with the fingers open before it and on the box at it."""
    T_palm = transform_from_rpy([0.0, 0.0, 0.06 - 0.02 + 0.1034, 180.0, 0.0, 0.0])
    fingers = np.array([[OPEN_M], [0.025], [0.0]])
    T, q = np.tile(T_palm, (3, 1, 1)), fingers
    if hand.arm is not None:
        ours = GraspSet.of(hand, T_palm[None], np.zeros((1, len(hand.joint_names))))
        of_hand = replace(ours, base_link=hand.palm, joint_names=hand.joint_names[-1:], q=fingers[:1])
        placed, _ = on_arm(of_hand, hand, T_BASE, clearance=arm_clearance(hand, thing, Task()))
        q = np.concatenate([np.tile(placed.q[:, hand.arm_joints], (3, 1)), fingers], axis=1)
        T = np.tile(T_BASE, (3, 1, 1))
    environment = Environment(bodies, np.eye(4)) if bodies else None
    return Scene(hand, thing, T[1], q[1], task=Task(scene=environment)), Motion(T[None], q[None])


def test_palm_of_an_arm_moves_on_a_straight_line(whole: Hand, thing: Object) -> None:
    """To a micrometre and without turning, the base and the fingers still; it ends where the arm does."""
    scene, motion = grasp(whole, thing)
    along = np.array([0.02, -0.03, 0.1])
    path, reached = straight(whole, motion.T_world_root[0, 1], motion.q[0, 1], along)
    T = palm_poses(whole, path.T_world_root, path.q)
    assert reached and (path.T_world_root == T_BASE).all()
    expected = T[0, :3, 3] + np.linspace(0.0, 1.0, len(path))[:, None] * along
    np.testing.assert_allclose(T[:, :3, 3], expected, atol=1e-6)
    assert distances(np.tile(T[:1], (len(T), 1, 1)), T)[1].max() < 1e-6
    assert (path.q[:, ~whole.arm_joints] == motion.q[0, 1, -1]).all()
    beyond, reached = straight(whole, motion.T_world_root[0, 1], motion.q[0, 1], np.array([2.0, 0.0, 0.0]))
    assert not reached and 2 < len(beyond) < 100


@pytest.mark.parametrize("on_arm", [False, True])
def test_free_plan_has_all_legs_and_passes_the_stages(hand: Hand, whole: Hand, thing: Object, on_arm: bool) -> None:
    """Up and down above the box, 0.1 m each."""
    which = whole if on_arm else hand
    scene, motion = grasp(which, thing)
    (plan,) = plan_motions(scene, motion)
    assert plan.free and plan.why == "" and len(plan.legs) == len(LEGS)
    approach, close, squeeze, lift = plan.legs
    for path, stage in ((approach, 0), (close, 1), (squeeze, 2)):
        np.testing.assert_allclose(path.q[-1], motion.q[0, stage], atol=1e-9)
    palms = palm_poses(which, lift.T_world_root, lift.q)
    np.testing.assert_allclose(palms[-1, :3, 3] - palms[0, :3, 3], [0.0, 0.0, 0.1], atol=1e-6)
    assert plan.direction is not None
    np.testing.assert_allclose(plan.direction, [0.0, 0.0, 1.0], atol=1e-6)


def test_thin_wall_between_free_poses_is_found(hand: Hand, thing: Object) -> None:
    """Both ends of the path are free; the sweep names link and wall, and the place is in the wall."""
    wall = obstacle("wall", (0.4, 0.4, 0.002), (0.0, 0.0, 0.24))
    scene, motion = grasp(hand, thing, wall)
    T = np.tile(motion.T_world_root[0, 1], (2, 1, 1))
    T[0, 2, 3] = 0.5
    path = HandPath(T, np.tile(motion.q[0, 0], (2, 1)))
    met = Sweep(scene, HandObject.of(scene)).obstruction(path)
    assert met is not None and met.second == "wall" and met.first in scene.links
    assert abs(met.place[2] - 0.24) < 0.006 and 0.0 < met.share < 1.0
    # By brute force: all links at many poses of the path.
    links = tuple(link.name for link in hand.links if link.body is not None)
    pairs = Pairs.against(tuple(hand.links_by_name[name].solid for name in links), wall.body)
    poses = path.at(np.linspace(0.0, 1.0, 2001))
    T_link = Chain(hand, links)(poses.T_world_root, poses.q).T_world_link
    apart = query(pairs, T_link, np.broadcast_to(wall.T_world_body, T_link.shape)).distance
    first = (apart < -2e-4).any(axis=1).argmax() / 2000
    assert abs(first - met.share) < 0.03


def test_another_direction_is_taken_where_the_first_is_blocked(hand: Hand, thing: Object) -> None:
    """A shelf above the palm leaves a tilted approach; one all around leaves none, and is named."""
    shelf = obstacle("shelf", (0.02, 0.3, 0.02), (0.0, 0.0, 0.25))
    scene, motion = grasp(hand, thing, shelf)
    (plan,) = plan_motions(scene, motion, TrajectoryOptions(lift=0.0))
    assert plan.free and plan.direction is not None and plan.direction[2] < 0.99
    cage = obstacle("cage", (0.6, 0.6, 0.02), (0.0, 0.0, 0.19))
    scene, motion = grasp(hand, thing, cage)
    (plan,) = plan_motions(scene, motion)
    assert (
        plan.status == PlanStatus.BLOCKED and "cage" in plan.why and "approach" in plan.why and "panda_hand" in plan.why
    )


def test_object_that_is_lifted_into_a_shelf_is_named(hand: Hand, thing: Object) -> None:
    """The hand passes beside the beam, the box does not."""
    wide = load_object("box:0.3,0.05,0.12")
    beam = obstacle("beam", (0.02, 0.3, 0.02), (0.13, 0.0, 0.12))
    scene, motion = grasp(hand, wide, beam)
    (plan,) = plan_motions(scene, motion)
    assert plan.status == PlanStatus.BLOCKED and plan.why.startswith("lift: object and beam"), plan.why
    assert plan_motions(*grasp(hand, wide))[0].free


def test_links_of_the_arm_are_swept_too(whole: Hand, thing: Object) -> None:
    """A post in the last wrist, where the palm has it, blocks all plans; the ground of the base does not."""
    stand = obstacle("stand", (0.2, 0.2, 0.2), (-0.5, 0.0, -0.15))
    assert plan_motions(*grasp(whole, thing, stand))[0].free
    scene, motion = grasp(whole, thing)
    post = obstacle("post", (0.02, 0.02, 0.02), in_link(whole, motion, "wrist_3_link", (0.0, 0.0, -0.02)))
    (plan,) = plan_motions(*grasp(whole, thing, post))
    assert plan.status == PlanStatus.BLOCKED and "wrist_3_link and post" in plan.why and not plan.other_arm


def in_link(whole: Hand, motion: Motion, link: str, point: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a point of a link at the pregrasp, object frame."""
    T = Chain(whole, [link])(motion.T_world_root[0, :1], motion.q[0, :1]).T_world_link[0, 0]
    x, y, z = (T @ [*point, 1.0])[:3].tolist()
    return x, y, z


def test_another_configuration_of_the_arm_has_the_same_palms(whole: Hand, thing: Object) -> None:
    """A post in the forearm blocks the arm at the grasp; another configuration passes, to 1e-9 at the palm."""
    scene, motion = grasp(whole, thing)
    post = obstacle("post", (0.02, 0.02, 0.02), in_link(whole, motion, "forearm_link", (-0.2, 0.0, 0.007)))
    scene, motion = grasp(whole, thing, post)
    met = Sweep(scene, HandObject.of(scene)).obstruction(HandPath(motion.T_world_root[0], motion.q[0]), allowed=None)
    assert met is not None and (met.first, met.second) == ("forearm_link", "post")
    (plan,) = plan_motions(scene, motion)
    assert plan.free and plan.other_arm
    palms = [palm_poses(whole, T, q) for T, q in ((motion.T_world_root[0, :2], motion.q[0, :2]), legs_end(plan))]
    np.testing.assert_allclose(palms[1], palms[0], atol=1e-9)
    np.testing.assert_array_equal(plan.legs[1].q[:, ~whole.arm_joints], motion.q[0, :2, ~whole.arm_joints].T)
    assert np.abs(plan.legs[1].q - motion.q[0, :2]).max() > 0.1
    np.testing.assert_array_equal(plan.legs[2].q[:, whole.arm_joints], plan.legs[1].q[[1, 1]][:, whole.arm_joints])


def legs_end(plan: MotionPlan) -> tuple[np.ndarray, np.ndarray]:
    """Return base poses and joint values of pregrasp and grasp on a trajectory."""
    return plan.legs[1].T_world_root, plan.legs[1].q


def test_fingers_that_are_behind_a_rim_open_wider_for_the_approach(hand: Hand, thing: Object) -> None:
    """Open by 2 mm they do not pass a rim of 4 mm; wider they do, and close to the pregrasp in place."""
    T_rim = np.eye(4)
    T_rim[2, 3] = 0.055
    rimmed = build_body("rimmed", [box([0.05, 0.05, 0.12]), box([0.05, 0.058, 0.01]).transformed(T_rim)])
    scene, motion = grasp(hand, thing.with_body(rimmed))
    motion.q[0, 0] = 0.027
    (plan,) = plan_motions(scene, motion)
    approach = plan.legs[0]
    assert plan.free and approach.q[0, 0] > 0.029
    np.testing.assert_array_equal(approach.q[-1], motion.q[0, 0])
    np.testing.assert_array_equal(approach.T_world_root[-2:], motion.T_world_root[0, [0, 0]])
    motion.q[0, 0] = 0.0255
    (plan,) = plan_motions(scene, motion)
    assert plan.status == PlanStatus.BLOCKED and "approach" in plan.why


@pytest.mark.parametrize("blocked", [False, True])
def test_plans_move_with_the_whole_scene(whole: Hand, thing: Object, blocked: bool) -> None:
    """Object, bodies and base moved and turned by any motion, up included: all else stays, to 1e-9."""
    D = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.5]))
    scene, motion = grasp(whole, thing)
    place = in_link(whole, motion, "wrist_3_link" if blocked else "forearm_link", (-0.2 * (not blocked), 0.0, -0.02))
    scene, motion = grasp(whole, thing, obstacle("post", (0.02, 0.02, 0.02), place))
    assert scene.environment is not None
    there = Scene(
        whole,
        thing.with_body(build_body(thing.name, [piece.transformed(D) for piece in thing.body.pieces])),
        D @ scene.T_world_root,
        scene.q,
        task=Task(scene=Environment(scene.environment.bodies, np.linalg.inv(D))),
    )
    # The world stays, and the frame of the object moves in it.
    (first,), (second,) = plan_motions(scene, motion), plan_motions(there, Motion(D @ motion.T_world_root, motion.q))
    assert (first.status, first.other_arm, len(first.legs)) == (second.status, second.other_arm, len(second.legs))
    assert blocked == (first.status == PlanStatus.BLOCKED) and first.why.split(" at ")[0] == second.why.split(" at ")[0]
    np.testing.assert_allclose(D[:3, :3] @ first.direction, second.direction, atol=1e-9)
    for one, other in zip(first.legs, second.legs, strict=True):
        np.testing.assert_allclose(one.q, other.q, atol=1e-9)
        np.testing.assert_allclose(D @ one.T_world_root, other.T_world_root, atol=1e-9)


def test_times_keep_the_speed_limits_and_legs_end_at_rest(whole: Hand, thing: Object) -> None:
    """Speeds between set points are below the share of each joint's limit; the file's limits are those of its URDF."""
    scene, motion = grasp(whole, thing)
    (plan,) = plan_motions(scene, motion, TrajectoryOptions(approach=0.3))
    timed = trajectory(whole, plan)
    limits = speed_limits(whole)
    assert limits[0] == pytest.approx(np.pi) and limits[-1] == pytest.approx(0.05)
    assert abs(timed.time[0]) < 1e-12 and (np.diff(timed.time) > 0).all()
    speed = np.abs(np.diff(timed.q, axis=0)) / np.diff(timed.time)[:, None]
    assert (speed <= SPEED_SHARE * limits + 1e-9).all()
    T_palm = palm_poses(whole, timed.T_world_root, timed.q)
    moved, turned = distances(T_palm[:-1], T_palm[1:])
    fast = np.stack([moved, turned], axis=1) / np.diff(timed.time)[:, None] / PALM_SPEED
    assert SPEED_SHARE - 0.01 < fast.max() < SPEED_SHARE + 5e-3  # of the palm, between knots of its line
    slow = trajectory(whole, plan, share=0.1)
    assert (np.abs(np.diff(slow.q, axis=0)) / np.diff(slow.time)[:, None] <= 0.1 * limits + 1e-9).all()
    assert slow.time[-1] > 2 * timed.time[-1]
    fastest = np.concatenate([speed / limits, fast], axis=1).max(axis=1)
    for at in timed.waypoints[1:-1]:
        assert fastest[at - 1] < 0.7 * fastest.max() and fastest[at] < 0.7 * fastest.max()
    for place, stage in zip(timed.waypoints[1:4], range(3), strict=True):
        np.testing.assert_allclose(timed.q[place], motion.q[0, stage], atol=1e-9)


def test_grasps_without_a_plan_say_why_and_leave_others_alone(whole: Hand, thing: Object) -> None:
    """Out of reach, and no grasp; the third is as it is alone."""
    scene, motion = grasp(whole, thing)
    q = np.repeat(scene.q, 3, axis=0)
    q[0, 0], q[1] = np.nan, np.nan
    stages = np.repeat(motion.q, 3, axis=0)
    stages[0, :, 0], stages[1] = np.nan, np.nan
    many = replace(scene, T_world_root=np.repeat(scene.T_world_root, 3, axis=0), q=q)
    found = plan_motions(many, Motion(np.repeat(motion.T_world_root, 3, axis=0), stages))
    assert [plan.status.label for plan in found] == ["out of reach", "no grasp", "free"]
    np.testing.assert_array_equal(found[2].legs[0].q, plan_motions(scene, motion)[0].legs[0].q)


def test_files_hold_waypoints_and_set_points_over_time(whole: Hand, thing: Object, tmp_path: Path) -> None:
    """Both formats have the same numbers; arrays of a trajectory that is not known are NaN."""
    scene, motion = grasp(whole, thing, obstacle("post", (0.02, 0.02, 0.02), (0.3, 0.3, 0.0)))
    (plan,) = plan_motions(scene, motion)
    none = plan_motions(replace(scene, q=np.full_like(scene.q, np.nan)), motion)[0]
    labels = np.array(["box", "box"]), np.array([3, 4]), np.array([1, 2])
    planned = PlannedTrajectories(whole, *labels, (plan, none), ((scene, 0.5), (scene, 0.5)))
    assert planned.lines() == ["the trajectory is free in 1 of 2", "trajectory of grasp 2 no grasp: there is no grasp"]
    planned.save(tmp_path / "trajectories.npz")
    planned.save(tmp_path / "trajectories.json")
    arrays, document = (
        load_npz(tmp_path / "trajectories.npz").entries,
        json.loads((tmp_path / "trajectories.json").read_text()),
    )
    entry, timed = document["grasps"][0], trajectory(whole, plan)
    assert entry["row"] == 3 and entry["status"] == "free" and document["grasps"][1]["trajectory"]["q"] == []
    assert ["start", *(point["name"] for point in entry["waypoints"])] == arrays["waypoint_names"].tolist()
    assert document["joint_names"] == arrays["joint_names"].tolist() and document["schema"] == arrays["schema"]
    for key in ("q", "velocity", "base_pose", "palm_pose", "palm_pose_base"):
        np.testing.assert_array_equal(entry["trajectory"][key], arrays[key][0, : len(timed)])
        assert np.isnan(arrays[key][0, len(timed) :]).all() and np.isnan(arrays[key][1]).all()
    assert (arrays["waypoint_index"][:, 0] == -1).all() and np.isnan(arrays["waypoint_q"][:, 0]).all()
    for place, point in enumerate(entry["waypoints"], 1):
        assert arrays["waypoint_index"][0, place] == point["index"] and arrays["waypoint_index"][1, place] == -1
        np.testing.assert_array_equal(arrays["waypoint_q"][0, place], timed_values(entry, point["index"]))
    independent = [document["joint_names"].index(name) for name in whole.joint_names]
    np.testing.assert_allclose(np.array(entry["trajectory"]["q"])[:, independent], timed.q, atol=1e-12)
    (around,) = document["scenes"]
    assert json.loads(str(arrays["scenes"])) == document["scenes"] and arrays["scene"].tolist() == [0, 0]
    assert around["object"]["name"] == thing.name and around["object"]["scale"] == 0.5
    assert [body["name"] for body in around["scene"]["bodies"]] == ["post"]
    np.testing.assert_allclose(around["scene"]["bodies"][0]["pose"], [0.3, 0.3, 0.0, 1.0, 0.0, 0.0, 0.0])
    with pytest.raises(gr.GraspRefineError, match=".csv"):
        planned.save(tmp_path / "trajectories.csv")


def timed_values(entry: dict, index: int) -> list[float]:
    """Return the values of all joints at a set point of a file."""
    values: list[float] = entry["trajectory"]["q"][index]
    return values


def test_file_suffices_to_follow_a_trajectory(whole: Hand, thing: Object, tmp_path: Path) -> None:
    """From the file and the URDFs that it names alone: kinematics, followers, even times, velocities and torques."""
    scene, motion = grasp(whole, thing)
    motion.q[0, 2, -1] = 0.02
    one = np.array(["box"]), np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    PlannedTrajectories(whole, *one, plan_motions(scene, motion), ((scene, 1.0),)).save(tmp_path / "trajectories.json")
    document = json.loads((tmp_path / "trajectories.json").read_text())
    names, entry = document["joint_names"], document["grasps"][0]
    numbers = {key: np.array(values) for key, values in entry["trajectory"].items()}
    time, q, period = numbers["time_s"], numbers["q"], document["period_s"]
    assert time[0] == 0.0 and len(names) == q.shape[1] == len(whole.joint_names) + 1
    np.testing.assert_allclose(np.diff(time), period, rtol=1e-9)
    # Another program's kinematics of the arm, and the pose in which the hand is mounted.
    arm, mount_of = yourdfpy.URDF.load(document["robot"]["files"][0], load_meshes=False), document["robot"]["mount"]
    T_mount = transform_from_pose(np.array(mount_of["pose"]))
    for place in range(0, len(q), 20):
        arm.update_cfg(at_names(arm, names, q[place]))
        T = arm.get_transform(mount_of["parent"], document["base_link"]) @ T_mount
        np.testing.assert_allclose(transform_from_pose(numbers["palm_pose_base"][place]), T, atol=1e-7)
        T = transform_from_pose(numbers["base_pose"][place]) @ T
        np.testing.assert_allclose(transform_from_pose(numbers["palm_pose"][place]), T, atol=1e-7)
    follower = next(joint for joint in document["joints"] if joint["mimic"])
    leader, (c0, c1) = names.index(follower["mimic"]["joint"]), follower["mimic"]["coefficients"]
    np.testing.assert_allclose(q[:, names.index(follower["name"])], c0 + c1 * q[:, leader], atol=1e-12)
    # Velocities lead from one set point to that after the next, and are 0 where the hand rests.
    rests = [point["index"] for point in entry["waypoints"]]
    assert len(rests) == 5 and rests[0] == 0 and rests[-1] == len(q) - 1
    inside = np.setdiff1d(np.arange(len(q)), rests)
    np.testing.assert_allclose(numbers["velocity"][inside] * 2 * period, q[inside + 1] - q[inside - 1], atol=1e-12)
    assert (numbers["velocity"][rests] == 0.0).all()
    # It comes to rest, and no velocity jumps: each leg lasts at least half a second.
    assert np.abs(np.diff(numbers["velocity"], axis=0)).max() < 0.2
    servo = document["joints"][leader]["servo"]
    torque = np.clip(servo["kp"] * (0.02 - 0.025), -servo["force_limit"], servo["force_limit"])
    assert entry["squeeze"] == {names[leader]: pytest.approx(torque)}


def at_names(robot: yourdfpy.URDF, names: list[str], values: np.ndarray) -> np.ndarray:
    """Return the values of the joints of a robot, in its own order."""
    return np.array([values[names.index(name)] for name in robot.actuated_joint_names])


@pytest.mark.parametrize("lengths", [{"approach": -0.1}, {"lift": np.inf}, {"lift": float("nan")}])
def test_lengths_that_are_none_are_refused(lengths: dict) -> None:
    """The message names the length."""
    with pytest.raises(gr.GraspRefineError, match=next(iter(lengths))):
        TrajectoryOptions(**lengths)


@pytest.mark.parametrize("beyond", [-0.02, 0.06])
def test_jaws_that_slide_press_beyond_their_limits(whole: Hand, thing: Object, beyond: float) -> None:
    """Clipped to the limits they would not press thin things: a mug's rim was lost; the arm does not move."""
    scene, motion = grasp(whole, thing)
    motion.q[0, 2, -1] = beyond
    (plan,) = plan_motions(scene, motion)
    assert plan.free
    squeeze, lift = plan.legs[2:]
    assert whole.slides[-1] and squeeze.q[-1, -1] == beyond and np.allclose(lift.q[:, -1], beyond)
    np.testing.assert_array_equal(squeeze.q[-1, whole.arm_joints], motion.q[0, 1, whole.arm_joints])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_all_set_points_of_sampled_grasps_on_an_arm_are_within_limits(name: str) -> None:
    """Joints that follow others too; before, most squeezes of Allegro and Shadow pressed beyond."""
    alone, box = load_hand(name, candidates=64), load_object("box:0.06,0.06,0.12")
    arm = mount(load_hand("ur5e", candidates=32), alone)
    grasps = gr.sample_grasps(alone, box, 8)
    refined = gr.refine(arm, box, grasps, task=gr.Task(base=[-0.55, 0.0, -0.06, 0.0, 0.0, 0.0]))
    timed = [one.q for one in gr.plan_trajectories(refined).trajectories() if len(one)]
    assert len(timed) > 2
    check_limits(arm, np.concatenate(timed))


def check_limits(hand: Hand, q: np.ndarray) -> None:
    """Check the values of all movable joints, those of followers by the couplings of the file."""
    matrix, offset, names = hand.mimic_map()
    values = q @ matrix.T + offset + hand.curves(q)
    lower, upper = (np.array([getattr(hand.joints_by_name[name], end) for name in names]) for end in ("lower", "upper"))
    assert (values > lower - 1e-9).all() and (values < upper + 1e-9).all()


def test_arm_comes_from_its_start_straight_in_its_joints(whole: Hand, thing: Object, tmp_path: Path) -> None:
    """To the start of the approach with the fingers as there, before the same legs; files name the waypoint."""
    scene, motion = grasp(whole, thing)
    arm = whole.arm_joints
    start = tuple(whole.rest[arm].tolist())
    (plain,), (plan,) = plan_motions(scene, motion), plan_motions(scene, motion, TrajectoryOptions(start=start))
    assert plan.free and plan.reach is not None and plain.reach is None
    np.testing.assert_array_equal(plan.reach.q[0, arm], start)
    np.testing.assert_array_equal(plan.reach.q[1], plan.legs[0].q[0])
    np.testing.assert_array_equal(plan.reach.q[0, ~arm], plan.legs[0].q[0, ~arm])
    np.testing.assert_array_equal(plan.legs[2].q, plain.legs[2].q)
    timed = trajectory(whole, plan)
    assert timed.named["start"] == 0 and list(timed.named)[1:] == list(trajectory(whole, plain).named)
    reach = timed.q[: timed.named["approach"] + 1]
    share = (reach - reach[0]) @ (reach[-1] - reach[0]) / ((reach[-1] - reach[0]) ** 2).sum()
    np.testing.assert_allclose(reach, reach[0] + share[:, None] * (reach[-1] - reach[0]), atol=1e-9)
    assert (timed.sampled(0.05)[3][:3] == -1).all() and timed.sampled(0.05)[3].max() == LEGS.index("lift")
    one = np.array(["box"]), np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    PlannedTrajectories(whole, *one, (plan,)).save(tmp_path / "trajectories.json")
    (entry,) = json.loads((tmp_path / "trajectories.json").read_text())["grasps"]
    assert [point["name"] for point in entry["waypoints"]] == ["start", *WAYPOINTS]
    assert entry["squeeze"] and all(name in whole.joint_names[-1:] for name in entry["squeeze"])


def test_start_behind_a_wall_is_named_as_blocked(whole: Hand, thing: Object) -> None:
    """The arm turns through a plate beside its trajectory that neither start nor approach touches."""
    scene, motion = grasp(whole, thing)
    turned = whole.rest[whole.arm_joints] + [np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]
    plate = obstacle("plate", (0.5, 0.01, 0.5), (-0.1, 0.3, 0.3))
    scene, motion = grasp(whole, thing, plate)
    assert plan_motions(scene, motion)[0].free
    (plan,) = plan_motions(scene, motion, TrajectoryOptions(start=tuple(turned.tolist())))
    assert plan.status == PlanStatus.BLOCKED and plan.why.startswith("reach: ") and "plate" in plan.why
    assert plan.legs == () and len(trajectory(whole, plan)) > 1


@pytest.mark.parametrize(
    ("start", "named"), [((0.0, 1.0), "2 joint values"), ((9.0,) + (0.0,) * 5, "shoulder_pan_joint")]
)
def test_starts_that_are_none_of_the_arm_are_refused(
    whole: Hand, hand: Hand, thing: Object, start: tuple[float, ...], named: str
) -> None:
    """The message names the number of joints, or the joint and its limits; a hand without an arm has none."""
    with pytest.raises(gr.GraspRefineError, match=named):
        plan_motions(*grasp(whole, thing), TrajectoryOptions(start=start))
    with pytest.raises(gr.GraspRefineError, match="no arm"):
        plan_motions(*grasp(hand, thing), TrajectoryOptions(start=start))
