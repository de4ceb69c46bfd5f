"""`refine-grasp bench hold` as a user meets it: tables, documents that repeat themselves, and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import refused
from grasp_refine_apps.cli import main
from plate_gripper import URDF
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


def gripper_grasps() -> list[str]:
    """Options for two grasps of a ball that the plate gripper clamps, with pregrasps and squeezes that do nothing."""
    Path("gripper.urdf").write_text(URDF.replace('effort="1"', 'effort="50"'))
    pose = np.tile([0.0, 0.0, -0.05, 1.0, 0.0, 0.0, 0.0], (2, 1))
    q = np.array([[0.053, -0.053], [0.054, -0.052]])
    stages = {f"{name}_{key}": value for name in ("pregrasp", "squeeze") for key, value in (("pose", pose), ("q", q))}
    np.savez(
        "mine.npz", hand="gripper", base_link="palm", joint_names=["l", "r"], object="sphere:0.03", scale=np.ones(2),
        hand_pose=pose, q=q, **stages,
    )  # fmt: skip
    return ["--hand", "gripper.urdf", "--grasps", "mine.npz"]


def numbers(row: dict[str, Any]) -> dict[str, float]:
    """The numbers of a row but for times."""
    return {key: value for key, value in row.items() if isinstance(value, int | float) and "_ms" not in key}


def test_smoke_reports_what_holds_and_reports_in_one_file(capfd: pytest.CaptureFixture[str]):
    for module in ("matplotlib", "jinja2"):
        pytest.importorskip(module, reason="the report needs it")
    options = ["bench", "hold", "--preset", "smoke", "--protocols", "dexgraspbench", "--object", "rounded_box"]
    assert main([*options, "--json", "hold.json", "--html", "hold.html"]) == 0
    out, error = capfd.readouterr()
    assert "pregrasp" in error and "squeeze" in error
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80 and "hold.json, hold.html" in out
    found = json.loads(Path("hold.json").read_text())
    assert (found["schema"], found["command"], found["preset"]) == (1, "bench hold", "smoke")
    assert found["invocation"] == (
        "refine-grasp bench hold --object rounded_box --preset smoke --protocols dexgraspbench"
    )
    assert [(row["method"], row["starts"], row["object"]) for row in found["rows"]] == [
        ("as-came", None, "all"), ("geometry-only", 1, "all"), ("forces", 1, "all"), ("forces", 2, "all")
    ]  # fmt: skip
    for row in found["rows"]:
        assert row["grasps"] == 2 and 0 <= row["success_dexgraspbench"] <= 1 and "success_strict" not in row
        assert sum(row["reasons_dexgraspbench"].values()) == round(2 * (1 - row["success_dexgraspbench"]))
    assert all(row["cpu_ms_mean"] > 0 and row["contact_gap_median_m"] < 1e-3 for row in found["rows"][1:])
    text = Path("hold.html").read_text(encoding="utf-8")
    assert "<svg" in text and not re.search(r"""(?:src|href)=["']https?:""", text)
    assert {path.name for path in Path().iterdir()} == {"hold.json", "hold.html"}


def test_grasps_with_stages_are_tried_with_both_and_again_the_same():
    asked, found = ["bench", "hold", *gripper_grasps(), "--starts", "3"], []
    for threads in "12":
        assert main([*asked, "--threads", threads, "--json", "hold.json", "--overwrite"]) == 0
        found.append(json.loads(Path("hold.json").read_text())["rows"])
    for first, again in zip(*found, strict=True):
        assert numbers(first) == numbers(again)
    came, own, geometry, forces = found[0]
    assert [row["method"] for row in found[0]] == ["as-came", "own-stages", "geometry-only", "forces"]
    assert len({row["label"] for row in found[0]}) == 4 and "3" in forces["label"]
    assert came["stages_cpu_ms"] is None and own["stages_cpu_ms"] > 0
    # Nothing presses, as they came; ours do.
    assert came["success_dexgraspbench"] == came["success_strict"] == 0.0 and own["success_dexgraspbench"] == 1.0
    assert came["contact_gap_median_m"] == own["contact_gap_median_m"] == pytest.approx(0.0025)
    assert all(row["lost_strict"] is None and row["contact_gap_median_m"] < 1e-4 for row in (geometry, forces))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --starts 3", ("--preset smoke", "--starts")),
        ("--preset table1", ("--preset", "table1")),
        ("--starts 0", ("--starts", "1", "0")),
        ("--count 0", ("--count", "1", "0")),
        ("--width 0", ("--width", "1", "0")),
        ("--threads 0", ("--threads", "1", "0")),
        ("--protocols upside-down", ("upside-down", "strict")),
        ("--targets nearest", ("--targets",)),
        ("--object teapot", ("'allegro'", "'teapot'")),
        ("--json same --html same", ("same",)),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "hold", *options.split()), *named)
