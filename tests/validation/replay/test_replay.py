"""Recorded motions: what they say, and their files."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.npz_files import load_npz, save_npz
from grasp_refine.validation.replay.replay import Replay, Stage, load_replay, qpos_names, save_replay
from recorded_gripper import Recorded, recorded_gripper
from refusals import refused


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return recorded_gripper()


@pytest.fixture
def replay(recorded: Recorded) -> Replay:
    return recorded.replay


def test_a_file_gives_back_what_was_recorded(replay: Replay, tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "replay.npz"
    save_replay(path, replay)
    loaded = load_replay(path)
    for field in fields(Replay):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(replay, field.name), err_msg=field.name)
    assert [entry.name for entry in path.parent.iterdir()] == ["replay.npz"], "nothing is left beside it"


def test_values_of_qpos_have_names(recorded: Recorded) -> None:
    names = qpos_names(recorded.model)
    assert names[:7] == tuple(f"object {axis}" for axis in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    assert names[14:] == ("hand/left", "hand/left_tip", "hand/right", "hand/right_tip")
    np.testing.assert_array_equal(recorded.replay.object_pose, recorded.replay.qpos[:, :7])


def test_the_object_moves_and_turns_from_where_it_lay(replay: Replay) -> None:
    qpos = replay.qpos.copy()
    qpos[0, :7] = [1, 2, 3, 1, 0, 0, 0]
    qpos[1, :7] = [1, 2, 3, np.cos(0.2), 0, np.sin(0.2), 0]
    qpos[2, :7] = [1, 2.3, 3.4, 0, 0, 0, 1]
    moved, turned = replace(replay, qpos=qpos).displacement()
    np.testing.assert_allclose(moved[:3], [0, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(turned[:3], [0, 0.4, np.pi], atol=1e-7)
    nameless = replace(replay, qpos_names=("thing x", *replay.qpos_names[1:]))
    with refused(GraspRefineError, "'object'", "thing x"):
        nameless.displacement()


def test_an_object_that_is_lifted_should_be_as_high_as_the_hand(replay: Replay) -> None:
    stage = np.where(replay.stage == Stage.PUSH, Stage.LIFT, replay.stage)
    # The hand moves before the lift too, and stood somewhere at its beginning.
    height = np.where(stage == Stage.LIFT, np.linspace(-0.2, 0.3, len(replay)), 0.0) + 0.07
    height[:101] += np.linspace(-0.03, 0.0, 101)
    mocap_pos = np.stack([0.4 + 0 * height, 0 * height, height], axis=1)
    qpos = np.tile(replay.qpos[0], (len(replay), 1))
    qpos[101:, 2] += height[101:] - 0.07
    qpos[-1, 2] -= 0.004
    lift = replace(replay, stage=stage, mocap_pos=mocap_pos, qpos=qpos, direction="lift")
    assert lift.lifted()[-1] == pytest.approx([0.0, 0.0, 0.3])
    np.testing.assert_array_equal(lift.lifted()[:101], 0.0)
    np.testing.assert_allclose(lift.displacement()[0], [*[0.0] * 225, 0.004], atol=1e-12)
    np.testing.assert_array_equal(replay.lifted(), 0.0)


def test_time_in_a_stage_begins_where_the_one_before_ended(replay: Replay) -> None:
    since = replay.since_stage()
    np.testing.assert_allclose(
        since[[0, 1, 50, 51, 100, 101, 225]], [0, 0.004, 0.2, 0.004, 0.2, 0.004, 0.5], atol=1e-12
    )


@pytest.mark.parametrize("count", [1, 4, 5, 60, 1000])
def test_thinned_frames_keep_the_ends_of_stages(replay: Replay, count: int) -> None:
    frames = replay.subsample(count)
    assert {0, 50, 100, 225} <= set(frames.tolist())
    assert len(frames) == min(max(count, 4), len(replay))
    assert (np.diff(frames) > 0).all()
    if count == 60:
        assert np.diff(frames).max() <= 8, "evenly spread"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"qpos": None}, ("qpos",)),
        ({"schema": 2}, ("schema 2", "1")),
        ({"qpos": np.zeros((226, 3))}, ("qpos", "226 x 18", "(226, 3)")),
        ({"qvel": np.zeros(226)}, ("qvel", "226 x ", "(226,)")),
        ({"time": -np.arange(226.0)}, ("time",)),
        ({"time": np.zeros(0)}, ("frames",)),
        ({"stage": np.full(226, 9)}, ("stage", "0 (close)")),
        ({"force": np.array([1.0, np.nan, 0.0])}, ("force",)),
        ({"hand": 3.0}, ("hand",)),
    ],
)
def test_a_damaged_file_is_refused(replay: Replay, tmp_path: Path, change: dict, named: tuple[str, ...]) -> None:
    path = tmp_path / "replay.npz"
    save_replay(path, replay)
    entries = {**load_npz(path).entries, **change}
    save_npz(path, {key: value for key, value in entries.items() if value is not None})
    with refused(GraspFileError, *named) as caught:
        load_replay(path)
    assert str(caught.value).startswith(f"{path}: ")
