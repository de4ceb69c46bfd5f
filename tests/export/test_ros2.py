"""Messages for ROS 2: rosbags, a reader of others, finds every field, and other kinematics the hand as it grasps."""

from __future__ import annotations

from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import yourdfpy
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import grasp_refine as gr
from ball_hand import FROM_ABOVE, ball_hand, body, grasp
from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import exp_so3, transform_from_pose
from grasp_refine.export.cdr import MESSAGES, cdr
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.targets import export
from grasp_refine.forces.squeeze_forces import ContactForces
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.plan import UP
from grasp_refine.motion.trajectory import PERIOD_S, SPEED_SHARE, speed_limits
from grasp_refine.scene.scene import Scene
from made_hands import joint, link
from refusals import refused

GRASP, TRAJECTORY = "moveit_msgs/msg/Grasp", "trajectory_msgs/msg/JointTrajectory"
PALM_TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"

DEFINITIONS = {
    GRASP: """
        string id
        trajectory_msgs/JointTrajectory pre_grasp_posture
        trajectory_msgs/JointTrajectory grasp_posture
        geometry_msgs/PoseStamped grasp_pose
        float64 grasp_quality
        GripperTranslation pre_grasp_approach
        GripperTranslation post_grasp_retreat
        GripperTranslation post_place_retreat
        float32 max_contact_force
        string[] allowed_touch_objects
    """,
    "moveit_msgs/msg/GripperTranslation": """
        geometry_msgs/Vector3Stamped direction
        float32 desired_distance
        float32 min_distance
    """,
}
"""Fields of the messages of moveit/moveit_msgs, branch ros2, of which rosbags knows none."""

STORE = get_typestore(Stores.ROS2_HUMBLE)
for name, definition in DEFINITIONS.items():
    STORE.register(get_types_from_msg("\n".join(map(str.strip, definition.splitlines())), name))

T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Return a gripper, with a joint that turns a thumb, and another that follows it."""
    turning = joint("t", "palm", "thumb", axis=(1, 0, 0), limits=(-0.5, 0.8))
    following = joint("follower", "thumb", "thumb_tip", axis=(0, 1, 0), limits=(-0.5, 0.8), follow=("t", -0.5, 0.1))
    return ball_hand(tmp_path_factory.mktemp("balls"), link("thumb") + link("thumb_tip"), turning + following)


def exported(hand: Hand, on: Hand | None = None, **more: object) -> ExportedGrasps:
    """Return two grasps of a ball with different values of all joints, of a turned palm; on an arm where one is."""
    (scene, motion), turn = grasp(hand), np.eye(4)
    turn[:3, :3] = exp_so3(np.array([0.1, -0.2, 0.4]))
    T, q = np.repeat(motion.T_world_root, 2, axis=0), np.repeat(motion.q, 2, axis=0)
    q[1, :, 1] += 0.002
    q[:, :, 2] = [[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]]
    T[1] = turn @ FROM_ABOVE
    T[:, 0, 0, 3] += 0.003
    if on is not None:
        alone = [GraspSet.of(hand, T[:, k], q[:, k]) for k in range(3)]
        q = np.stack([np.hstack([on_arm(one, on, T_BASE)[0].q[:, on.arm_joints], one.q]) for one in alone], axis=1)
        T, hand = np.tile(T_BASE, (2, 3, 1, 1)), on
    scene = Scene(hand, scene.object, T[:, 1], q[:, 1], task=scene.task)
    return ExportedGrasps("a ball", 1.0, scene, Motion(T, q), np.array([4, 2]), **more)


@pytest.fixture(scope="module", params=["free", "arm"])
def part(hand: Hand, request: pytest.FixtureRequest) -> ExportedGrasps:
    force = np.array([[0.0, 3.0, 4.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0]])
    forces = ContactForces(np.array([0, 0, 1]), np.array(["left", "right", "left"]), force * 0.0, force, force)
    on = mount(load_hand("ur5e", candidates=32), hand) if request.param == "arm" else None
    return exported(hand, on, forces=forces, values={"quality": np.array([0.75, np.nan])})


@pytest.fixture(scope="module")
def folder(part: ExportedGrasps, tmp_path_factory: pytest.TempPathFactory) -> Path:
    (made,) = export([part], "ros2", tmp_path_factory.mktemp("ros2") / "messages")
    return made


def plain(value: Any) -> Any:
    """Message of rosbags as the plain values that YAML has."""
    if is_dataclass(value):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"}
    return [plain(one) for one in value] if isinstance(value, list | np.ndarray) else value


def decoded(path: Path, kind: str) -> Any:
    return STORE.deserialize_cdr(path.read_bytes(), kind)


def singles(value: Any, kind: str) -> Any:
    """Fields of a message of which the short numbers have the precision of their type."""
    if kind.endswith("[]"):
        return [singles(one, kind[:-2]) for one in value]
    if kind in MESSAGES:
        return {name: singles(value[name], field) for name, field in MESSAGES[kind]}
    return float(np.float32(value)) if kind == "float32" else value


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize(("inside", "kind"), [("grasps", GRASP), ("trajectories", TRAJECTORY)])
def test_another_reader_finds_in_the_bytes_what_the_yaml_has(folder: Path, inside: str, kind: str, row: int):
    path = folder / inside / f"{row}.cdr"
    message = decoded(path, kind)
    assert bytes(STORE.serialize_cdr(message, kind)) == path.read_bytes()
    text = yaml.safe_load(path.with_suffix(".yaml").read_text())
    assert plain(message) == singles(text, kind)


def values_of(kind: str) -> st.SearchStrategy[Any]:
    """Values of a message, with strings and sequences of all lengths."""
    if kind.endswith("[]"):
        return st.lists(values_of(kind[:-2]), max_size=3)
    if kind in MESSAGES:
        return st.fixed_dictionaries({name: values_of(field) for name, field in MESSAGES[kind]})
    if kind == "string":
        return st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
    if kind.startswith("float"):
        return st.floats(width=int(kind[-2:]), allow_nan=False)
    return st.integers(0, 2**31 - 1)


@given(st.sampled_from(sorted(MESSAGES)).flatmap(lambda kind: st.tuples(st.just(kind), values_of(kind))))
def test_every_message_is_read_back_by_another_reader(case: tuple[str, Any]):
    kind, message = case
    assert plain(STORE.deserialize_cdr(cdr(kind, message), kind)) == message


def test_postures_put_the_links_where_the_grasp_has_them(part: ExportedGrasps, folder: Path):
    """By the kinematics of yourdfpy, from the hand's own URDF, by joint names, from the pose in the message."""
    hand = part.hand
    alone = hand if hand.arm is None else hand.parts[1]
    robot = yourdfpy.URDF.load(str(alone.urdf), load_meshes=False, load_collision_meshes=False, build_scene_graph=True)
    names = [one.name for one in alone.links]
    chain = Chain(hand, [hand.base_link if hand.arm is None else hand.palm, *names])
    for row in range(len(part)):
        message = decoded(folder / "grasps" / f"{row}.cdr", GRASP)
        placed = message.grasp_pose.pose
        p, o = placed.position, placed.orientation
        T_palm = transform_from_pose(np.array([p.x, p.y, p.z, o.w, o.x, o.y, o.z]))
        for posture, stages in ((message.pre_grasp_posture, [0]), (message.grasp_posture, [1, 2])):
            assert set(posture.joint_names) == {"l", "r", "t", "follower"}
            for point, stage in zip(posture.points, stages, strict=True):
                found = dict(zip(posture.joint_names, point.positions, strict=True))
                assert found["follower"] == pytest.approx(0.1 - 0.5 * found["t"])
                robot.update_cfg({name: found[name] for name in robot.actuated_joint_names})
                T = chain(part.motion.T_world_root[row, stage][None], part.motion.q[row, stage][None]).T_world_link[0]
                for name, T_link in zip(names, T[1:], strict=True):
                    # Palms are elsewhere at the pregrasp.
                    base = T_palm if stage else T[0]
                    np.testing.assert_allclose(base @ robot.get_transform(name), T_link, atol=2e-9)


def test_quality_forces_and_frames_are_those_of_each_grasp(part: ExportedGrasps, folder: Path):
    first, second = (decoded(folder / "grasps" / f"{row}.cdr", GRASP) for row in range(2))
    assert (first.id, second.id) == ("a ball_4", "a ball_2")
    assert (first.grasp_quality, second.grasp_quality) == (0.75, 0.0)
    assert (first.max_contact_force, second.max_contact_force) == (5.0, 2.0)
    assert first.allowed_touch_objects == ["a ball"]
    ways = (first.pre_grasp_approach, first.post_grasp_retreat, first.post_place_retreat)
    assert {message.header.frame_id for message in (first.grasp_pose, *(way.direction for way in ways))} == {"a ball"}
    palm = part.hand.base_link if part.hand.arm is None else part.hand.palm
    readme = (folder / "README.md").read_text()
    assert f"`{palm}`" in readme and "`a ball`" in readme and "follower" in readme
    # The servo of a joint presses by its stiffness times the way that the object keeps it from.
    hand = part.hand
    most = hand.actuator.force_limit
    torque = np.clip(hand.actuator.kp * (part.motion.q[0, 2] - part.motion.q[0, 1]), -most, most)
    effort = dict(zip(first.grasp_posture.joint_names, first.grasp_posture.points[0].effort, strict=True))
    fingers = {name: value for name, value in zip(hand.joint_names, torque, strict=True) if name in effort}
    assert effort == pytest.approx(fingers | {"follower": 0.0})


def vector(way: Any) -> np.ndarray:
    """Vector (3,) of a translation in metres."""
    along = way.direction.vector
    return way.desired_distance * np.array([along.x, along.y, along.z])


def test_trajectories_go_through_the_stages_within_the_speed_limits(part: ExportedGrasps, folder: Path):
    hand = part.hand
    for row in range(len(part)):
        message = decoded(folder / "trajectories" / f"{row}.cdr", TRAJECTORY)
        order = [message.joint_names.index(name) for name in hand.joint_names]
        q = np.array([point.positions for point in message.points])[:, order]
        rate = np.array([point.velocities for point in message.points])[:, order]
        times = [point.time_from_start for point in message.points]
        time = np.array([one.sec + 1e-9 * one.nanosec for one in times])
        np.testing.assert_allclose(time, PERIOD_S * np.arange(len(time)), atol=1e-9)
        assert all(one.nanosec < 1e9 for one in times) and (rate[[0, -1]] == 0.0).all()
        limit = SPEED_SHARE * speed_limits(hand) + 1e-9
        assert (np.abs(np.diff(q, axis=0)) / np.diff(time)[:, None] <= limit).all()
        for stage in range(3):
            # The arm follows the palm between the stages by itself, to its own accuracy.
            assert np.abs(q - part.motion.q[row, stage]).max(axis=1).min() < 1e-6
        assert not any(len(point.effort) for point in message.points)


def test_the_palm_approaches_and_lifts_along_the_vectors_of_the_grasp(part: ExportedGrasps, folder: Path):
    hand = part.hand
    for row in range(len(part)):
        message = decoded(folder / "grasps" / f"{row}.cdr", GRASP)
        at = part.palm_poses[row, 1, :3]
        approach, lift = vector(message.pre_grasp_approach), vector(message.post_grasp_retreat)
        away = vector(message.post_place_retreat)
        np.testing.assert_allclose(lift, 0.1 * np.array(UP), atol=1e-7)
        np.testing.assert_allclose(at - approach, part.palm_poses[row, 0, :3] + away, atol=1e-7)
        assert message.pre_grasp_approach.min_distance < message.pre_grasp_approach.desired_distance
        moves = decoded(folder / "trajectories" / f"{row}.cdr", TRAJECTORY)
        if hand.arm is None:
            palm = decoded(folder / "palms" / f"{row}.cdr", PALM_TRAJECTORY)
            assert palm.header.frame_id == "a ball" and palm.joint_names == [hand.palm]
            assert [one.time_from_start for one in palm.points] == [one.time_from_start for one in moves.points]
            places = [one.transforms[0].translation for one in palm.points]
            positions = np.array([[place.x, place.y, place.z] for place in places])
            turn = palm.points[0].transforms[0].rotation
            rotation = part.palm_poses[row, 1, 3:] @ [turn.w, turn.x, turn.y, turn.z]
            assert abs(rotation) == pytest.approx(1.0, abs=1e-9)
            assert np.abs(positions - at).max(axis=1).min() < 1e-9
        else:
            order = [moves.joint_names.index(name) for name in hand.joint_names]
            q = np.array([point.positions for point in moves.points])[:, order]
            positions = palm_poses(hand, np.tile(T_BASE, (len(q), 1, 1)), q)[:, :3, 3]
        np.testing.assert_allclose(positions[0], at - approach, atol=1e-6)
        np.testing.assert_allclose(positions[-1], at + lift, atol=1e-6)


def test_grasps_without_numbers_are_left_out_and_named(hand: Hand, tmp_path: Path):
    part = exported(hand)
    q = part.motion.q.copy()
    q[0, 1] = np.nan
    broken = replace(part, scene=replace(part.scene, q=q[:, 1]), motion=Motion(part.motion.T_world_root, q))
    (folder,) = export([broken], "ros2", tmp_path / "one")
    assert [path.name for path in sorted((folder / "grasps").iterdir())] == ["1.cdr", "1.yaml"]
    assert "Grasp 0 is left out" in (folder / "README.md").read_text()
    q[:] = np.nan
    with refused(GraspRefineError, "a ball"):
        export([broken], "ros2", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_an_obstacle_in_the_way_leaves_the_fingers_part_and_is_named(hand: Hand, tmp_path: Path):
    """A shell of posts around the hand blocks all approaches; the joints still close."""
    posts = [body(f"post {n}", (*(0.11 * d + [0, 0, 0.06]), 0.02)) for n, d in enumerate(_sphere(150))]
    scene, motion = grasp(hand, *posts)
    part = ExportedGrasps("ball", 1.0, scene, motion, np.array([0]))
    (folder,) = export([part], "ros2", tmp_path / "blocked")
    assert "grasp 0 is not free: approach" in (folder / "README.md").read_text()
    moves = decoded(folder / "trajectories" / "0.cdr", TRAJECTORY)
    np.testing.assert_array_equal(moves.points[0].positions, motion.q[0, 0])
    assert 0.0 == decoded(folder / "grasps" / "0.cdr", GRASP).max_contact_force


def _sphere(count: int) -> np.ndarray:
    """Unit vectors (count, 3) all around, on a spiral."""
    k = np.arange(count) + 0.5
    up, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + 5**0.5) * k
    return np.stack([np.cos(turn) * np.sqrt(1 - up**2), np.sin(turn) * np.sqrt(1 - up**2), up], axis=1)


def test_refined_grasps_have_their_quality_and_their_largest_force(hand: Hand, tmp_path: Path):
    refined = gr.refine(hand, gr.load_object("sphere:0.03"), gr.sample_grasps(hand, gr.load_object("sphere:0.03"), 1))
    (folder,) = refined.export("ros2", tmp_path / "messages")
    message = decoded(folder / "grasps" / "0.cdr", GRASP)
    assert message.grasp_quality == refined.quality[0, 1]
    assert message.max_contact_force == pytest.approx(np.linalg.norm(refined.forces.vector, axis=1).max())
