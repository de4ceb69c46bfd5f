"""`refine-grasp bench queries` as a user meets it: tables, documents, and refusals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine.collision.engine import engines
from grasp_refine_apps.bench.queries.cases import Case
from grasp_refine_apps.bench.queries.presets import DEFAULT, PRESETS
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.bench_queries import BenchQueries
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


def test_smoke_measures_queries_and_reports_in_one_file(capfd: pytest.CaptureFixture[str]):
    for module in ("matplotlib", "jinja2"):
        pytest.importorskip(module, reason="the report needs it")
    asked = ["bench", "queries", "--preset", "smoke"]
    assert main([*asked, "--json", "queries.json", "--html", "queries.html"]) == 0
    out, _ = capfd.readouterr()
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80
    assert "queries.json" in out and "queries.html" in out
    found = json.loads(Path("queries.json").read_text())
    assert (found["schema"], found["command"], found["preset"]) == (1, "bench queries", "smoke")
    assert found["invocation"] == "refine-grasp bench queries --preset smoke" and found["problems"] == []
    rows, skips = ([row for row in found["rows"] if row["table"] == name] for name in ("queries", "skips"))
    assert skips and all(0 < row["with"] < row["without"] for row in skips)
    assert len({(row["kind"], row["state"]) for row in rows}) == len(PRESETS["smoke"].cases)
    assert {row["by"] for row in rows} >= {*engines(), "coal-fresh", "coal-reused", "mujoco"}
    for row in rows:
        assert row["forward_us"] > 0
        assert row["queries_asked"] + row["pruned"] == row["piece_pairs"]
    text = Path("queries.html").read_text(encoding="utf-8")
    assert all(row["skip"] in text for row in skips) and not re.search(r"""(?:src|href)=["']https?:""", text)
    assert {path.name for path in Path().iterdir()} == {"queries.json", "queries.html"}


def test_every_combination_is_measured_with_charts_and_without_skips(capfd: pytest.CaptureFixture[str]):
    for module in ("matplotlib", "jinja2"):
        pytest.importorskip(module, reason="the report needs it")
    asked = "--kinds convex --vertices 8 16 --batches 4 8 --engines python --methods distance --peers mujoco --rounds 1"
    assert main(["bench", "queries", *asked.split(), "--json", "q.json", "--html", "q.html"]) == 0
    assert "back" in capfd.readouterr().out
    rows = json.loads(Path("q.json").read_text())["rows"]
    assert {row["table"] for row in rows} == {"queries"}
    assert [(row["vertices"], row["batch"]) for row in rows if row["peer"]] == [(8, 4), (8, 8), (16, 4), (16, 8)]
    assert all("backward_distance_us" in row and "backward_contact_kinematics_us" not in row for row in rows)
    text = Path("q.html").read_text(encoding="utf-8")
    assert text.count("<svg") == 2


def test_the_default_varies_one_thing_at_a_time_and_shows_all_skips():
    assert replace(BenchQueries().study(), measurement=DEFAULT.measurement) == DEFAULT and len(DEFAULT.cases) == len(
        set(DEFAULT.cases)
    )
    assert {case.batch for case in DEFAULT.cases} == {1, 16, 256, 1024}
    assert {case.vertices for case in DEFAULT.cases if case.kind == "convex"} == {8, 32, 128, 512}
    assert {case.pieces for case in DEFAULT.cases} == {1, 4, 16, 64}
    for kind in ("convex", "concave"):
        states = {case.state for case in DEFAULT.cases if case.kind == kind}
        assert states == {"far", "near", "touching", "shallow", "deep"}
    assert len(DEFAULT.examples) == 4


def test_options_say_what_is_measured_and_on_what_skips_are_shown():
    one = BenchQueries(kinds=("convex", "mixed"), pieces=(4, 9), batches=(2,))
    assert one.study().cases == (
        Case(batch=2), Case("mixed", 4, batch=2), Case("mixed", 9, batch=2),
    )  # fmt: skip
    assert one.study().examples == ()
    shown = BenchQueries(kinds=("convex",), skips=True, hands=("leap",)).study()
    assert shown.examples == (("leap", "mug"), ("leap", "rounded_box"))
    assert BenchQueries(preset="skips").study().cases == ()
    assert BenchQueries(skips=False).study().examples == ()
    assert (DEFAULT.count, BenchQueries(count=3).study().count, PRESETS["smoke"].count) == (16, 3, 4)
    assert BenchQueries(engines=("python", "python")).study().measurement.engines == ("python",)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --batches 3", ("--preset smoke", "--batches")),
        ("--preset table1", ("'table1'", "'--preset'")),
        ("--batches 0", ("--batches", "1", "0")),
        ("--batches", ("--batches",)),
        ("--pieces 1", ("--pieces", "2", "1")),
        ("--vertices 3", ("--vertices", "4", "3")),
        ("--rounds 0", ("--rounds", "1", "0")),
        ("--states upside-down", ("'upside-down'", "'--states'")),
        ("--engines gpu", ("'gpu'", "'--engines'")),
        ("--no-skips --hands leap", ("--hands", "--objects", "--count", "--skips")),
        ("--batches 4 --objects mug", ("--hands", "--objects", "--count", "--skips")),
        ("--preset skips --count 0", ("--count", "1", "0")),
        ("--preset skips --no-skips", ("--preset skips", "--no-skips")),
        ("--preset skips --objects teapot", ("'allegro'", "'teapot'")),
        ("--json same --html same", ("same",)),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "queries", *options.split()), *named)


def test_an_engine_that_is_not_there_is_refused(capfd: pytest.CaptureFixture[str]):
    if "native" in engines():
        pytest.skip("the compiled engine is there")
    assert_names(refused(capfd, "bench", "queries", "--engines", "native"), "native")
