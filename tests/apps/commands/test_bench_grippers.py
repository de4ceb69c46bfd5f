"""`refine-grasp bench grippers` as a user meets it: what holds before and after, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import refused
from grasp_refine.hands.hand import load_hand
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine_apps.bench.evidence.cases import ObjectCase
from grasp_refine_apps.bench.grippers.study import GrippersStudy, perturbed, sampled
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")


def test_grasps_of_a_gripper_are_sampled_perturbed_refined_and_simulated(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "grippers", "--preset", "smoke", "--json", "found.json", "--html", "found.html"]) == 0
    out, _ = capfd.readouterr()
    assert "perturbed" in out and max(map(len, map(str.rstrip, out.splitlines()))) <= 100
    rows = json.loads(Path("found.json").read_text())["rows"]
    assert [(row["kind"], row["object"]) for row in rows] == [
        (kind, name) for name in ("all", "box:0.04,0.04,0.06") for kind in ("sampled", "perturbed")
    ]
    # A box between flat pads holds, at least where they touch in several points.
    assert all(row["grasps"] == 1 and row["held"][0] == [1, 1, 0] for row in rows)
    assert Path("found.html").read_text(encoding="utf-8").count("franka_hand sampled") == 1


def test_a_perturbation_moves_the_middle_of_the_pads_by_5_mm_and_turns_by_10_degrees() -> None:
    hand = load_hand("franka_hand", candidates=512)
    scene, factor = sampled(hand, ObjectCase("bar", "box:0.02,0.02,0.1", 1.0), 4, 0)
    moved = perturbed(scene, 0)
    center = np.append(closure_frame(hand).center, 1.0)
    shift = (moved.T_world_root - scene.T_world_root) @ center
    np.testing.assert_allclose(np.linalg.norm(shift[:, :3], axis=1), 0.005, rtol=1e-9)
    R = moved.T_world_root[:, :3, :3] @ scene.T_world_root[:, :3, :3].mT
    np.testing.assert_allclose(np.degrees(np.arccos((np.trace(R, axis1=1, axis2=2) - 1) / 2)), 10.0, rtol=1e-9)
    assert factor == 1.0 and (moved.q == scene.q).all()


def test_rows_are_pooled_and_lost_grasps_are_listed_by_object() -> None:
    held = [[2, 1, 1], [2, 2, 0], [0, 0, 0], [1, 2, 0]]
    row = {"hand": "g", "kind": "sampled", "label": "g sampled", "scale": 1.0, "grasps": 2}
    study = GrippersStudy(("g",), ("a", "b"))
    rows = study.rows([[{**row, "object": "a", "held": held}], [{**row, "object": "b", "held": [[2, 2, 0]] * 4}]])
    assert rows[0]["grasps"] == 4 and rows[0]["held"] == [[4, 3, 1], [4, 4, 0], [2, 2, 0], [3, 4, 0]]
    tables = study.report(rows, ()).parts
    assert [[cell.text for cell in line][:3] for table in tables for line in table.cells()] == [
        ["g sampled", "4", "100.0 → 75.0 (1)"],
        ["g sampled a", "2", "100.0 → 50.0 (1)"],
    ]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--hands", "no_gripper"], ["no_gripper"]),
        (["--assets", "nowhere"], ["nowhere"]),
        (["--preset", "smoke", "--count", "2"], ["--count", "smoke"]),
        (["--count", "0"], ["--count", "0"]),
    ],
)
def test_what_cannot_be_measured_is_refused(
    options: list[str], named: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    assert_names(refused(capfd, "bench", "grippers", *options), *named)
