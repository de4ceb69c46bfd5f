"""`refine-grasp bench align` as a user meets it: tables, documents that repeat themselves, and refusals."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest
import trimesh

from command_line import call, document, refused
from grasp_refine_apps.bench.align import tasks
from grasp_refine_apps.bench.align.presets import PRESETS
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")

TINY = ("bench", "align", "--kinds", "convex", "--pairs", "1", "--targets", "3", "--budgets", "20", "40")
SMOKE = ("bench", "align", "--preset", "smoke", "--pairs", "1", "--targets", "2", "--budgets", "5", "--kinds", "convex")


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
    assert [line[1] for line in lines] == ["20", "40"] and all(len(line) == 11 for line in lines)
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
    runs = [timeless(document(*TINY, "--methods", "distance", "zeroth-order")) for _ in range(2)]
    assert runs[0] == runs[1]
    other = document(*TINY, "--methods", "distance", "zeroth-order", "--seed", "1")
    assert other["seed"] == 1
    assert timeless(other["rows"]) != runs[0]["rows"]


def test_smoke_runs_all_methods(capfd: pytest.CaptureFixture[str]):
    found = document(*SMOKE)
    assert found["preset"] == "smoke"
    variants = PRESETS["smoke"].variants
    assert [row["solver"] for row in pooled(found)] == [variant.solver for variant in variants]
    methods = [None if variant.solver == "closed-form" else variant.method for variant in variants]
    assert [row["method"] for row in pooled(found)] == methods
    assert all(row["d9"] is not None for row in pooled(found))
    assert "  face-face " in capfd.readouterr().out
    (differences,) = (row for row in pooled(found) if row["method"] == "finite-difference")
    assert differences["queries_mean"] == 13 * differences["iterations_mean"] == 65


def test_solvers_and_witnesses_are_compared(capfd: pytest.CaptureFixture[str]):
    solvers = ("descent", "levenberg-marquardt", "closed-form-first")
    options = f"--solvers {' '.join(solvers)} closed-form --witnesses plain patch --epsilon 2e-5 --margins 0 1e-3"
    found = document(*TINY[:-2], "30", *options.split(), "--classes", "vertex-vertex", "face-face")
    rows = pooled(found)
    assert [(row["solver"], row["witness"], row["margin"]) for row in rows] == [
        (solver, witness, margin) for solver in solvers for witness in ("plain", "patch") for margin in (0.0, 1e-3)
    ] + [("closed-form", "plain", margin) for margin in (0.0, 1e-3)]
    for row in rows:
        assert row["epsilon"] == row["patch"]["epsilon"] == 2e-5 and row["patch"]["targets"] == row["targets"]
        assert row["iterations_mean"] == 30.0 if row["solver"] == "descent" else row["iterations_mean"] <= 30.0
        assert sum(row["cpu_share"].values()) == pytest.approx(1.0, abs=0.2)
    assert "epsilon 20 µm" in " ".join(capfd.readouterr().out.split())


def test_levenberg_marquardt_repeats_itself(capfd: pytest.CaptureFixture[str]):
    runs = [timeless(document(*TINY, "--solvers", "levenberg-marquardt")) for _ in range(2)]
    assert runs[0] == runs[1]
    first, second = pooled(runs[0])
    assert (first["budget"], second["budget"]) == (20, 40)
    assert second["d9"] <= first["d9"] and first["patch"] is None
    assert max(map(len, capfd.readouterr().out.splitlines())) <= 80


def test_every_combination_is_run_once():
    options = "--methods distance rigid --neighborhoods adaptive fixed --margins 0 1e-3 --no-transport --optimise T1T2"
    found = pooled(document(*TINY[:-2], "2", *options.split(), "--classes", "vertex-vertex"))
    assert [(row["method"], row["neighborhood"], row["margin"]) for row in found] == [
        ("distance", "adaptive", 0.0), ("distance", "adaptive", 1e-3), ("distance", "fixed", 0.0),
        ("distance", "fixed", 1e-3), ("rigid", None, 0.0), ("rigid", None, 1e-3),
    ]  # fmt: skip
    assert {(row["transport"], row["optimise"], row["budget"]) for row in found} == {(False, "T1T2", 2)}


def test_what_is_asked_for_twice_is_run_once():
    options = "--budgets 2 2 --margins 0 0 --methods rigid rigid --classes vertex-vertex vertex-vertex"
    (row,) = pooled(document(*TINY[:-3], *options.split()))
    assert (row["pairs"], row["targets"]) == (1, 3)


def test_a_budget_in_seconds_is_reported_as_such():
    (row,) = pooled(document(*TINY[:-3], "--seconds", "0.1"))
    assert (row["budget"], row["budget_s"]) == (None, 0.1)
    assert row["iterations_mean"] > 1 and row["cpu_s_per_pair"] >= 0.1 * 0.5


def test_meshes_of_a_folder_are_used_and_bad_ones_reported(meshes: Path, capfd: pytest.CaptureFixture[str]):
    found = document("bench", "align", "--meshes", meshes, "--pairs", "4", "--targets", "3", "--budgets", "3")
    assert [(row["kind"], row["pairs"]) for row in pooled(found)] == [("convex", 4), ("concave", 4)]
    names = {
        name for row in found["rows"] if row["pair"] != "all" for name in re.findall(r"(\w+) [\d.]+ mm", row["pair"])
    }
    assert names <= {"near", "far", "box"}
    concave = {row["pair"] for row in found["rows"] if row["kind"] == "concave"} - {"all"}
    assert {re.sub(r" [\d.]+ mm", "", pair) for pair in concave} <= {"near / far", "far / near"}
    said = capfd.readouterr().err
    assert re.search(r"\bnear\b", said) and not re.search(r"\bbox\b", said), "what is cut into pieces"
    # However long it is, a path is not broken: people copy it.
    assert said.count(str(meshes / "broken.ply")) == 2, "once for each kind"


def test_a_report_is_one_file_that_names_what_was_compared(capfd: pytest.CaptureFixture[str]):
    for module in ("matplotlib", "jinja2", "PIL"):
        pytest.importorskip(module, reason="the report needs it")
    arguments = [*TINY, "--methods", "distance", "contact-kinematics", "--html", "reports/bench.html"]
    Path("reports").mkdir()
    assert main(arguments) == 0
    assert "reports/bench.html" in capfd.readouterr().out
    assert [str(path) for path in Path().rglob("*") if path.is_file()] == ["reports/bench.html"]
    text = Path("reports/bench.html").read_text(encoding="utf-8")
    assert "distance" in text and "contact-kinematics" in text and "<svg" in text
    assert not re.search(r"""(?:src|href)=["']https?:""", text)


# Bad input


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --methods rigid", ("--preset smoke", "--methods")),
        ("--preset margin --margins 0", ("--preset margin", "--margins")),
        ("--preset table1 --step-sizes 1", ("--preset table1", "--step-sizes")),
        ("--preset table2 --no-transport", ("--preset table2", "--transport")),
        ("--preset table9", ("'table9'", "'--preset'")),
        ("--budgets 10 --seconds 1", ("--budgets", "--seconds")),
        ("--pairs 0", ("--pairs", "1", "0")),
        ("--targets 0", ("--targets", "1", "0")),
        ("--budgets 0", ("--budgets", "1", "0")),
        ("--margins -1", ("--margins", "-1")),
        ("--margins nan", ("--margins", "nan")),
        ("--seconds -1", ("--seconds", "-1")),
        ("--seconds 1 0", ("--seconds", "0")),
        ("--epsilon 1e-5", ("--epsilon", "--witnesses patch")),
        ("--witnesses patch --epsilon 0", ("--epsilon", "0")),
        ("--preset solvers --solvers descent", ("--preset solvers", "--solvers")),
        ("--preset patch --witnesses patch", ("--preset patch", "--witnesses")),
        ("--solvers levenberg-marquardt --methods rigid", ("--methods", "descent")),
        ("--solvers levenberg-marquardt --no-transport", ("--transport", "descent")),
        ("--solvers levenberg-marquardt --dtype float32", ("--dtype", "descent")),
        ("--solvers levenberg-marquardt --device cuda", ("--device", "descent")),
        ("--solvers levenberg-marquardt --seconds 1", ("--seconds", "descent", "levenberg-marquardt")),
        ("--preset smoke --seconds 1", ("--seconds", "descent", "levenberg-marquardt")),
        ("--solvers newton", ("'newton'", "'--solvers'")),
        ("--seed -1", ("--seed", "0 to 4294967295", "-1")),
        ("--workers 0", ("--workers", "1", "0")),
        ("--methods dist", ("'dist'", "'--methods'")),
        ("--kinds round", ("'round'", "'--kinds'")),
        ("--target 3", ("--target,",)),
        ("--device nonsense", ("--device nonsense", "--dtype float64")),
        ("--meshes nowhere", ("--meshes", "nowhere")),
        ("--meshes .", ("--meshes", ".obj")),
        ("--json same --html same", ("same",)),
        ("--json .", (".:",)),
        ("--html .", (".:",)),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "align", *options.split()), *named)


@pytest.mark.parametrize("option", ["--kinds", "--classes", "--methods", "--margins", "--budgets", "--seconds"])
def test_a_list_needs_a_value(option: str, capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "align", option), option)


@pytest.mark.parametrize("option", ["--json", "--html"])
def test_what_cannot_be_written_is_found_out_first(option: str, capfd: pytest.CaptureFixture[str]):
    Path("file").write_text("a file")
    assert_names(refused(capfd, *TINY, option, "file/bench"), "file/bench", "file ")
    if os.geteuid() == 0:
        return
    Path("locked").mkdir(mode=0o500)
    assert_names(refused(capfd, *TINY, option, "locked/bench"), "locked/bench", "permission")


def test_too_few_meshes_are_refused(meshes: Path, capfd: pytest.CaptureFixture[str]):
    for name in ("near.obj", "far.obj", "broken.ply"):
        (meshes / name).unlink()
    answer = refused(capfd, *TINY, "--meshes", meshes, "--json", "bench.json")
    assert_names(answer, "convex", "1 of 1")


def test_without_a_task_that_counts_nothing_is_run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):
    monkeypatch.setattr(tasks, "ACCEPTED_MISS_M", 0.0)
    assert main([*TINY, "--workers", "2", "--json", "bench.json"]) == 2
    out, error = capfd.readouterr()
    _, answer = error.splitlines()
    assert out == "" and answer.startswith("refine-grasp: error: ")
    assert not Path("bench.json").exists()


def test_the_words_of_the_command_belong_together(capsys: pytest.CaptureFixture[str]):
    result = call("bench", "algin")
    assert (result.returncode, result.stdout) == (2, "")
    assert_names(result.stderr, "'bench algin'", "bench align?")
    for arguments in (["bench"], ["bench", "--help"]):
        assert main(arguments) == 0
        shown = capsys.readouterr().out
        assert "  bench align  " in shown and "  doctor  " not in shown
