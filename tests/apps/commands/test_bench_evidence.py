"""`refine-grasp bench evidence`: the whole way on two objects, what a second call does, and bad input."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import PROGRAM, interruptible, refused, subprocess_environment
from evidence_assets import write_assets
from grasp_refine_apps.cli import main
from refusals import assert_names
from running_processes import PATIENCE_S

PROTOCOLS = ("dexgraspbench", "strict")
OPTIONS = ("--hands", "allegro", "--grasps", 2, "--generated", 2, "--protocols", *PROTOCOLS, "--workers", 1)
NUMBER = 6
"""Two sampled grasps on each of two objects, and two of the generator."""


def evidence(assets: Path, out: Path, *more: object) -> int:
    return main([*map(str, ("bench", "evidence", "--assets", assets, "--out", out, *OPTIONS, *more))])


def document(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "evidence.json").read_text())
    return found


def files(out: Path) -> dict[str, int]:
    """Result files, with the time of their last change."""
    return {path.relative_to(out).as_posix(): path.stat().st_mtime_ns for path in out.rglob("*_0*.npz")}


def entries(folder: Path, name: str) -> np.ndarray:
    """Values of an entry in all result files of a folder."""
    return np.concatenate([np.load(path)[name] for path in sorted(folder.rglob("*.npz"))])


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_assets(tmp_path_factory.mktemp("evidence") / "assets")


@pytest.fixture(scope="module")
def whole(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    assert evidence(assets, out) == 0
    return out


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """The same results, to be changed."""
    return Path(shutil.copytree(whole, tmp_path / "out"))


@pytest.mark.slow
def test_the_numbers_of_the_tables_are_as_in_the_files(whole: Path):
    tables = document(whole)["tables"]
    (row,) = tables["All grasps"]
    assert row["grasps"] == NUMBER
    for at, method in enumerate(("as_given", "geometry_only", "refined")):
        for protocol in PROTOCOLS:
            reasons = entries(whole / "trials/mujoco" / protocol, f"{method}_reason")
            assert row[f"held_{protocol}"][at] == (reasons == "held").mean()
            assert (reasons == "held").sum() + sum(row[f"reasons_{protocol}"][at].values()) == NUMBER
            counts = {line["label"]: line[protocol][at] for line in tables["Why grasps do not hold"]}
            assert counts["held"] == (reasons == "held").sum()
            assert sum(counts.values()) == NUMBER
    for at, folder in ((1, "geometry-only"), (2, "refined")):
        assert row["penetration_m"][at] == pytest.approx(entries(whole / folder, "penetration_m_after").mean())
        assert row["cpu_s"][at] == pytest.approx(entries(whole / folder, "cpu_s").mean())
        assert row["moved_palm_m"][at] == pytest.approx(np.median(entries(whole / folder, "moved_palm_m")))
    assert row["penetration_m"][0] == pytest.approx(entries(whole / "refined", "penetration_m_before").mean())
    assert row["cpu_s"][0] is row["moved_palm_m"][0] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "numbers"),
    [
        ("By hand", {"allegro": 6}),
        ("By generator", {"sampled": 4, "made": 2}),
        ("By shape of the object", {"convex": 6}),
        ("By object", {"ball": 2, "my_rounded_box": 4}),
    ],
)
def test_groups_hold_their_grasps_and_together_all(table: str, numbers: dict[str, int], whole: Path):
    tables = document(whole)["tables"]
    assert {row["label"]: row["grasps"] for row in tables[table]} == numbers
    held = sum(row["grasps"] * row["held_strict"][2] for row in tables[table])
    assert held == pytest.approx(NUMBER * tables["All grasps"][0]["held_strict"][2])


@pytest.mark.slow
def test_markdown_and_page_show_the_tables(whole: Path):
    text, page = (whole / "evidence.md").read_text(), (whole / "evidence.html").read_text()
    (row,) = document(whole)["tables"]["All grasps"]
    shown = " → ".join(f"{100 * share:.1f}" for share in row["held_strict"]) + " %"
    assert f"| all | {NUMBER} | " in text
    assert shown in text
    assert shown in page
    assert "bench evidence" in text
    for protocol in PROTOCOLS:
        for reason, count in row[f"reasons_{protocol}"][2].items():
            assert f"{reason}, {protocol} ({count} grasps)" in page
    lost = sum(sum(row[f"reasons_{protocol}"][2].values()) for protocol in PROTOCOLS)
    assert ("data:image/png" in page) == bool(lost)


@pytest.mark.slow
def test_a_second_call_does_only_what_is_missing(copy: Path, assets: Path, capfd: pytest.CaptureFixture[str]):
    before, tables = files(copy), document(copy)["tables"]
    assert len(before) == 3 * (1 + 2) + 3 * 2 - 1, "a file of a generator is not sampled"
    assert evidence(assets, copy) == 0
    assert files(copy) == before
    assert document(copy)["tables"] == tables
    removed = next(name for name in before if name.startswith("trials/mujoco/strict"))
    (copy / removed).unlink()
    assert evidence(assets, copy) == 0
    after = files(copy)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {removed}


@pytest.mark.slow
def test_a_job_that_fails_is_a_row_and_the_others_go_on(copy: Path, assets: Path, tmp_path: Path):
    broken = Path(shutil.copytree(assets, tmp_path / "assets"))
    (broken / "objects/ball.obj").write_text("v 0 0 0\n")
    assert evidence(broken, copy) == 1
    tables = document(copy)["tables"]
    (row,) = tables["Jobs that failed"]
    assert row["job"] == "sampled/allegro/ball"
    assert row["missing"] == 2
    assert_names(row["reason"], "sampling", "ball.obj")
    assert tables["All grasps"][0]["grasps"] == NUMBER - row["missing"]
    assert "| sampled/allegro/ball | 2 | sampling: " in (copy / "evidence.md").read_text()


@pytest.mark.slow
def test_an_interruption_leaves_what_the_next_call_continues(copy: Path, assets: Path):
    kept = files(copy)
    for name in kept:
        if name.startswith("trials"):
            (copy / name).unlink()
    command = [PROGRAM, "bench", "evidence", "--assets", assets, "--out", copy, *OPTIONS]
    process = subprocess.Popen(
        [sys.executable, "-c", *map(str, command)],
        stderr=subprocess.PIPE,
        env=subprocess_environment() | {"PYTHONUNBUFFERED": "1"},
        preexec_fn=interruptible,
    )
    until = time.monotonic() + PATIENCE_S
    while not any(name.startswith("trials") for name in files(copy)) and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert not list(copy.rglob(".*.npz*")), "partial files"
    assert evidence(assets, copy) == 0
    assert files(copy).keys() == kept.keys()


@pytest.mark.slow
def test_both_engines_try_the_same_grasps(assets: Path, tmp_path: Path):
    pytest.importorskip("pydrake")
    chosen = ("--objects", "ball", "--generators", "sampled", "--grasps", 1, "--protocols", "dexgraspbench")
    assert evidence(assets, tmp_path, *chosen, "--engines", "mujoco", "drake") == 0
    tables = document(tmp_path)["tables"]
    (row,) = tables["All grasps"]
    (agreed,) = tables["Agreement of MuJoCo and Drake"]
    assert agreed["grasps"] == 1
    for at, method in enumerate(("as_given", "geometry_only", "refined")):
        held = [
            entries(tmp_path / f"trials/{engine}/dexgraspbench", f"{method}_reason") == "held"
            for engine in ("mujoco", "drake")
        ]
        assert [row["held_dexgraspbench"][at], row["held_dexgraspbench in Drake"][at]] == [each.mean() for each in held]
        assert agreed["share"][at] == (held[0] == held[1]).mean()


def test_bad_input_is_refused(assets: Path, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: Any):
    monkeypatch.chdir(tmp_path)
    command = ("bench", "evidence", "--assets", assets)
    assert_names(refused(capfd, "bench", "evidence"), "assets", "hands")
    assert_names(refused(capfd, "bench", "evidence", "--assets", "nowhere"), "nowhere", "hands")
    assert_names(refused(capfd, *command, "--hands", "claw"), "--hands", "claw", "allegro", "embedded/leap")
    assert_names(refused(capfd, *command, "--objects", "spoon"), "--objects", "spoon", "ball")
    assert_names(refused(capfd, *command, "--protocols", "soft"), "soft", "strict")
    assert_names(refused(capfd, *command, "--protocols"), "--protocols")
    assert_names(refused(capfd, *command, "--engines", "bullet"), "--engines", "bullet", "mujoco", "drake")
    assert_names(refused(capfd, *command, "--engines"), "--engines", "mujoco", "drake")
    for name in ("one", "two"):
        Path(f"{name}.toml").write_text('name = "mine"')
    assert_names(refused(capfd, *command, "--protocols", "one.toml", "two.toml"), "--protocols", "mine")
    for option in ("--grasps", "--generated", "--every", "--workers"):
        assert_names(refused(capfd, *command, option, "0"), option, "0")
