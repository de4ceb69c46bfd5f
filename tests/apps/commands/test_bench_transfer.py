"""`refine-grasp bench transfer` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine_apps.bench.transfer.measure import WAYS
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


@pytest.mark.slow
def test_smoke_brings_the_examples_to_another_hand(capfd: pytest.CaptureFixture[str]):
    assert main(["bench", "transfer", "--preset", "smoke", "--json", "found.json", "--html", "found.html"]) == 0
    out, _ = capfd.readouterr()
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80
    found = json.loads(Path("found.json").read_text())
    assert found["problems"] == []
    rows = {row["way"]: row for row in found["rows"]}
    assert tuple(rows) == WAYS and all(row["grasps"] == 4 for row in rows.values())
    assert rows["joint copy"]["palm_m"] == 0.0 < rows["transfer"]["palm_m"]
    assert rows["transfer"]["held"] == 1.0 >= rows["kinematics"]["held"] >= rows["joint copy"]["held"]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--to nobody", ("nobody", "allegro")),
        ("--on nothing", ("nothing", "mug")),
        ("--assets none", ("none",)),
        ("--protocol nothing", ("nothing", "dexgraspbench")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "transfer", *options.split()), *named)
