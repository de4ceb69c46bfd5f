"""Recording what was simulated: names of files, and what is said when one cannot be written."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.load import Loader, load_problem
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.replay.replay import load_replay
from grasp_refine.validation.simulation import simulate
from grasp_refine_apps.commands.recording import Recording
from gripper import around, ball, gripper
from refusals import assert_names, refused

EXAMPLE = resource_dir("robots") / "allegro" / "example_rounded_box.npz"
MOTION = around(4.0, count=2)
FILES = (Path("grasps.npz"),)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(replace(DEXGRASPBENCH, checks=1)))


@pytest.fixture(scope="module")
def group() -> Group:
    """Two grasps on a ball, as far as names go."""
    (found,) = load_problem(ProblemSpec(index=(2, 3), grasps=EXAMPLE)).groups
    return replace(found, object="ball")


@pytest.fixture(scope="module")
def problems(group: Group) -> list[Problem]:
    problem = Loader(ProblemSpec(index=(2, 3), grasps=EXAMPLE)).problem()
    groups = tuple(replace(group, object="ball") for group in problem.groups)
    return [replace(problem, hand=replace(problem.hand, name="gripper"), groups=groups)]


def recorded(recording: Recording, group: Group, world: World, folder: Path) -> list[str]:
    return list(recording.record(group, world, MOTION, simulate(world, MOTION), "gripper", folder))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_each_grasp_has_its_files(world: World, group: Group, tmp_path: Path) -> None:
    lines = recorded(Recording(tmp_path, direction="+x"), group, world, tmp_path)
    stems = [f"gripper_ball_{number}_+x" for number in (2, 3)]
    assert names(tmp_path) == [f"{stem}{ending}" for stem in stems for ending in (".npz", ".xml")]
    for number, stem, line in zip((2, 3), stems, lines, strict=True):
        assert_names(line, f"ball {number}: +x held", f"{tmp_path / stem}.npz, .xml")


def test_a_model_stays_at_the_pregrasp_until_commanded_to_close(world: World, group: Group, tmp_path: Path) -> None:
    recorded(Recording(tmp_path, direction="+x"), group, world, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "gripper_ball_2_+x.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("pregrasp").id)
    for _ in range(50):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, load_replay(tmp_path / "gripper_ball_2_+x.npz").qpos[0], atol=1e-9)


def test_a_place_that_cannot_be_written_is_found_out_before_the_work(problems: list[Problem], tmp_path: Path) -> None:
    Recording(tmp_path / "new" / "folder").check(DEXGRASPBENCH, FILES, problems, overwrite=False)
    assert not names(tmp_path)
    (tmp_path / "file").write_text("")
    for folder in (Path("/proc/x"), tmp_path / "file", tmp_path / ("x" * 300)):
        with refused(GraspRefineError, folder):
            Recording(folder).check(DEXGRASPBENCH, FILES, problems, overwrite=False)


@pytest.mark.parametrize("suffix", [".npz", ".xml", ".gif"])
def test_replays_that_exist_are_kept(problems: list[Problem], tmp_path: Path, suffix: str) -> None:
    there = tmp_path / f"gripper_ball_3_-y{suffix}"
    there.write_text("kept")
    for direction in ("-y", None):
        recording = Recording(tmp_path, direction=direction, film=suffix == ".gif")
        with refused(GraspRefineError, there, "`overwrite`"):
            recording.check(DEXGRASPBENCH, FILES, problems, overwrite=False)
        replace(recording, film=False).check(DEXGRASPBENCH, FILES, problems, overwrite=True)
    Recording(tmp_path, direction="+y").check(DEXGRASPBENCH, FILES, problems, overwrite=False)


def test_a_lift_is_recorded_from_the_pregrasp_to_the_top(group: Group, tmp_path: Path) -> None:
    world = build_world(gripper(), ball(), Task(TABLETOP))
    T = around(8.0, count=2).T_world_root.copy()
    # The plates reach below the ball.
    T[..., 2, 3] += 0.015
    motion = replace(around(8.0, count=2), T_world_root=T)
    trials = simulate(world, motion)
    assert trials.success.all()
    list(Recording(tmp_path).record(group, world, motion, trials, "gripper", tmp_path))
    replay = load_replay(tmp_path / "gripper_ball_2_lift.npz")
    moved, _ = replay.displacement()
    assert moved[-1] == pytest.approx(trials.displacement_m[0, 0], abs=1e-12)
    assert replay.lifted()[-1] == pytest.approx([0.0, 0.0, TABLETOP.lift])
    assert np.linalg.norm(replay.object_pose[-1, :3] - replay.object_pose[0, :3]) > 0.9 * TABLETOP.lift
