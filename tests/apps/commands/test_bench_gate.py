"""`refine-grasp bench --gate` as a user meets it: a table, a document, an exit code, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine.collision.engine import VARIABLE
from grasp_refine_apps.bench.gate.baseline import BASELINE, RATIOS
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands import bench_gate as module

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """What is measured, without half a minute of measuring; the engine is the one that is always there."""
    monkeypatch.setenv(VARIABLE, "python")
    committed = json.loads(BASELINE.read_text())
    now = {name: one["value"] for name, one in committed["engines"]["python"]["ratios"].items()}
    groups = {ratio.name: ratio.group for ratio in RATIOS}
    monkeypatch.setattr(
        module, "measure", lambda group, progress: {name: value for name, value in now.items() if groups[name] == group}
    )
    return now


def test_a_slowdown_is_named_and_the_exit_code_says_so(measured: dict[str, float], capfd: pytest.CaptureFixture[str]):
    measured["grasp"] *= 2.0
    # The option may stand anywhere.
    assert main(["bench", "--json", "gate.json", "--gate"]) == 1
    out = capfd.readouterr().out
    assert "worse than allowed: grasp; wrote gate.json" in out and out.count("FAIL") == 1
    found = json.loads(Path("gate.json").read_text())
    (bad,) = [row for row in found["rows"] if row["ok"] is False]
    assert (bad["name"], bad["now"], bad["measured_twice"]) == ("grasp", measured["grasp"], True)
    assert found["ok"] is False


def test_a_new_baseline_is_what_the_next_run_is_compared_with(
    measured: dict[str, float], capfd: pytest.CaptureFixture[str]
):
    measured["grasp"] *= 2.0
    assert main(["bench", "--gate", "--update", "mine.json"]) == 0
    assert "wrote 18 ratios to mine.json" in capfd.readouterr().out
    assert main(["bench", "--gate", "--baseline", "mine.json"]) == 0
    measured["solved"] = 0.5
    assert main(["bench", "--gate", "--baseline", "mine.json"]) == 1
    assert "worse than allowed: solved\n" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--gate --baseline nobody.json", "nobody.json: not a baseline (FileNotFoundError: "),
        ("--gate --update a.json --baseline b.json", "--update compares with nothing: leave out --baseline"),
        ("--gate --update a.json --json a.json", "a.json: is to be written twice"),
        ("--gate --json .", ".: is a folder, a file is to be written there"),
        ("--gate --update .", ".: is a folder, a file is to be written there"),
        ("--gate --preset smoke", "unrecognized"),
        ("grasp --gate", "unrecognized"),
        ("--gaet", "no command 'bench', did you mean bench"),
    ],
)
def test_bad_options_are_refused(options: str, complaint: str, capfd: pytest.CaptureFixture[str]):
    assert complaint.lower() in refused(capfd, "bench", *options.split()).lower()
