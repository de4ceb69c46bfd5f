"""Trajectories: durations and speeds in closed form; files that suffice to follow them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import grasp_refine as gr
from ball_hand import ball_hand, body
from grasp_refine.closing.motion import Motion
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, exp_so3, log_so3, transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.executions import Executions
from grasp_refine.motion.paths import HandPath
from grasp_refine.motion.plan import WAYPOINTS, MotionPlan, PlanStatus, TrajectoryOptions, plan_motions
from grasp_refine.motion.trajectory import PALM_SPEED, SPEED_SHARE, speed_limits, trajectory
from grasp_refine.motion.trajectory_files import PlannedTrajectories, join
from grasp_refine.objects.object import load_object
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task

T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])


@pytest.fixture(scope="module")
def whole() -> Hand:
    """Return a gripper, one of whose jaws follows the other, on an arm."""
    return mount(load_hand("ur5e", candidates=32), load_hand("franka_hand", candidates=32))


@pytest.fixture(scope="module")
def grasped(whole: Hand) -> tuple[Scene, Motion]:
    """Return a grasp of a box from above beside a post."""
    T_palm, fingers = transform_from_rpy([0.0, 0.0, 0.1434, 180.0, 0.0, 0.0]), np.array([[0.036], [0.025], [0.02]])
    q = np.concatenate([np.zeros((3, 6)), fingers], axis=1)
    ours = GraspSet.of(whole.parts[1], T_palm[None], fingers[:1])
    q[:, :6] = on_arm(ours, whole, T_BASE)[0].q[0, :6]
    task = Task(
        scene=Environment((body("post", (0.3, 0.3, 0.0, 0.02)),), transform(exp_so3(np.array([0, 0, 0.5])), np.ones(3)))
    )
    scene = Scene(whole, load_object("box:0.05,0.05,0.12"), T_BASE, q[1], task=task)
    return scene, Motion(np.tile(T_BASE, (1, 3, 1, 1)), q[None])


def test_legs_last_as_long_as_the_slowest_part_needs(tmp_path: Path) -> None:
    """At half of a limit, 1.5 times the mean speed; s = 3 u^2 - 2 u^3 from rest to rest; at least half a second."""
    hand = ball_hand(tmp_path / "free", velocity=None)
    assert speed_limits(hand).tolist() == [0.1, 0.1] and speed_limits(ball_hand(tmp_path, velocity=0.3))[0] == 0.3
    turned = transform(exp_so3(np.array([0.0, 0.0, 0.6])), np.array([0.1, 0.0, 0.0]))
    T = np.stack([np.eye(4), transform(np.eye(3), np.array([0.1, 0.0, 0.0])), turned, turned, turned])
    q = np.array([[0.01, 0.02], [0.01, 0.02], [0.01, 0.02], [0.08, 0.03], [0.08, 0.031]])
    legs = tuple(HandPath(T[k : k + 2], q[k : k + 2]) for k in range(4))
    timed = trajectory(hand, MotionPlan(PlanStatus.FREE, "", legs))
    # 0.1 m at 0.125 m/s, 0.6 rad at 0.5 rad/s, 0.07 m at 0.05 m/s; of a millimetre the least; in periods of 20 ms.
    assert timed.waypoints == tuple(np.cumsum([0, 60, 90, 105, 25])) and timed.named["squeeze"] == 255
    np.testing.assert_allclose(timed.time, 0.02 * np.arange(281), atol=1e-12)

    def profile(periods: int) -> np.ndarray:
        u = np.linspace(0.0, 1.0, periods + 1)
        return 3 * u**2 - 2 * u**3

    np.testing.assert_allclose(timed.T_world_root[:61, 0, 3], 0.1 * profile(60), atol=1e-9)
    np.testing.assert_allclose(log_so3(timed.T_world_root[60:151, :3, :3])[:, 2], 0.6 * profile(90), atol=1e-9)
    np.testing.assert_allclose(timed.q[150:256, 0], 0.01 + 0.07 * profile(105), atol=1e-9)
    np.testing.assert_allclose(timed.q[150:256, 1], 0.02 + 0.01 * profile(105), atol=1e-9)
    rate = timed.velocity(timed.q)
    assert (rate[[0, 60, 150, 255, 280]] == 0.0).all() and rate[:, 0].max() == pytest.approx(0.05, rel=1e-3)
    assert rate[203, 0] == pytest.approx((timed.q[204, 0] - timed.q[202, 0]) / 0.04)
    slow = trajectory(hand, MotionPlan(PlanStatus.FREE, "", legs), share=0.1)
    assert slow.waypoints == tuple(np.cumsum([0, 300, 450, 525, 25]))
    # With a joint motion of the arm before; sampled at other times.
    reaching = trajectory(hand, MotionPlan(PlanStatus.FREE, "", legs, reach=legs[0]))
    assert reaching.named == dict(zip(["start", *WAYPOINTS], np.cumsum([0, 60, 60, 90, 105, 25]), strict=True))
    for one, begins in ((timed, 0), (reaching, -1)):
        time, place, path, leg = one.sampled(0.03)
        assert time[1] == 0.03 and time[-1] == one.time[-1] and (np.diff(leg) >= 0).all()
        np.testing.assert_allclose(place, time / 0.02)
        np.testing.assert_allclose(path.q[5], (one.q[7] + one.q[8]) / 2)
        for number, end in enumerate(one.waypoints[1:], begins):
            last = int(np.flatnonzero(leg == number)[-1])
            assert place[last] <= end < place[min(last + 1, len(place) - 1)] or last == len(place) - 1
    none = trajectory(hand, MotionPlan(PlanStatus.NO_GRASP, "", ()))
    assert len(none) == 0 and none.named == {} and none.velocity(none.q).shape == (0, 2)


def test_times_keep_the_speed_limits_of_an_arm(whole: Hand, grasped: tuple[Scene, Motion]) -> None:
    """Speeds between set points are below the share of each limit; the file's limits are those of its URDF."""
    (plan,) = plan_motions(*grasped, TrajectoryOptions(approach=0.3, start=(0.3, -1.2, 1.4, -1.8, -1.5, 0.3)))
    timed, limits = trajectory(whole, plan), speed_limits(whole)
    assert plan.free and limits[0] == pytest.approx(np.pi) and limits[-1] == pytest.approx(0.05)
    speed = np.abs(np.diff(timed.q, axis=0)) / 0.02
    T_palm = palm_poses(whole, timed.T_world_root, timed.q)
    fast = np.stack(distances(T_palm[:-1], T_palm[1:]), axis=1) / 0.02 / PALM_SPEED
    assert (speed <= SPEED_SHARE * limits + 1e-9).all()
    assert SPEED_SHARE - 0.01 < fast.max() < SPEED_SHARE + 5e-3  # of the palm, between knots of its line
    way = plan.reach.q[1] - plan.reach.q[0]
    reach = timed.q[: timed.named["approach"] + 1] - plan.reach.q[0]
    np.testing.assert_allclose(reach, np.outer(reach @ way / (way @ way), way), atol=1e-9)
    for place, stage in zip(timed.waypoints[2:5], range(3), strict=True):
        np.testing.assert_allclose(timed.q[place], grasped[1].q[0, stage], atol=1e-9)


def test_files_hold_waypoints_and_set_points_over_time(
    whole: Hand, grasped: tuple[Scene, Motion], tmp_path: Path
) -> None:
    """The same numbers in both formats; arrays of a trajectory that is not known are NaN; parts are joined in order."""
    scene, motion = grasped
    (plan,) = plan_motions(scene, motion)
    none = MotionPlan(PlanStatus.NO_GRASP, "there is no grasp", ())
    one, other = (
        PlannedTrajectories(whole, np.array(["box"]), np.array([row]), np.array([index]), (each,), ((scene, 0.5),))
        for row, index, each in ((4, 2, none), (3, 1, plan))
    )
    planned = join((one, other), np.array([1, 0]))
    assert planned.row.tolist() == [3, 4] and planned.plans == (plan, none)
    larger = join((replace(one, scenes=((scene, 0.7),)), other), np.array([1, 0]))
    assert [scale for _, scale in larger.scenes] == [0.5, 0.7]
    assert planned.lines() == ["the trajectory is free in 1 of 2", "trajectory of grasp 2 no grasp: there is no grasp"]
    planned.save(tmp_path / "trajectories.npz")
    planned.save(tmp_path / "trajectories.json")
    arrays = load_npz(tmp_path / "trajectories.npz").entries
    document = json.loads((tmp_path / "trajectories.json").read_text())
    entry, timed = document["grasps"][0], trajectory(whole, plan)
    assert entry["row"] == 3 and entry["status"] == "free" and document["grasps"][1]["trajectory"]["q"] == []
    assert ["start", *(point["name"] for point in entry["waypoints"])] == arrays["waypoint_names"].tolist()
    assert document["joint_names"] == arrays["joint_names"].tolist() and document["schema"] == arrays["schema"]
    np.testing.assert_allclose(arrays["time"][0, : len(timed)], entry["trajectory"]["time_s"])
    for key in ("q", "velocity", "base_pose", "palm_pose", "palm_pose_base"):
        np.testing.assert_array_equal(entry["trajectory"][key], arrays[key][0, : len(timed)])
        assert np.isnan(arrays[key][0, len(timed) :]).all() and np.isnan(arrays[key][1]).all()
    assert (arrays["waypoint_index"][:, 0] == -1).all() and np.isnan(arrays["waypoint_q"][:, 0]).all()
    for place, point in enumerate(entry["waypoints"], 1):
        assert arrays["waypoint_index"][0, place] == point["index"] and arrays["waypoint_index"][1, place] == -1
        for key in ("q", "palm_pose", "palm_pose_base"):
            at = entry["trajectory"][key][point["index"]]
            assert arrays[f"waypoint_{key}"][0, place].tolist() == point[key] == at
    torque = dict(zip(arrays["joint_names"].tolist(), arrays["squeeze_torque"][0].tolist(), strict=True))
    assert {name: value for name, value in torque.items() if value} == entry["squeeze"]
    (around,) = document["scenes"]
    assert json.loads(str(arrays["scenes"])) == document["scenes"] and arrays["scene"].tolist() == [0, 0]
    assert around["object"]["name"] == scene.object.name and around["object"]["scale"] == 0.5
    assert [post["name"] for post in around["scene"]["bodies"]] == ["post"]
    post, T_world_object = (
        around["scene"]["bodies"][0],
        transform_from_pose(np.array(around["scene"]["object_pose_world"])),
    )
    np.testing.assert_allclose(T_world_object, scene.environment.T_world_object, atol=1e-12)
    np.testing.assert_allclose(T_world_object @ transform_from_pose(np.array(post["pose"])), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(post["pose_world"], [0, 0, 0, 1, 0, 0, 0], atol=1e-12)
    with pytest.raises(gr.GraspRefineError, match=".csv"):
        planned.save(tmp_path / "trajectories.csv")


def test_file_suffices_to_follow_a_trajectory(whole: Hand, grasped: tuple[Scene, Motion], tmp_path: Path) -> None:
    """From the file and the URDFs that it names alone: kinematics, followers, even times, velocities and torques."""
    one = np.array(["box"]), np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    PlannedTrajectories(whole, *one, plan_motions(*grasped)).save(tmp_path / "trajectories.json")
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
        arm.update_cfg([q[place, names.index(name)] for name in arm.actuated_joint_names])
        T = arm.get_transform(mount_of["parent"], document["base_link"]) @ T_mount
        np.testing.assert_allclose(transform_from_pose(numbers["palm_pose_base"][place]), T, atol=1e-7)
        T = transform_from_pose(numbers["base_pose"][place]) @ T
        np.testing.assert_allclose(transform_from_pose(numbers["palm_pose"][place]), T, atol=1e-7)
    follower = next(joint for joint in document["joints"] if joint["mimic"])
    leader, (c0, c1) = names.index(follower["mimic"]["joint"]), follower["mimic"]["coefficients"]
    np.testing.assert_allclose(q[:, names.index(follower["name"])], c0 + c1 * q[:, leader], atol=1e-12)
    for joint in document["joints"]:
        limit = (
            (arm if joint["arm"] else yourdfpy.URDF.load(document["robot"]["files"][1], load_meshes=False))
            .joint_map[joint["name"]]
            .limit
        )
        assert (joint["lower"], joint["upper"]) == (limit.lower, limit.upper)
        assert joint["speed_limit"] == (None if joint["mimic"] else pytest.approx(limit.velocity))
    # Velocities lead from one set point to that after the next, and are 0 where the hand rests.
    rests = [point["index"] for point in entry["waypoints"]]
    assert len(rests) == 5 and rests[0] == 0 and rests[-1] == len(q) - 1
    inside = np.setdiff1d(np.arange(len(q)), rests)
    np.testing.assert_allclose(numbers["velocity"][inside] * 2 * period, q[inside + 1] - q[inside - 1], atol=1e-12)
    assert (numbers["velocity"][rests] == 0.0).all()
    servo = document["joints"][leader]["servo"]
    torque = np.clip(servo["kp"] * (0.02 - 0.025), -servo["force_limit"], servo["force_limit"])
    assert entry["squeeze"] == {names[leader]: pytest.approx(torque)}


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
    matrix, offset, names = arm.mimic_map()
    q = np.concatenate(timed)
    values = q @ matrix.T + offset + arm.curves(q)
    lower, upper = (np.array([getattr(arm.joints_by_name[name], end) for name in names]) for end in ("lower", "upper"))
    assert (values > lower - 1e-9).all() and (values < upper + 1e-9).all()


def test_many_hits_are_reported_in_short_and_kept_whole() -> None:
    """A line names the first ones, after what is worse; the file has all, each number its own."""
    hits, known = np.empty(1, dtype=object), np.array([True])
    hits[0] = tuple(f"lift: link_{link} and table" for link in range(12))
    numbers = {"lifted_m": 0.1, "displacement_m": 0.2, "angle_rad": 0.3, "tracking_m": 0.4, "tracking_rad": 0.5}
    each = {name: np.array([value]) for name, value in numbers.items()}
    found = Executions(known, ~known, **each, pushed_m=np.array([[0.3]]), hits=hits, neighbours=("tin",))
    first, line = found.lines(labels=["mug 7"])
    assert "0 of 1 held" in first and "400.0 mm" in first and f"{np.degrees(0.5):.1f} degrees" in first
    assert line.startswith("grasp mug 7: lost, 200 mm and 17 degrees")
    assert line.endswith("and 8 more") and "pushed tin 300 mm" in line
    document, arrays = found.document(0), found.arrays()
    assert document == {"held": False, **numbers, "pushed_m": {"tin": 0.3}, "hits": list(hits[0])}
    assert {name: arrays[name].tolist() for name in numbers} == {name: [value] for name, value in numbers.items()}
