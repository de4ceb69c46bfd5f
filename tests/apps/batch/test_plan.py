"""Shards: every grasp in exactly one; jobs that cannot be done cost no other."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import batch_rows
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, save_npz
from grasp_refine.problem.load import Loader
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.jobs import Job, read_jobs
from grasp_refine_apps.batch.plan import Plan, Planner, part_of
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.commands.inputs import Inputs

EXAMPLES = resource_dir("robots") / "allegro"


def planned(*sources: object, size: int = 64, **defaults: object) -> Plan:
    jobs = read_jobs([str(source) for source in sources], Inputs(**defaults))
    return Planner(Path("/out"), size, "a batch", {}, 0).plan(jobs, lambda line: None, lambda number, name: None)


def grasps_of(objects: list[str], scales: list[float]) -> GraspSet:
    """Grasps of the example hand on some objects at some scales."""
    example = load_grasps(EXAMPLES / "example_mug.npz").select(np.zeros(len(objects), dtype=int))
    return replace(example, object=np.array(objects), scale=np.array(scales))


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """A file of 11 grasps on two objects at two scales, in no order."""
    objects = ["mug", "bowl", "mug", "mug", "bowl", "mug", "mug", "mug", "bowl", "mug", "mug"]
    scales = [1.0, 1.0, 0.9, 1.0, 1.0, 0.9, 1.0, 0.9, 1.0, 1.0, 0.9]
    path = tmp_path / "mixed.npz"
    save_npz(path, grasps_of(objects, scales).arrays())
    return path


def test_a_file_with_control_characters_in_its_name_costs_no_other(mixed: Path):
    """It once refused the whole folder."""
    shutil.copy(mixed, mixed.with_name("a\nb\x1b[2J.npz"))
    plan = planned(mixed.parent)
    assert sum(shard.size for shard in plan.shards) == 11
    (refused,) = plan.refused
    assert refused.job == "a\\nb\\x1b[2J" and refused.message.isprintable()
    assert {shard.task.job for shard in plan.shards} == {"mixed"}


def test_every_grasp_is_in_exactly_one_shard_of_its_object(mixed: Path):
    grasps = load_grasps(mixed)
    shards = planned(mixed, size=3).shards
    assert [shard.size for shard in shards] == [3, 3, 2, 3]
    assert [shard.number for shard in shards] == [0, 1, 2, 3]
    rows = np.concatenate([shard.task.rows for shard in shards])
    assert sorted(rows.tolist()) == list(range(11))
    for shard in shards:
        assert set(grasps.object[shard.task.rows].tolist()) == {shard.task.object}
        of_object = np.flatnonzero(grasps.object == shard.task.object)
        np.testing.assert_array_equal(of_object[shard.task.index], shard.task.rows)
    # Those of one size are together, or a shard would work on fewer at once.
    assert grasps.scale[np.concatenate([shard.task.rows for shard in shards[:3]])].tolist() == [0.9] * 4 + [1.0] * 4
    assert len({shard.path for shard in shards}) == 4
    assert shards[1].path == Path("/out/mixed/allegro_mug_00001.npz")


def test_shards_of_one_hand_and_object_follow_each_other_whatever_their_jobs(mixed: Path, tmp_path: Path):
    other = Path(shutil.copy(mixed, tmp_path / "other.npz"))
    save_npz(tmp_path / "mugs.npz", grasps_of(["mug"], [1.0]).arrays())
    shards = planned(mixed, other, tmp_path / "mugs.npz", size=100).shards
    assert [(shard.task.job, shard.task.object) for shard in shards] == [
        ("mixed", "mug"), ("other", "mug"), ("mugs", "mug"), ("mixed", "bowl"), ("other", "bowl"),
    ]  # fmt: skip
    assert len({shard.group for shard in shards}) == 2


def test_sampled_grasps_are_drawn_shard_by_shard():
    shards = planned("sample:10", size=4, hand="allegro", object="mug").shards
    assert [shard.size for shard in shards] == [4, 4, 2]
    assert [shard.task.sampled for shard in shards] == [(4, 0), (4, 1), (2, 2)]


def test_jobs_that_cannot_be_done_are_named_and_the_others_planned(mixed: Path, tmp_path: Path):
    (tmp_path / "broken.npz").write_text("no grasps")
    save_npz(tmp_path / "foreign.npz", replace(grasps_of(["mug"], [1.0]), hand="claw").arrays())
    plan = planned(tmp_path / "broken.npz", tmp_path / "none.npz", mixed, "sample:3", tmp_path / "foreign.npz")
    assert [shard.task.job for shard in plan.shards] == ["mixed", "mixed"]
    said = {refused.job: refused.message for refused in plan.refused}
    assert "not an .npz grasp file" in said["broken"]
    assert "no such grasp file" in said["none"]
    assert "`hand` and `object`" in said["sample_3"]
    assert "'claw'" in said["foreign"]


def test_parts_are_runs_of_shards_that_make_up_the_whole(mixed: Path):
    shards = planned(mixed, size=1).shards
    for parts in (1, 2, 3, 4, 11, 20):
        found = [part_of(shards, part, parts) for part in range(1, parts + 1)]
        assert [shard for part in found for shard in part] == list(shards)
        sizes = [sum(shard.size for shard in part) for part in found]
        assert max(sizes) - min(sizes) <= 1
    assert part_of((), 1, 3) == ()
    large = tuple(batch_rows.shard(number, Path(), size) for number, size in enumerate((5, 1, 1, 1, 1, 1)))
    assert part_of(large, 1, 2) == large[:1] and part_of(large, 2, 2) == large[1:]


def test_folders_of_jobs_are_short_distinct_and_no_reserved_names(mixed: Path):
    names = ("report.html", "index.csv", f"{'é' * 200}a", f"{'é' * 200}b")
    jobs = [Job(name, ProblemSpec(grasps=mixed)) for name in names]
    shards = Planner(Path("/out"), 64, "a batch", {}, 0).plan(jobs, lambda line: None, lambda *_: None).shards
    folders = list(dict.fromkeys(shard.path.parts[2] for shard in shards))
    assert folders[:2] == ["report.html_", "index.csv_"] and len(folders) == 4
    assert max(len(folder.encode()) for folder in folders) <= 150


def test_files_whose_names_differ_in_odd_letters_only_do_not_meet(tmp_path: Path):
    path = tmp_path / "a b.npz"
    save_npz(path, grasps_of(["mug"], [1.0]).arrays())
    shutil.copy(path, tmp_path / "a:b.npz")
    shards: tuple[Shard, ...] = planned(tmp_path).shards
    assert [shard.path.as_posix() for shard in shards] == [
        "/out/a_b/allegro_mug_00000.npz",
        "/out/a_b/allegro_mug_00000_.npz",
    ]


def test_a_file_that_cannot_be_read_costs_no_other(mixed: Path):
    """A bit of a zip's directory once stopped the whole batch, by an exception of zipfile."""
    with zipfile.ZipFile(mixed.with_name("damaged.pt"), "w") as archive:
        archive.writestr("a/data.pkl", b"")
    data = bytearray(mixed.with_name("damaged.pt").read_bytes())
    data[data.rindex(b"PK\x05\x06") + 4] = 1
    mixed.with_name("damaged.pt").write_bytes(data)
    mixed.with_name("notes.json").write_text("{}")
    for source in (mixed.parent, mixed.parent / "*.*"):
        plan = planned(source)
        assert sum(shard.size for shard in plan.shards) == 11
        assert "damaged" in [refused.job for refused in plan.refused]
    assert [refused.job for refused in planned(mixed.parent).refused] == ["damaged"]


def test_an_error_of_a_reader_fails_its_own_job_with_its_traceback(mixed: Path, monkeypatch: pytest.MonkeyPatch):
    shutil.copy(mixed, mixed.with_name("other.npz"))
    read = Loader.read

    def broken(loader: Loader, path: Path) -> object:
        if path.name == "other.npz":
            raise RuntimeError("a fault of the reader")
        return read(loader, path)

    monkeypatch.setattr(Loader, "read", broken)
    plan = planned(mixed.parent)
    assert sum(shard.size for shard in plan.shards) == 11
    (refused,) = plan.refused
    assert refused.job == "other" and refused.message == "RuntimeError: a fault of the reader"
    assert "in broken" in refused.traceback
