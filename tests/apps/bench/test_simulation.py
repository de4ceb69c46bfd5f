"""The benchmark of validation: both ways come to the same verdicts, and it says what they cost."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine_apps.bench.simulation import main, plain
from gripper import around, ball, gripper


def test_a_plain_loop_and_the_batch_agree() -> None:
    world = build_world(gripper(), ball(), Task(DEXGRASPBENCH))
    verdicts = []
    for force in (0.5, 3.0):
        held = simulate(world, around(force)).success[0]
        assert plain(world, around(force)) == held
        verdicts.append(bool(held))
    assert verdicts == [False, True]


def test_it_prints_and_writes_what_grasps_cost(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = resource_dir("robots") / "allegro" / "example_rounded_box.npz"
    monkeypatch.setattr(sys, "argv", ["simulation", str(example), "--count", "1", "--json", "costs.json"])
    main()
    (row,) = json.loads(Path("costs.json").read_text())
    assert (row["grasps"], row["agree"]) == (1, 1)
    assert 0 < row["ours_s"] and 0 < row["peer_s"] and np.isfinite(row["compile_s"])
    out = capsys.readouterr().out
    assert f"{row['ours_s']:.3f} s" in out and f"{row['peer_s']:.3f} s" in out
