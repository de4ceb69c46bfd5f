"""Trials of hands: what works with a hand, up to the first thing that does not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.hand_trials import name_of, table_of, try_hand
from grasp_refine_apps.cli import main

FINGER = """<body name="{0}" pos="{1} 0 0.02"><joint name="{0}" axis="0 {2} 0" range="-0.6 0.6"/>
  <geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.08"/></body>"""
CLAW = f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom type="box" size="0.05 0.03 0.01"/>
  {FINGER.format("left", -0.045, 1)}{FINGER.format("right", 0.045, -1)}</body></worldbody></mujoco>"""


def test_several_hands_are_tried_and_one_that_cannot_be_read_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "claw.xml").write_text(CLAW)
    (tmp_path / "flat.xml").write_text(CLAW.replace("<geom", '<geom contype="0" conaffinity="0"'))
    hands = ["hands", "claw.xml", "flat.xml", "--check", "--tries", "2", "--objects", "sphere:0.03"]
    assert main([*hands, "--json", "rows.json", "--markdown", "table.md"]) == 0
    claw, flat = json.loads((tmp_path / "rows.json").read_text())["hands"]
    assert claw["file"] == "claw.xml (MJCF)" and claw["samples"] == [2, 2] and not claw["trouble"]
    assert claw["error_after"] <= claw["error_before"] and 0 <= claw["held_after"] <= 1
    assert "contype" in flat["trouble"] and flat["held_after"] is None
    table = (tmp_path / "table.md").read_text()
    assert "claw.xml (MJCF)" in table and "2 of 2" in table and "contype" in table
    assert main(["hands", "claw.xml", "flat.xml"]) == 2, "several hands are tried or nothing"


def test_a_hand_that_cannot_be_loaded_has_a_row() -> None:
    def load() -> None:
        raise GraspRefineError("no such hand")

    row = try_hand(load, "x", ("mug",), 1, "dexgraspbench", 0)  # type: ignore[arg-type]
    assert {key: value for key, value in row.items() if value is not None} == {"hand": "x", "trouble": "no such hand"}
    assert "no such hand" in table_of([row], 1, ("mug",), "dexgraspbench").markdown()


def test_names_distinguish_files_of_one_name() -> None:
    assert name_of("allegro") == "allegro" and name_of("a/leap_mjcf/right_hand.xml") == "leap_mjcf/right_hand"
