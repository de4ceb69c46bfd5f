"""`refine-grasp batch`: whole datasets, whatever happens on the way."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import PROGRAM, interruptible, refused, subprocess_environment
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.atomic_files import half_written_path
from grasp_refine_apps.batch import page, worst
from grasp_refine_apps.batch.session import MAX_UNWRITTEN
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.batch.work import BundleWork
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands import batch as command
from grasp_refine_apps.processes.task import Failed
from grasp_refine_apps.report import drawing
from refusals import assert_names
from running_processes import PATIENCE_S, nothing_left, soon

EXAMPLES = resource_dir("robots") / "allegro"
WITH_REPORT = ("--geometry-only", "--iterations", "12", "--index-format", "csv", "--workers", "1")
QUICK = (*WITH_REPORT, "--no-report")
"""Refinements of a moment; Parquet is tested with the index."""
TIMING = ("wall_s", "cpu_s")
FIRST = ("bottle", "rounded_box")


def batch(*arguments: object) -> int:
    return main(["batch", *map(str, arguments)])


def results(out: Path) -> dict[str, dict[str, np.ndarray]]:
    """All that result files hold, by their names, but times."""
    found = {}
    for path in sorted(out.rglob("*.npz")):
        with np.load(path) as entries:
            found[path.relative_to(out).as_posix()] = {
                name: entries[name] for name in entries.files if name not in TIMING
            }
    return found


def assert_same(one: Path, other: Path) -> None:
    """The same result files, bit for bit, but for times."""
    left, right = results(one), results(other)
    assert list(left) == list(right)
    for name, entries in left.items():
        assert list(entries) == list(right[name])
        for key, value in entries.items():
            assert value.dtype == right[name][key].dtype, (name, key)
            assert value.tobytes() == right[name][key].tobytes(), (name, key)


def index(out: Path) -> list[dict[str, str]]:
    with (out / "index.csv").open(newline="") as file:
        return list(csv.DictReader(file))


class InThisProcess:
    """Workers without a process of their own, whose start would take most of the time of a test."""

    has_queues = False

    def __init__(self, work: BundleWork, workers: int, patience_s: float | None) -> None:
        self._work, self._ended = work, []

    def workers(self, wanted: int) -> list[str]:
        return ["here"]

    def submit(self, worker: str, task: Shard) -> None:
        try:
            self._ended.append((worker, self._work(task, lambda *_: None)))
        except Exception as error:
            self._ended.append((worker, Failed.of(error)))

    def listen(self) -> list[tuple[str, Any]]:
        ended, self._ended = self._ended, []
        return ended

    def restart(self, worker: str) -> str:
        raise NotImplementedError

    def close(self) -> None:
        pass


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "LocalPool", InThisProcess)


@pytest.fixture(scope="module", autouse=True)
def plain_reports() -> Iterator[None]:
    """Few pictures, from one side, and no charts: these take a second to draw, and have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worst, "NUM_CASES", 1)
        patch.setattr(drawing, "SIDES", drawing.SIDES[:1])
        patch.setattr(page, "chart", lambda *_: "")
        yield


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two files of four grasps, on two objects, one of them convex."""
    folder = tmp_path_factory.mktemp("sets")
    for name in ("rounded_box", "bottle"):
        shutil.copy(EXAMPLES / f"example_{name}.npz", folder)
    return folder


@pytest.fixture(scope="module")
def whole(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What comes out of them without any trouble, three grasps a shard."""
    out = tmp_path_factory.mktemp("whole")
    assert batch(sources, "--out", out, "--shard-size", 3, "--json", out / "batch.json", *WITH_REPORT) == 0
    return out


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """The same results, to be changed."""
    return Path(shutil.copytree(whole, tmp_path / "out"))


def test_every_grasp_is_in_one_result_file_and_in_the_index(whole: Path, sources: Path):
    assert list(results(whole)) == [
        f"example_{name}/allegro_{name}_0000{part}.npz" for name in FIRST for part in (0, 1)
    ]
    rows = index(whole)
    assert [(row["job"], int(row["row"])) for row in rows] == [
        (f"example_{name}", row) for name in FIRST for row in range(4)
    ]
    for row in rows:
        with np.load(whole / row["file"]) as entries:
            assert float(row["quality_after"]) == entries["quality_after"][int(row["row_in_file"])]
    assert (whole / "report.html").read_text().count("<img") >= 2


@pytest.mark.usefixtures("here")
def test_grasps_are_refined_and_described_as_run_does(sources: Path, tmp_path: Path):
    settings = ("--starts", "1", "--iterations", "12", "--confidence", "0.1")
    bottle, out = sources / "example_bottle.npz", tmp_path / "out"
    assert batch(bottle, "--out", out, "--json", tmp_path / "batch.json", *QUICK[3:], *settings) == 0
    run = ("run", "--grasps", bottle, "--out", tmp_path, *settings, "--json", tmp_path / "run.json")
    assert main([str(word) for word in run]) == 0
    (found,) = results(out).values()
    with np.load(tmp_path / "allegro_bottle.npz") as expected:
        for name in set(expected.files) - {*TIMING, "provenance"}:
            np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    ours, theirs = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("batch", "run"))
    counts = ("n", "converged", "changes", "good_inputs", "good_inputs_moved")
    assert [ours["totals"][name] for name in counts] == [theirs["totals"][name] for name in counts]
    assert 0 < ours["totals"]["good_inputs"] == sum(each["quality"]["before"] >= 0.1 for each in ours["grasps"])
    for one, other in zip(ours["grasps"], theirs["grasps"], strict=True):
        assert set(one) == {*other, "job"}
        for name in set(other) - {*TIMING}:
            assert one[name] == other[name], name


@pytest.mark.usefixtures("here")
def test_what_is_complete_is_skipped_and_the_report_of_the_same_results_stays(
    copy: Path, sources: Path, capsys: pytest.CaptureFixture[str]
):
    command, report = ("--out", copy, "--shard-size", 3, *WITH_REPORT), copy / "report.html"
    before = {path: path.stat().st_mtime_ns for path in (*copy.rglob("*.npz"), report)}
    first = (copy / "index.csv").read_bytes()
    assert batch(sources, *command) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert (copy / "index.csv").read_bytes() == first and "4 of 4 shards" in capsys.readouterr().err
    (copy / "example_bottle" / "allegro_bottle_00000.npz").unlink()
    assert batch(sources, *command) == 0
    assert report.stat().st_mtime_ns > before[report]


@pytest.mark.usefixtures("here")
def test_what_is_missing_or_damaged_is_made_anew_and_comes_out_the_same(
    copy: Path, whole: Path, sources: Path, capsys: pytest.CaptureFixture[str]
):
    missing, damaged, *_ = sorted(copy.rglob("*.npz"))
    missing.unlink()
    content = damaged.read_bytes()
    damaged.write_bytes(content[:1000] + b"\0" * 100 + content[1100:])
    assert batch(sources, "--out", copy, "--shard-size", 3, *QUICK) == 0
    error = " ".join(capsys.readouterr().err.split())
    assert "2 of 4 shards" in error
    assert "allegro_bottle_00001.npz" in error and "allegro_bottle_00000.npz" not in error
    assert_same(copy, whole)


@pytest.mark.usefixtures("here")
def test_other_settings_and_other_inputs_are_made_anew(
    copy: Path, sources: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    other = ("--geometry-only", "--iterations", "5", "--index-format", "csv", "--workers", "1", "--no-report")
    before = {path: path.stat().st_mtime_ns for path in (copy / "example_bottle").glob("*.npz")}
    assert batch(sources / "example_bottle.npz", "--out", copy, "--shard-size", 3, *other) == 0
    assert len(before) == 2 and all(path.stat().st_mtime_ns != time for path, time in before.items())
    assert " 2" in capsys.readouterr().err, "both shards are told of"
    assert all(int(row["iterations"]) <= 5 for row in index(copy))


@pytest.mark.slow
def test_parts_of_a_batch_make_up_the_whole(
    whole: Path, sources: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    for part in ("2/2", "1/2"):
        command = ("--out", out, "--shard-size", 3, "--shard", part, "--json", tmp_path / "part.json")
        assert batch(sources, *command, *WITH_REPORT) == 0
        assert json.loads((tmp_path / "part.json").read_text())["totals"]["n"] == 4
        assert "--shard" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"example_bottle", "example_rounded_box"}
    assert batch(sources, "--out", out, "--shard-size", 3, *QUICK) == 0
    assert (out / "index.csv").exists()
    assert_same(out, whole)


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_bad_jobs_among_good_ones_are_named_and_the_rest_is_done(
    tmp_path: Path, sources: Path, whole: Path, capsys: pytest.CaptureFixture[str]
):
    bottle, jobs = sources / "example_bottle.npz", tmp_path / "jobs.toml"
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nthis is no mesh\n")
    (tmp_path / "torn.npz").write_bytes(bottle.read_bytes()[:500])
    bad = {
        "unreadable mesh": f'"{bottle}"\nobject = "mesh.obj"',
        "torn": '"torn.npz"',
        "no": f'"{bottle}"\nhand = "claw"',
    }
    text = "".join(f'[[job]]\nname = "{name}"\ngrasps = {job}\n' for name, job in bad.items())
    jobs.write_text(f'{text}[[job]]\ngrasps = "{bottle}"\n')
    out, summary = tmp_path / "out", tmp_path / "summary.json"
    assert batch(jobs, "--out", out, "--shard-size", 3, "--json", summary, *QUICK) == 1
    done = results(out)
    assert list(done) == [f"example_bottle/allegro_bottle_0000{part}.npz" for part in (0, 1)]
    for name, entries in done.items():
        for key in set(entries) - {"provenance"}:
            np.testing.assert_array_equal(entries[key], results(whole)[name][key])
    document = json.loads(summary.read_text())
    failed = {one["name"].partition(":")[0]: one for one in document["failed"]}
    assert set(failed) == set(bad) and document["totals"]["n"] == 4
    assert "mesh.obj" in failed["unreadable mesh"]["message"] and "Traceback" in failed["unreadable mesh"]["traceback"]
    assert failed["no"]["reason"] == "refused"
    assert_names(" ".join("".join(capsys.readouterr()).split()), *failed)
    # Mended, it comes out, and the note of the failure goes.
    assert list(out.rglob("*.failed.json"))
    jobs.write_text(f'[[job]]\nname = "unreadable mesh"\ngrasps = "{bottle}"\n')
    assert batch(jobs, "--out", out, "--shard-size", 3, *QUICK) == 0
    assert not list(out.rglob("*.failed.json"))


@pytest.mark.usefixtures("here")
def test_results_are_no_grasps_of_the_next_run(
    copy: Path, sources: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Neither those of the same command, by whatever path, nor those of another one."""
    folder = copy.parent
    for name in ("rounded_box", "bottle"):
        shutil.copy(sources / f"example_{name}.npz", folder)
    (folder / "below").mkdir()
    monkeypatch.chdir(folder / "below")
    assert batch("..", "--out", "../below/../out", "--shard-size", 3, *QUICK) == 0
    assert "4 of 4 shards" in capsys.readouterr().err
    copy.rename(folder / "older")
    monkeypatch.chdir(folder)
    assert batch(".", "--out", "older2", "--shard", "4/4", "--shard-size", 3, *QUICK) == 0
    assert "4 files" in " ".join(capsys.readouterr().err.split())


@pytest.mark.usefixtures("here")
def test_simulation_and_where_the_time_goes_are_part_of_the_results(
    tmp_path: Path, sources: Path, capsys: pytest.CaptureFixture[str]
):
    out, summary = tmp_path / "out", tmp_path / "summary.json"
    options = ("--validate", "--protocol", "strict", "--profile", "--json", summary, *QUICK)
    assert batch(sources / "example_rounded_box.npz", "--out", out, *options) == 0
    document = json.loads(summary.read_text())
    after = [grasp["simulation"]["after"] for grasp in document["grasps"]]
    assert [one["protocol"] for one in after] == ["strict"] * 4
    assert document["totals"]["success_after"] == sum(one["success"] for one in after)
    assert [row["held_after"] for row in index(out)] == [str(one["success"]).lower() for one in after]
    profile = document["profile"]
    assert profile["narrow phase"]["cpu_s"] > 0
    assert profile["simulating"]["cpu_s"] > 0
    assert profile["solver"]["calls"] > 0
    assert "narrow phase" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((), ("sample:N",)),
        (("none.npz",), ("none", "none.npz")),
        (("sample:4",), ("sample_4", "--grasps", "sample:4", "hand", "object")),
        (("x.npz", "--shard", "0/3"), ("--shard 0/3", "I/N", "1/N", "N/N")),
        (("x.npz", "--shard", "4/3"), ("--shard 4/3", "I/N")),
        (("x.npz", "--shard-size", "0"), ("--shard-size", "1", "0")),
        (("x.npz", "--patience", "1"), ("--patience", "5 s", "1")),
        (("x.npz", "--dask", "tcp://x:1", "--workers", "2"), ("--dask",)),
        (("x.npz", "--validate", "--friction", "0"), ("--friction", "0")),
    ],
)
def test_bad_input_is_refused(
    workplace: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], named: tuple[str, ...]
):
    assert_names(refused(capfd, "batch", *arguments), *named)


@pytest.mark.parametrize(
    ("arguments", "taken"),
    [
        (("grasps.npz", "--out", "out", "--json", "grasps.npz"), "grasps.npz"),
        (("lists/index.csv", "--out", "lists", "--index-format", "csv"), "lists/index.csv"),
    ],
    ids=["grasps", "list"],
)
def test_results_take_the_place_of_no_input(
    workplace: Path, sources: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], taken: str
):
    shutil.copy(sources / "example_bottle.npz", "grasps.npz")
    Path("lists").mkdir()
    Path("lists/index.csv").write_text("grasps\n../grasps.npz\n")
    content = Path(taken).read_bytes()
    assert_names(refused(capfd, "batch", *arguments), taken, "--out", "--json")
    assert Path(taken).read_bytes() == content


def running(sources: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    """The command in a process and a group of its own."""
    command = [sys.executable, "-c", PROGRAM, "batch", str(sources), "--out", str(out), "--shard-size", "1", *options]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=subprocess_environment(),
        start_new_session=True,
        preexec_fn=interruptible,
    )


def finished(process: subprocess.Popen[str]) -> int:
    """The exit code."""
    process.communicate(timeout=PATIENCE_S)
    return process.returncode


def wait_for(out: Path, files: int) -> None:
    """Until so many result files are there."""
    assert soon(lambda: len(list(out.rglob("*.npz"))) >= files)


@pytest.mark.slow
def test_interrupted_it_says_how_to_go_on_and_leaves_nothing_running(tmp_path: Path, sources: Path):
    process = running(sources, tmp_path / "out", "--workers", "1", "--geometry-only", "--no-report")
    wait_for(tmp_path / "out", 1)
    os.killpg(process.pid, signal.SIGINT)
    out, error = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert " of 8 shards" in " ".join(error.split())
    assert error.rstrip().splitlines()[-1].startswith("refine-grasp: ")
    assert "Traceback" not in error
    assert nothing_left(process)
    assert not list((tmp_path / "out").rglob(".*"))


@pytest.mark.usefixtures("here")
def test_a_disk_that_stays_full_stops_the_batch_and_says_how_much_room_is_needed(
    copy: Path, whole: Path, sources: Path, capsys: pytest.CaptureFixture[str]
):
    command = ("--out", copy, "--shard-size", 1, *QUICK)
    paths = [copy / f"example_{name}" / f"allegro_{name}_0000{part}.npz" for name in FIRST for part in range(4)]
    for path in paths:
        path.unlink(missing_ok=True)
        path.symlink_to("/dev/full")
    assert batch(sources, *command) == 1
    error = " ".join(capsys.readouterr().err.split())
    assert_names(error.rpartition("note:")[2] or error, "0 of 8 shards", "8 grasps", "MiB")
    assert sum(path.is_symlink() for path in paths) == 8 - MAX_UNWRITTEN, "the others were not tried"
    assert not list(copy.rglob(".*"))
    for path in paths:
        path.unlink(missing_ok=True)
    assert batch(sources, *command) == 0
    assert len(index(copy)) == 8


@pytest.mark.usefixtures("here")
def test_what_a_run_that_was_killed_left_of_its_tables_is_taken_away(copy: Path, sources: Path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    for name in ("index.csv", "report.html", "batch.json"):
        partial = half_written_path(copy / name)
        partial.with_name(partial.name.replace(str(os.getpid()), str(ended.pid), 1)).touch()
    assert batch(sources, "--out", copy, "--shard-size", 3, "--json", copy / "batch.json", *WITH_REPORT) == 0
    assert not list(copy.rglob(".*"))


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on_and_comes_out_the_same(tmp_path: Path, sources: Path):
    options = ("--workers", "2", "--geometry-only", "--no-report", "--index-format", "csv")
    expected, out = tmp_path / "expected", tmp_path / "out"
    assert finished(running(sources, expected, *options)) == 0
    seed = time.time_ns()
    print("seed", seed)
    random = np.random.default_rng(seed)
    for done in range(5):
        process = running(sources, out, *options)
        wait_for(out, done + 1)
        time.sleep(random.uniform(0, 0.5))
        process.kill()
        process.communicate()
        assert nothing_left(process), "workers go on without their parent"
    assert finished(running(sources, out, *options)) == 0
    assert_same(out, expected)
    assert {path.name for path in out.rglob(".*")} == set()
    assert [row["row"] for row in index(out)] == [row["row"] for row in index(expected)]
