"""The work on a shard: what comes out depends on its inputs, and on nothing that was worked on before."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compiled import needs_compiled
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.problem.input_cache import NoCache
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.results.verdict import should_hold
from grasp_refine_apps.batch.bundle import Bundle, bundles_of
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.batch.plan import Plan, Planner
from grasp_refine_apps.batch.record import State, state_of
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.batch.work import BundleWork, problem_of
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.processes.task import Failed, Sign

EXAMPLES = resource_dir("robots") / "allegro"
QUICK = Config(weights=Weights(wrench=0.0), solver=LevenbergMarquardt(iterations=5))


def planned(folder: Path, source: object, batch: str = "a batch", **defaults: object) -> Plan:
    jobs = read_jobs([str(source)], Inputs(**defaults))
    return Planner(folder, 2, batch, {}, 0).plan(jobs, lambda line: None, lambda number, name: None)


def worked(shard: Shard, protocol: str | None = None) -> Done:
    work = BundleWork(QUICK, () if protocol is None else ("mujoco",), {})
    (done,) = work(Bundle((shard,)), lambda *sign: None)
    assert isinstance(done, Done)
    return done


def content(path: Path) -> dict[str, bytes]:
    with np.load(path) as entries:
        return {name: entries[name].tobytes() for name in entries.files if name not in ("wall_s", "cpu_s")}


@pytest.fixture
def grasps(tmp_path: Path) -> Path:
    return Path(shutil.copy(EXAMPLES / "example_rounded_box.npz", tmp_path / "grasps.npz"))


def test_a_shard_comes_out_the_same_whatever_came_before(grasps: Path, tmp_path: Path):
    first, second = planned(tmp_path / "one", grasps).shards
    other = planned(tmp_path / "two", grasps, batch="another").shards[1]
    done = worked(first)
    worked(second)
    assert (done.grasps, done.held) == (2, None)
    assert state_of(first) is State.COMPLETE
    assert state_of(planned(tmp_path / "one", grasps).shards[0]) is State.COMPLETE
    worked(other)
    assert content(second.path) == content(other.path)


def test_signs_of_life_say_how_far_it_is_and_numbers_are_those_of_the_file(grasps: Path, tmp_path: Path):
    with np.load(grasps) as file:
        np.savez(grasps, **{**file, "object": ["rounded_box", "mug"] * 2})
    (shard,) = planned(tmp_path / "out", grasps, object_name="rounded_box").shards
    heard: list[Sign] = []
    work = BundleWork(QUICK, ("mujoco",), {})  # simulates
    (done,) = work(Bundle((shard,)), lambda what, share, finished=0: heard.append(Sign(what, share, finished)))
    with np.load(shard.path) as file:
        provenance = json.loads(str(file["provenance"]))
        held = tuple(int(file[f"simulation_{side}"].sum()) for side in ("before", "after"))
        good = tuple(int(should_hold(file[f"quality_{side}"]).sum()) for side in ("before", "after"))
    assert (provenance["row"], provenance["index"]) == ([0, 2], [0, 1]), "of the file, and of its object"
    assert (done.held, done.good) == (held, good)
    for values in zip(*(sign[1:] for sign in heard), strict=True):
        assert list(values) == sorted(values)
    assert (heard[0][1:], heard[-1][1:]) == ((0.0, 0), (1.0, 2))
    refined = {what: refined for what, _, refined in heard}
    assert [count for what, count in refined.items() if "simulat" in what] == [2, 2]
    assert refined["refining"] > 0, "grasps count as soon as they are refined, not when the shard ends"


def test_each_table_is_simulated_by_itself(grasps: Path, tmp_path: Path):
    """Worlds are kept for later shards: once, those with another table were taken for the same."""
    jobs = tmp_path / "jobs.csv"
    jobs.write_text("name,grasps,table\nlow,grasps.npz,-0.3\nhigh,grasps.npz,-0.046\n")
    both = [shard for shard in planned(tmp_path / "both", jobs).shards if shard.name.endswith("part 0")]
    for shard in both:
        worked(shard, "tabletop")
    alone = planned(tmp_path / "alone", jobs, batch="another").shards
    (high,) = (shard for shard in alone if shard.task.job == "high" and shard.name.endswith("part 0"))
    worked(high, "tabletop")
    (found,) = (shard for shard in both if shard.task.job == "high")
    assert content(found.path) == content(high.path)
    assert (
        content(found.path)["simulation_displacement_m_before"]
        != content(next(shard for shard in both if shard.task.job == "low").path)["simulation_displacement_m_before"]
    )


def test_each_shard_of_sampled_grasps_is_another_draw(tmp_path: Path):
    shards = planned(tmp_path, "sample:4", hand="franka_hand", object="box:0.04,0.04,0.06").shards
    first, second, again = (
        problem_of(shard.task, 0, NoCache(), lambda *_: None).groups[0].grasps.hand_pose
        for shard in (*shards, shards[0])
    )
    np.testing.assert_array_equal(first, again)
    assert len(first) == len(second) == 2 and (np.abs(first[:, None] - second).max(axis=2) > 1e-3).all()


@needs_compiled
def test_shards_of_several_objects_are_refined_together_and_come_out_as_alone(tmp_path: Path):
    jobs = tmp_path / "jobs.csv"
    files = [EXAMPLES / f"example_{name}.npz" for name in ("rounded_box", "mug", "bottle")]
    jobs.write_text("name,grasps\n" + "".join(f"{file.stem},{file}\n" for file in files))
    shards = planned(tmp_path / "out", jobs).shards
    lost = replace(shards[2], task=replace(shards[2].task, object_digest="another"))
    some = (*shards[:2], lost, *shards[3:])
    found = BundleWork(QUICK, (), {})(Bundle(some), lambda *sign: None)
    assert [type(one) for one in found] == [Failed if shard is lost else Done for shard in some], "one fails alone"
    together = {shard.number: content(shard.path) for shard in some if shard is not lost}
    alone = planned(tmp_path / "alone", jobs).shards
    for shard in alone:
        done = worked(shard)
        if shard.number in together:
            assert content(shard.path) == together[shard.number]
            assert done.good == found[shard.number].good and 0.0 < found[shard.number].cpu_s


def test_bundles_keep_all_workers_busy(tmp_path: Path):
    sets = tmp_path / "sets"
    sets.mkdir()
    for k in range(12):
        shutil.copy(EXAMPLES / "example_rounded_box.npz", sets / f"{k}.npz")
    shards = planned(tmp_path / "out", sets).shards
    assert sum(shard.size for shard in shards) == 48
    for workers, sizes in ((1, [12] * 4), (2, [6] * 8), (100, [2] * 24)):
        bundles = bundles_of(shards, workers)
        assert [bundle.size for bundle in bundles] == sizes
        assert [shard for bundle in bundles for shard in bundle.shards] == list(shards)
    other = replace(shards[1], task=replace(shards[1].task, hand=("another", "hand")))
    assert len(bundles_of([shards[0], other, *shards[2:]], 1)[0].shards) == 1, "a bundle is of one hand"
