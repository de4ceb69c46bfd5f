"""`refine-grasp bench queries` as a user meets it: tables, documents, and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine.collision.engine import engines
from grasp_refine_apps.bench.queries.presets import PRESETS
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --batches 3", ("--preset smoke", "--batches")),
        ("--batches 0", ("--batches", "1", "0")),
        ("--pieces 1", ("--pieces", "2", "1")),
        ("--vertices 3", ("--vertices", "4", "3")),
        ("--no-skips --hands leap", ("--hands", "--objects", "--count", "--skips")),
        ("--batches 4 --objects mug", ("--hands", "--objects", "--count", "--skips")),
        ("--preset skips --no-skips", ("--preset skips", "--no-skips")),
        ("--preset skips --objects teapot", ("'allegro'", "'teapot'")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "queries", *options.split()), *named)
