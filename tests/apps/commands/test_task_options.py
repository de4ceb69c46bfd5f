"""Options of a task: a file says all of it, other options change it, results record it, and it is proven from there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import grasp_refine as gr
from command_line import refused
from grasp_refine.assets.embedded import resource_dir
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")

EXAMPLE = resource_dir("robots") / "allegro" / "example_rounded_box.npz"
TEXT = """
table = -0.2
avoid = ["above:z=0.04"]
[protocol]
based_on = "strict"
directions = ["+x"]
checks = 1
"""


@pytest.fixture
def file() -> str:
    Path("task.toml").write_text(TEXT)
    return "task.toml"


def document(*arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json", "out.json", "--overwrite"]) == 0
    return json.loads(Path("out.json").read_text())


def test_results_record_the_task_and_prove_it(file: str) -> None:
    quick = ("run", "--grasps", str(EXAMPLE), "--index", "1", "--geometry-only", "--iterations", "5", "--out", "found")
    said = document(*quick, "--task", file, "--mass", "0.3", "--validate")
    task = gr.load_task(file)
    assert task.named_protocol is not None
    task = gr.Task(task.named_protocol.with_mass(0.3), table=-0.2)
    (result,) = Path("found").glob("*.npz")
    for source in (result, "out.json"):
        found = gr.load_task(source)
        assert found.named_protocol == task.named_protocol and found.table == task.table
        assert found.avoid == ("above:z=0.04",) and not found.touch
    assert [one["direction"] for one in said["grasps"][0]["simulation"]["after"]["directions"]] == ["+x"]
    assert said["config"]["protocol"]["mass"] == 0.3
    again = document("validate", str(result), "--task", str(result))
    assert [one["direction"] for one in again["grasps"][0]["simulation"]["after"]["directions"]] == ["+x"]
    assert again["config"]["protocol"] == said["config"]["protocol"]
    other = document("validate", str(result), "--task", str(result), "--protocol", "strict", "--seconds", "0.2")
    assert other["config"]["protocol"]["mass"] == 0.1


@pytest.mark.parametrize("command", ["run", "validate", "batch", "view"])
def test_a_task_that_is_none_is_refused(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    Path("wrong.toml").write_text("tabel = 0.0")
    for name, named in (("stict", ("stict", "strict")), ("wrong.toml", ("wrong.toml", "tabel", "table"))):
        given = [] if command in ("run", "view") else [str(EXAMPLE)]
        assert_names(refused(capfd, command, *given, "--task", name), *named)
