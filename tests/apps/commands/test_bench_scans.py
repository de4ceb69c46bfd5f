"""`refine-grasp bench scans` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine_apps.bench.scans.ways import WAYS
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


@pytest.mark.slow
def test_smoke_refines_on_scans_and_tries_on_the_mesh(capfd: pytest.CaptureFixture[str]):
    assert main(["bench", "scans", "--preset", "smoke", "--json", "scans.json", "--html", "scans.html"]) == 0
    out, _ = capfd.readouterr()
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80
    found = json.loads(Path("scans.json").read_text())
    assert found["problems"] == []
    rows = {row["way"]: row for row in found["rows"] if row["by"] == "views"}
    assert tuple(rows) == WAYS
    for row in rows.values():
        assert row["grasps"] == 2 and 0.0 <= row["held"] <= 1.0
    assert rows["mesh"]["held"] > 0.0
    assert rows["hypotheses"]["completion_ms"] > 0.0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--views 0", ("--views", "1", "0")),
        ("--hypotheses 0", ("--hypotheses", "1", "0")),
        ("--offset -1", ("--offset", "not negative", "-1")),
        ("--assets none", ("none", "hands")),
        ("--protocol nothing", ("nothing", "dexgraspbench")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "scans", *options.split()), *named)
