"""LeRobot data sets: episodes are the trajectories of the grasps, and tables say what is in them.

`LeRobotDataset` of lerobot 0.4.4, which needs a gigabyte of packages, read such a folder by hand.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from ball_hand import FROM_ABOVE, ball_hand, grasp
from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import distances, exp_so3, transform_from_pose
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.targets import export
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.motion.trajectory import PERIOD_S, SPEED_SHARE, speed_limits
from grasp_refine.scene.scene import Scene

parquet = pytest.importorskip("pyarrow.parquet", reason="LeRobot data sets need pyarrow")


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> ExportedGrasps:
    """Two grasps of a ball, the second with a turned palm that opens another way."""
    hand = ball_hand(tmp_path_factory.mktemp("hand"))
    (scene, motion), turn = grasp(hand), np.eye(4)
    turn[:3, :3] = exp_so3(np.array([0.1, -0.2, 0.4]))
    T, q = np.repeat(motion.T_world_root, 2, axis=0), np.repeat(motion.q, 2, axis=0)
    T[1] = turn @ FROM_ABOVE
    T[:, 0, 0, 3] += 0.003
    q[1, 0] += 0.002
    scene = Scene(hand, scene.object, T[:, 1], q[:, 1], task=scene.task)
    return ExportedGrasps("a ball", 1.0, scene, Motion(T, q), np.arange(2))


@pytest.fixture(scope="module")
def folder(part: ExportedGrasps, tmp_path_factory: pytest.TempPathFactory) -> Path:
    (found,) = export([part], "lerobot", tmp_path_factory.mktemp("exported") / "set")
    return found


@pytest.fixture(scope="module")
def info(folder: Path) -> dict:
    return json.loads((folder / "meta/info.json").read_text())


@pytest.fixture(scope="module")
def frames(folder: Path, info: dict) -> dict[str, np.ndarray]:
    table = parquet.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def test_every_column_is_described_with_its_type_and_size(folder: Path, info: dict, frames: dict[str, np.ndarray]):
    table = parquet.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    words = {"float": "float32", "int64": "int64"}
    for name, feature in info["features"].items():
        kind = table.schema.field(name).type
        assert words[str(getattr(kind, "value_type", kind))] == feature["dtype"]
        assert list(frames[name].shape[1:]) == (feature["shape"] if feature["names"] else [])
    assert info["total_frames"] == len(frames["index"])


def test_episodes_approach_pass_the_stages_and_lift(part: ExportedGrasps, info: dict, frames: dict[str, np.ndarray]):
    names = info["features"]["observation.state"]["names"]
    assert names[7:] == list(part.joint_names)
    for number in range(2):
        state = frames["observation.state"][frames["episode_index"] == number]
        joints, T = state[:, 7:], transform_from_pose(state[:, :7].astype(np.float64))
        for stage in range(3):
            moved, turned = distances(T, np.tile(part.motion.T_world_root[number, stage], (len(T), 1, 1)))
            away = np.abs(joints - part.joint_values[number, stage]).max(axis=1) + moved + turned
            assert away.min() < 1e-6
        lifted = T[-1, :3, 3] - part.motion.T_world_root[number, 2, :3, 3]
        np.testing.assert_allclose(lifted, [0.0, 0.0, 0.1], atol=1e-6)
        assert distances(T[:1], part.motion.T_world_root[[number], 0])[0] == pytest.approx(0.1, abs=1e-6)
        # Rates are within the share of the limits of the joints.
        driven = [names.index(name) - 7 for name in part.hand.joint_names]
        rate = np.abs(np.diff(joints[:, driven].astype(np.float64), axis=0)) * info["fps"]
        assert (rate <= SPEED_SHARE * speed_limits(part.hand) + 1e-4).all()


def test_actions_are_the_next_states_and_frames_are_counted(info: dict, frames: dict[str, np.ndarray]):
    assert info["fps"] == pytest.approx(1.0 / PERIOD_S)
    assert (frames["index"] == np.arange(len(frames["index"]))).all()
    for number in range(2):
        of = frames["episode_index"] == number
        state, action = frames["observation.state"][of], frames["action"][of]
        assert (action[:-1] == state[1:]).all() and (action[-1] == state[-1]).all()
        assert (frames["frame_index"][of] == np.arange(of.sum())).all()
        np.testing.assert_allclose(frames["timestamp"][of], np.arange(of.sum()) / info["fps"], atol=1e-5)


def test_quaternions_do_not_jump(frames: dict[str, np.ndarray]):
    for number in range(2):
        rotation = frames["observation.state"][frames["episode_index"] == number][:, 3:7]
        assert ((rotation[1:] * rotation[:-1]).sum(axis=1) > 0.9).all()


def test_statistics_and_episodes_are_those_of_the_frames(folder: Path, frames: dict[str, np.ndarray]):
    found = json.loads((folder / "meta/stats.json").read_text())["action"]
    np.testing.assert_allclose(found["mean"], frames["action"].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found["std"], frames["action"].std(axis=0), atol=1e-6)
    np.testing.assert_allclose(found["q50"], np.median(frames["action"], axis=0), atol=1e-6)
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for number, episode in enumerate(episodes):
        of = np.flatnonzero(frames["episode_index"] == number)
        assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (of[0], of[-1] + 1)
        assert episode["length"] == len(of) and episode["tasks"] == ["grasp a ball"]
        np.testing.assert_allclose(episode["stats/action/max"], frames["action"][of].max(axis=0), atol=1e-6)


def test_our_reader_of_tables_reads_the_last_frames(part: ExportedGrasps, folder: Path, tmp_path: Path):
    names = [f"observation.state.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    joints = ", ".join(f'{name} = "observation.state.{name}"' for name in part.hand.joint_names)
    text = f"""
table = "set"
base_link = "{part.hand.base_link}"
position = {json.dumps(names[:3])}
rotation = {json.dumps(names[3:])}
notation = "wxyz"
joints = {{{joints}}}
object = "sphere:0.03"
episode = "episode_index"
frame = "last"
"""
    shutil.copytree(folder, tmp_path / "set")
    (tmp_path / "set.toml").write_text(text)
    read = reading(tmp_path / "set.toml").grasps
    order = [part.joint_names.index(name) for name in read.joint_names]
    np.testing.assert_allclose(read.q, part.joint_values[:, 2, order], atol=1e-6)
