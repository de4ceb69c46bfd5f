"""`refine-grasp bench align` as a user meets it: tables, documents that repeat themselves, and refusals."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import trimesh

from command_line import document, refused
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")

TINY = ("bench", "align", "--kinds", "convex", "--pairs", "1", "--targets", "3", "--budgets", "20", "40")


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """A folder of two concave meshes, a convex one, and one that is broken."""
    folder = tmp_path / "a folder whose path is longer than any line of a terminal that people read from" / "meshes"
    folder.mkdir(parents=True)
    for name, reach in (("near", 2.0), ("far", 3.0)):
        parts = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((reach, 0.5, 1))]
        parts[1].apply_translation([reach / 2, 0, 0])
        trimesh.boolean.union(parts).export(folder / f"{name}.obj")
    trimesh.creation.box((1, 2, 3)).export(folder / "box.stl")
    (folder / "broken.ply").write_text("no mesh")
    return folder


def timeless(entry: Any) -> Any:
    """A document without what time it took."""
    if isinstance(entry, dict):
        return {
            key: timeless(value)
            for key, value in entry.items()
            if not key.endswith(("_s", "_s_per_pair", "_us")) and key != "cpu_share"
        }
    return [timeless(value) for value in entry] if isinstance(entry, list) else entry


def pooled(found: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in found["rows"] if (row["pair"], row["target_class"]) == ("all", "all")]


# Runs


def test_a_run_prints_a_table_and_writes_its_rows(capfd: pytest.CaptureFixture[str]):
    found = document(*TINY)
    out, error = capfd.readouterr()
    assert error == ""
    assert "3 targets" in out and "seed 0" in out and "convex, 1 pair" in out and "bench.json" in out
    assert max(map(len, out.splitlines())) <= 80
    lines = [line.split() for line in out.splitlines() if line.startswith("distance")]
    assert [line[1] for line in lines] == ["20", "40"] and all(len(line) == 10 for line in lines)
    assert list(found) == [
        "schema", "command", "invocation", "versions", "machine", "engine", "preset", "config", "seed", "wall_s",
        "cpu_s", "problems", "rows",
    ]  # fmt: skip
    assert found["invocation"] == "refine-grasp bench align --kinds convex --pairs 1 --targets 3 --budgets 20 40"
    assert (found["schema"], found["command"], found["preset"], found["seed"]) == (1, "bench align", None, 0)
    assert found["machine"]["cpus"] == os.cpu_count() and found["machine"]["cpu"]
    assert found["config"]["budgets"] == [20, 40] and found["config"]["outputs"]["json"] is None
    assert [(row["budget"], row["iterations_mean"], row["targets"]) for row in pooled(found)] == [
        (20, 20.0, 3), (40, 40.0, 3)
    ]  # fmt: skip
    for row in pooled(found):
        assert sum(row["cpu_share"].values()) == pytest.approx(1.0, abs=0.2)
        assert 0 < row["d5"] <= row["d9"] and row["cpu_s_per_pair"] > 0
    assert {path.name for path in Path().iterdir()} == {"bench.json"}


def test_the_same_seed_gives_the_same_document_but_for_times():
    drawn = (*TINY[:-1], "--methods", "zeroth-order")
    runs = [timeless(document(*drawn)) for _ in range(2)]
    assert runs[0] == runs[1]
    other = document(*drawn, "--seed", "1")
    assert other["seed"] == 1
    assert timeless(other["rows"]) != runs[0]["rows"]


# Bad input


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --methods rigid", ("--preset smoke", "--methods")),
        ("--budgets 10 --seconds 1", ("--budgets", "--seconds")),
        ("--pairs 0", ("--pairs", "1", "0")),
        ("--margins -1", ("--margins", "-1")),
        ("--seconds 1 0", ("--seconds", "0")),
        ("--epsilon 1e-5", ("--epsilon", "--witnesses patch")),
        ("--witnesses patch --epsilon 0", ("--epsilon", "0")),
        ("--solvers levenberg-marquardt --methods rigid", ("--methods", "descent")),
        ("--solvers levenberg-marquardt --no-transport", ("--transport", "descent")),
        ("--solvers levenberg-marquardt --dtype float32", ("--dtype", "descent")),
        ("--solvers levenberg-marquardt --device cuda", ("--device", "descent")),
        ("--solvers levenberg-marquardt --seconds 1", ("--seconds", "descent", "levenberg-marquardt")),
        ("--preset smoke --seconds 1", ("--seconds", "descent", "levenberg-marquardt")),
        ("--device nonsense", ("--device nonsense", "--dtype float64")),
        ("--meshes nowhere", ("--meshes", "nowhere")),
        ("--json same --html same", ("same",)),
        ("--json .", (".:",)),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "align", *options.split()), *named)
