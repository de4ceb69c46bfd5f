"""`refine-grasp validate --margins`: what a person reads, what programs read, and what is refused."""

import csv
import json
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.validation.margins.factors import FIELDS
from grasp_refine_apps.cli import main
from refusals import assert_names

EXAMPLE = resource_dir("robots") / "allegro" / "example_rounded_box.npz"


@pytest.mark.slow
def test_margins_are_shown_and_written(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ("--margins", "--draws", "4", "--seconds", "0.2", "--seed", "5", "--index", "1", "3")
    files = ("--json", "all.json", "--rows", "all.csv", "--html", "all.html")
    assert main(["validate", str(EXAMPLE), *arguments, *files]) == 0
    out = capfd.readouterr().out
    assert "2 grasps in 4 drawn worlds" in out and "s for the margins" in out
    document = json.loads(Path("all.json").read_text())
    trials = ["all", "push", *(name for name in FIELDS if name != "model")]
    assert list(document["totals"]["margins"]["files"][0]) == trials
    assert document["config"]["margins"]["draws"] == 4
    entries = [grasp["margins"] for grasp in document["grasps"]]
    assert [list(entry["trials"]) for entry in entries] == [trials, trials]
    assert len(entries[0]["trials"]["all"]["held"]) == 4 and len(entries[0]["trials"]["mass"]["held"]) == 1
    with Path("all.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["margins_all"]) for row in rows] == [entry["trials"]["all"]["probability"] for entry in entries]
    page = Path("all.html").read_text()
    assert page.startswith("<!doctype html>") and page.count("<figure>") == 2 + 3
    # One grasp alone has the same draws.
    assert main(["validate", str(EXAMPLE), *arguments[:-2], "3", "--json", "one.json"]) == 0
    (one,) = json.loads(Path("one.json").read_text())["grasps"]
    assert {**one["margins"], "cpu_s": 0} == {**entries[1], "cpu_s": 0}


def test_options_that_cannot_be_are_refused(workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    quick = ("validate", EXAMPLE, "--index", "0")
    for arguments, *named in (
        ((*quick, "--draws", "8"), "--draws", "--margins"),
        ((*quick, "--margins", "--draws", "0"), "--draws", "1", "0"),
        ((*quick, "--margins", "--draws", "5000"), "--draws", "4096", "5000"),
        ((*quick, "--margins", "--no-simulate"), "--no-simulate"),
        ((*quick, "--margins", "--protocol", "tabletop"), "margins", "tabletop"),
        ((*quick, "--margins", "--html", EXAMPLE), EXAMPLE, "input"),
    ):
        assert_names(refused(capfd, *arguments), *named)
