"""`refine-grasp run --trajectory`: trajectories are followed where the protocol lifts; the file records it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from grasp_refine_apps.cli import main

pytestmark = pytest.mark.usefixtures("workplace")


GIVEN = (
    "--hand franka_hand --object box:0.04,0.04,0.08 --grasps sample:1 --validate --trajectory trajectory.json".split()
)


@pytest.mark.parametrize(("protocol", "lifts"), [("scene", True), ("dexgraspbench", False)])
def test_trajectories_are_followed_by_protocols_that_lift(
    protocol: str, lifts: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    """A gripper lifts its box by 10 cm off the table; a protocol that pushes is named."""
    assert main(["run", *GIVEN, "--table", "-0.04", "--protocol", protocol, "--json", "run.json"]) == 0
    (grasp,) = json.loads(Path("trajectory.json").read_text())["grasps"]
    (refined,) = json.loads(Path("run.json").read_text())["grasps"]
    assert {key: grasp.get(key) for key in refined["trajectory"]} == refined["trajectory"]
    assert ("followed" in refined["trajectory"]) == lifts
    out, _ = capfd.readouterr()
    assert grasp["status"] == "free" and ("followed" in grasp) == lifts
    assert ("1 of 1 held and lifted" in out) == lifts and ("dexgraspbench pushes" in out) != lifts
    assert "give --table" not in out
    if lifts:
        found = grasp["followed"]
        assert found["held"] and abs(found["lifted_m"] - 0.1) < 5e-3 and found["hits"] == []


@pytest.mark.parametrize(
    ("given", "named"),
    [(["--from", "0,1"], "--trajectory"), (["--trajectory", "trajectory.json", "--from", "left"], "left")],
)
def test_starts_that_make_no_sense_are_refused(given: list[str], named: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Without a way to plan, and what is no list of joint values."""
    assert main(["run", "--hand", "franka_hand", "--object", "mug", *given]) == 2
    assert named in capfd.readouterr().err
