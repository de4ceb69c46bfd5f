"""Recorded simulations as frames of our hand: they agree with MuJoCo's own kinematics."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, pose_from_transform, transform_from_pose
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.world import HAND, World, build_world
from grasp_refine.validation.engines.mujoco.world import SCENE as SCENE_PREFIX
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.replay.replay import OBJECT, POSE_AXES, Replay, load_replay, save_replay
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.viewer.jobs.replaying import FRAME_RATE_HZ, MAX_DISPLACEMENT_M, is_replay, replay_recording
from grasp_refine_apps.viewer.model.recording import Recording
from refusals import assert_names, refused
from spread_gripper import spread_gripper
from underactuated import underactuated


def moving(hand: Hand) -> Motion:
    """The hand closes and moves, far away from the object, which is pushed all the same."""
    upper = np.where(np.isinf(hand.upper), 1.0, hand.upper)
    T = np.tile(np.eye(4), (1, 3, 1, 1))
    T[..., :3, 3] = [0.5, 0.1, 0.0]
    T[0, 2, :3, 3] += [0.02, 0.0, 0.01]
    return Motion(T, np.stack([hand.rest + share * (upper - hand.rest) for share in (0.0, 0.4, 0.7)])[None])


def recorded(hand: Hand) -> tuple[HandModel, World, Replay]:
    model = model_of(hand)
    world = build_world(model, load_object("sphere:0.03", candidates=16), Task(DEXGRASPBENCH))
    replay = record(world, moving(hand), "+x", name="a ball", hand=hand.name)
    assert replay is not None
    return model, world, replay


def body_poses(world: World, replay: Replay, time: float) -> dict[str, np.ndarray]:
    """Poses (4, 4) of all bodies at a time, as MuJoCo has them."""
    data = mujoco.MjData(world.model)
    data.qpos[:] = replay.qpos[np.abs(replay.time - time).argmin()]
    mujoco.mj_kinematics(world.model, data)
    poses = {}
    for body in range(world.model.nbody):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        poses[world.model.body(body).name] = T
    return poses


def off_by(hand: Hand, *, other_frames: bool = False) -> float:
    """Largest distance (m) of links from their bodies; with `other_frames`, from where these began in the links."""
    model, world, replay = recorded(hand)
    motion = replay_recording(hand, model, replay, world.model)
    links = [link.name for link in hand.links]
    T_link = Chain(hand, links)(motion.T_root, motion.q).T_world_link
    worst, start = 0.0, {}
    for frame, time in enumerate(motion.time):
        for body, T in body_poses(world, replay, time).items():
            link = model.links.get(body.removeprefix(f"{HAND}/"))
            if body.startswith(f"{HAND}/") and link in links:
                T_own = T_link[frame, links.index(link)]
                at = start.setdefault(link, np.linalg.inv(T_own) @ T if other_frames else np.eye(4))
                worst = max(worst, float(np.linalg.norm((T_own @ at - T)[:3, 3])))
    return worst


def test_bodies_around_the_object_are_where_mujoco_has_them() -> None:
    hand, T = load_hand("allegro", candidates=16), np.eye(4)
    T[:3, 3] = 0.0, 0.3, 0.1
    far = np.eye(4)
    far[0, 3] = 1.0
    ball = build_body("ball", [sphere(0.02)], candidates=16)
    around = Environment((EnvironmentBody("ball", ball, T, movable=True), EnvironmentBody("post", ball, far)), T)
    model, obj = model_of(hand), load_object("sphere:0.03", candidates=16)
    world = build_world(model, obj, Task(SCENE, scene=around))
    replay = record(world, moving(hand), "lift", name="a ball", hand=hand.name)
    assert replay is not None
    motion = replay_recording(hand, model, replay, world.model)
    assert list(motion.T_bodies) == ["ball"]
    first = body_poses(world, replay, motion.time[0])[OBJECT]
    for frame in (0, len(motion) - 1):
        poses = body_poses(world, replay, motion.time[frame])
        np.testing.assert_allclose(
            first @ motion.T_bodies["ball"][frame], poses[f"{SCENE_PREFIX}ball"], rtol=0, atol=1e-9
        )
    assert motion.T_bodies["ball"][-1, 2, 3] < motion.T_bodies["ball"][0, 2, 3] - 0.1


def test_links_are_where_mujoco_has_them(shared_assets: Path) -> None:
    assert off_by(load_hand("allegro", candidates=16)) < 1e-9
    assert off_by(load_hand(shared_assets / "hands/robotiq3f/robotiq3f.urdf", candidates=16)) < 1e-9


def test_mimic_joints_follow_as_closely_as_in_simulation(tmp_path: Path) -> None:
    # Followers are tied by constraints that give a little while the hand moves.
    hand = spread_gripper(tmp_path / "spread")
    # Farther closed its fingers meet, and press on each other.
    apart = replace(hand, rest=hand.lower, upper=hand.lower + 0.3)
    assert 1e-9 < off_by(apart) < 2e-5
    assert 1e-9 < off_by(underactuated(tmp_path / "five")) < 1e-4


@pytest.mark.parametrize(("name", "most"), [("leap", 2e-6), ("shadow", 2e-4)])
def test_links_of_an_mjcf_are_where_the_mjcf_is_that_of_the_urdf(shared_assets: Path, name: str, most: float) -> None:
    mjcf = shared_assets / "hands" / f"{name}_mjcf" / "right_hand.xml"
    hand = replace(load_hand(name, mjcf=mjcf, candidates=16), collision="mjcf")
    # Axes of the Shadow hand's MJCF differ by hundredths of a degree.
    assert off_by(hand, other_frames=True) < most


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro", candidates=16)


@pytest.fixture(scope="module")
def known(hand: Hand) -> tuple[HandModel, World, Replay]:
    return recorded(hand)


@pytest.fixture(scope="module")
def motion(hand: Hand, known: tuple[HandModel, World, Replay]) -> Recording:
    model, world, replay = known
    return replay_recording(hand, model, replay, world.model)


def test_a_free_object_flies_as_the_push_says(known: tuple[HandModel, World, Replay], motion: Recording) -> None:
    pushed, moved = motion.pushed, motion.T_object[:, 0, 3]
    since = dict(zip(known[2].time, known[2].since_stage(), strict=True))
    t, dt = np.array([since[time] for time in motion.time[pushed]]), DEXGRASPBENCH.timestep
    expected = DEXGRASPBENCH.acceleration * t * (t + dt) / 2
    np.testing.assert_allclose(moved[pushed], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(motion.T_object[0], np.eye(4))
    np.testing.assert_allclose(motion.force, [1.0, 0.0, 0.0])
    # It ends soon after the object is lost, not after the twenty metres that it would fly.
    assert MAX_DISPLACEMENT_M < moved[-1] < MAX_DISPLACEMENT_M + 0.06
    assert moved[-2] < MAX_DISPLACEMENT_M
    first = int(motion.lost.argmax())
    assert moved[first - 1] < DEXGRASPBENCH.farthest <= moved[first]
    assert motion.lost[first:].all() and not motion.succeeds
    assert_names(motion.text(0), "0.00 s", "0.0 mm", "0.0°")
    # 10 m/s^2 for 0.2 s, in steps of 4 ms: 204 mm.
    at = int(np.searchsorted(motion.time, 0.8 + 0.2 - 1e-9))
    assert_names(motion.text(at), "+x", "0.20 s", "204.0 mm", "0.0°", "lost")


def moved_by(replay: Replay, T: np.ndarray) -> Replay:
    """Hand, object and push moved together by T (4, 4)."""
    qpos = replay.qpos.copy()
    for body in (HAND, OBJECT):
        columns = [replay.qpos_names.index(f"{body} {axis}") for axis in POSE_AXES]
        qpos[:, columns] = pose_from_transform(T @ transform_from_pose(qpos[:, columns]))
    return replace(replay, qpos=qpos, force=T[:3, :3] @ replay.force)


def test_where_in_the_world_it_was_simulated_does_not_matter(
    hand: Hand, known: tuple[HandModel, World, Replay], motion: Recording
) -> None:
    model, _, replay = known
    moved = replay_recording(hand, model, moved_by(replay, exp_se3(np.array([0.3, -0.2, 0.1, 0.5, -0.4, 2.0]))))
    for name in ("T_root", "q", "T_object", "force"):
        np.testing.assert_allclose(getattr(moved, name), getattr(motion, name), atol=1e-7, err_msg=name)


@pytest.mark.parametrize("reason", ["rotated", "held"])
def test_an_object_is_lost_once_it_has_rotated_by_15_degrees(hand: Hand, known: tuple, reason: str) -> None:
    model, _, replay = known
    angle, qpos = np.linspace(0.0, np.radians(29.0), len(replay)), replay.qpos.copy()
    columns = [replay.qpos_names.index(f"{OBJECT} {axis}") for axis in POSE_AXES]
    still = np.zeros((len(angle), 3))
    qpos[:, columns] = np.column_stack([still, np.cos(angle / 2), still[:, :2], np.sin(angle / 2)])
    shown = replay_recording(hand, model, replace(replay, qpos=qpos, reason=reason))
    turned = np.interp(shown.time, replay.time, angle)
    np.testing.assert_array_equal(shown.lost, (turned >= np.radians(15.0)) & (reason != "held"))
    assert len(shown) > 100 and f"{np.degrees(angle[-1]):.1f}°" in shown.text(len(shown) - 1)


def test_frames_are_at_most_50_a_second(hand: Hand, known: tuple[HandModel, World, Replay], motion: Recording) -> None:
    assert np.diff(motion.time).min() > 1 / FRAME_RATE_HZ - 1e-6
    model, _, replay = known
    fast = replay_recording(hand, model, replace(replay, time=0.3 * replay.time))
    assert np.diff(fast.time[:-1]).min() > 1 / FRAME_RATE_HZ - 1e-6 and len(fast) < len(motion) / 2
    # The last frame is always shown.
    assert fast.time[-1] == pytest.approx(0.3 * motion.time[-1]) and fast.contacts == ()


def test_contacts_are_as_in_mujoco(hand: Hand) -> None:
    """The ball is pushed against the hand, which stands in its way."""
    model = model_of(hand)
    world = build_world(model, load_object("sphere:0.03", candidates=16), Task(DEXGRASPBENCH))
    T = np.tile(np.eye(4), (1, 3, 1, 1))
    T[..., :3, 3] = [0.1, 0.0, 0.0]
    replay = record(world, Motion(T, np.tile(hand.rest, (1, 3, 1))), "+x", name="a ball", hand=hand.name)
    assert replay is not None
    shown = replay_recording(hand, model, replay, world.model)
    data = mujoco.MjData(world.model)
    counts = []
    for frame, time in enumerate(shown.time):
        data.qpos[:] = replay.qpos[np.abs(replay.time - time).argmin()]
        mujoco.mj_fwdPosition(world.model, data)
        of_object = (world.model.geom_bodyid[data.contact.geom] == world.object_body).sum(axis=1) == 1
        expected = data.contact.pos[of_object & (data.contact.dist < 5e-4)]
        np.testing.assert_allclose(shown.contacts[frame], expected, atol=1e-12)
        counts.append(len(expected))
    assert max(counts) > 0
    # They are in the frame of the object at its start.
    T = exp_se3(np.array([0.3, -0.2, 0.1, 0.5, -0.4, 2.0]))
    moved = replay_recording(hand, model, moved_by(replay, T), world.model)
    np.testing.assert_allclose(np.concatenate(moved.contacts), np.concatenate(shown.contacts), atol=1e-5)


def test_a_replay_of_another_hand_is_refused(known: tuple[HandModel, World, Replay]) -> None:
    other = load_hand("leap", candidates=16)
    with refused(GraspRefineError, "allegro"):
        replay_recording(other, model_of(other), known[2])


def test_replay_files_are_known_by_their_entries(tmp_path: Path, hand: Hand, known: tuple) -> None:
    model, world, replay = known
    save_replay(tmp_path / "replay.npz", replay)
    np.savez(tmp_path / "other.npz", time=np.zeros(3))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04")
    (tmp_path / "replay.txt").write_bytes((tmp_path / "replay.npz").read_bytes())
    found = {path.name for path in tmp_path.iterdir() if is_replay(path)}
    assert found == {"replay.npz"} and not is_replay(tmp_path / "missing.npz")
    again = replay_recording(hand, model, load_replay(tmp_path / "replay.npz"), world.model)
    first = replay_recording(hand, model, replay, world.model)
    np.testing.assert_array_equal(again.q, first.q)
    np.testing.assert_array_equal(again.T_root, first.T_root)
    assert again.title == "simulation, +x, moved"
