"""`refine-grasp bench success` as a user meets it: its presets, documents that repeat themselves, and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import refused
from evidence_assets import write_assets
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


def success(*options: object) -> list[dict[str, Any]]:
    """Rows of a run with these options."""
    words = [word for option in options for word in str(option).split()]
    assert main(["bench", "success", *words, "--json", "found.json", "--overwrite"]) == 0
    return list(json.loads(Path("found.json").read_text())["rows"])


def of(rows: list[dict[str, Any]], by: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["by"] == by]


def numbers(row: dict[str, Any]) -> dict[str, float]:
    """The numbers of a row but for times."""
    return {
        key: value
        for key, value in row.items()
        if isinstance(value, int | float) and not key.startswith(("cpu", "wall"))
    }


def test_smoke_measures_what_holds_and_reports_in_one_file(capfd: pytest.CaptureFixture[str]):
    for module in ("matplotlib", "jinja2"):
        pytest.importorskip(module, reason="the report needs it")
    options = ["bench", "success", "--preset", "smoke", "--protocols", "dexgraspbench", "--object", "rounded_box"]
    assert main([*options, "--json", "hold.json", "--html", "hold.html", "--markdown", "hold.md"]) == 0
    out, _ = capfd.readouterr()
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80 and "hold.json, hold.html, hold.md" in out
    found = json.loads(Path("hold.json").read_text())
    assert (found["schema"], found["command"], found["preset"]) == (1, "bench success", "smoke")
    asked = "refine-grasp bench success --object rounded_box --preset smoke --protocols dexgraspbench"
    assert found["invocation"] == asked and asked in Path("hold.md").read_text()
    rows = of(found["rows"], "all")
    assert [(row["method"], row["starts"]) for row in rows] == [
        ("as-given", None), ("geometry-only", 1), ("forces", 1), ("forces", 2)
    ]  # fmt: skip
    for row in rows:
        assert row["grasps"] == 2 and 0 <= row["success_dexgraspbench"] <= 1 and "success_strict" not in row
        assert sum(row["reasons_dexgraspbench"].values()) == round(2 * (1 - row["success_dexgraspbench"]))
    assert all(row["cpu_mean_s"] > 0 and row["contact_error_median_m"] < 1e-3 for row in rows[1:])
    text = Path("hold.html").read_text(encoding="utf-8")
    assert "<svg" in text and not re.search(r"""(?:src|href)=["']https?:""", text)
    assert {path.name for path in Path().iterdir()} == {"hold.json", "hold.html", "hold.md"}


def test_grasps_with_stages_are_tried_with_both_and_again_the_same():
    asked = [*gripper_grasps(), "--starts", "3"]
    found = [of(success(*asked, "--threads", threads), "all") for threads in "12"]
    for first, again in zip(*found, strict=True):
        assert numbers(first) == numbers(again)
    given, own, geometry, forces = found[0]
    assert [row["method"] for row in found[0]] == ["as-given", "own-stages", "geometry-only", "forces"]
    assert len({row["refined"] for row in found[0]}) == 4 and "3" in forces["refined"]
    # Nothing presses as given; ours does.
    assert given["success_dexgraspbench"] == given["success_strict"] == 0.0 and own["success_dexgraspbench"] == 1.0
    assert given["contact_error_median_m"] == own["contact_error_median_m"] == pytest.approx(0.0025)
    assert all(row["lost_strict"] is None and row["contact_error_median_m"] < 1e-4 for row in (geometry, forces))


def test_grasps_of_a_gripper_are_sampled_perturbed_refined_and_simulated():
    rows = success("--preset grippers --on box:0.04,0.04,0.06 --count 1")
    assert [(row["label"], row["method"]) for row in of(rows, "source")] == [
        (label, method) for label in ("perturbed", "sampled") for method in ("as-given", "forces")
    ]
    # A box between flat pads holds, at least where they touch in several points.
    assert all(row["grasps"] == 1 and row["success_friction 0_6"] == 1.0 for row in of(rows, "source"))
    assert "success_friction 0_3, one point" in rows[0]


@pytest.mark.slow
def test_a_grasp_in_a_scene_is_refined_planned_and_followed(capfd: pytest.CaptureFixture[str]):
    """Known, the mug is lifted off its table."""
    rows = success("--preset scenes --scenes mug-on-table --hands franka_hand --count 1")
    out, _ = capfd.readouterr()
    assert "unaware" in out and max(map(len, map(str.rstrip, out.splitlines()))) <= 100
    known = [row for row in of(rows, "source") if row["label"] == "sampled"]
    verdicts = ("reachable", "trajectory is free", "held and lifted", "and nothing hit")
    assert [[row[f"held_{name}"] for name in verdicts] for row in known] == [[1] * 4] * 2
    assert all(row["pushed_max_m"] < 1e-3 for row in known)


@pytest.mark.slow
def test_all_of_a_folder_of_assets_is_kept_and_a_broken_case_is_a_row(tmp_path: Path):
    """Two sampled grasps on each of two objects, and two of the generator."""
    assets = write_assets(tmp_path / "assets")
    asked = ["bench", "success", "--preset", "assets", "--assets", str(assets), "--hands", "allegro", "--count", "2"]
    asked += ["--generated", "2", "--protocols", "dexgraspbench", "strict", "--out", "out", "--json", "found.json"]
    assert main([*asked, "--html", "found.html"]) == 0
    rows = json.loads(Path("found.json").read_text())["rows"]
    (given, geometry, refined) = of(rows, "all")
    assert given["grasps"] == 6
    assert {row["label"]: row["grasps"] for row in of(rows, "source")} == {"sampled": 4, "made": 2}
    assert {row["label"]: row["grasps"] for row in of(rows, "object")} == {"ball": 2, "my_rounded_box": 4}
    for name in ("success_strict", "success_dexgraspbench"):
        pooled = sum(row["grasps"] * row[name] for row in of(rows, "object") if row["method"] == "forces")
        assert pooled == pytest.approx(6 * refined[name])
    files = [np.load(path) for path in sorted(Path("out/forces-6").rglob("*.npz"))]
    depth = np.concatenate([file["penetration_m_after"] for file in files])
    assert refined["penetration_mean_m"] == pytest.approx(depth.mean(), abs=1e-9) and len(depth) == 6
    page = Path("found.html").read_text()
    assert all(f"{row['label']}" in page for row in of(rows, "failure"))
    before = {path: path.stat().st_mtime_ns for path in Path("out/forces-6").rglob("*.npz")}
    (assets / "objects/ball.obj").write_text("v 0 0 0\n")
    assert main([*asked, "--overwrite"]) == 1
    again = json.loads(Path("found.json").read_text())
    assert len(again["problems"]) == 1 and "sampled/allegro/ball" in again["problems"][0]
    assert of(again["rows"], "all")[0]["grasps"] == 4
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())


@pytest.mark.slow
def test_both_engines_try_the_same_grasps():
    pytest.importorskip("pydrake")
    rows = success("--hands leap --on sphere:0.03 --methods as-given --protocols dexgraspbench --engines mujoco drake")
    ((row,), (agreed,)) = of(rows, "all"), of(rows, "engines")
    held = [row[f"held_{name}"] for name in ("dexgraspbench", "dexgraspbench in Drake")]
    assert agreed["grasps"] == 1 and agreed["share"] == float(held[0] == held[1])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset table1", ("--preset", "table1")),
        ("--starts 0", ("--starts", "1", "0")),
        ("--count 0", ("--count", "1", "0")),
        ("--width 0", ("--width", "1", "0")),
        ("--threads 0", ("--threads", "1", "0")),
        ("--workers 0", ("--workers", "1", "0")),
        ("--protocols upside-down", ("upside-down", "strict")),
        ("--protocols", ("--protocols",)),
        ("--protocols one.toml two.toml", ("--protocols", "mine")),
        ("--engines bullet", ("--engines", "bullet", "mujoco", "drake")),
        ("--targets nearest", ("--targets",)),
        ("--object teapot", ("'allegro'", "'teapot'")),
        ("--hands no_gripper", ("no_gripper",)),
        ("--assets nowhere", ("nowhere",)),
        ("--preset scenes --scenes mug-on-tabel", ("mug-on-tabel", "mug-on-table")),
        ("--preset scenes --stand 1,2", ("--stand 1,2",)),
        ("--preset scenes --arm ur6 --scenes mug-on-table", ("ur6", "ur5e")),
        ("--preset scenes --arm allegro --scenes mug-on-table", ("allegro", "ends at several links")),
        ("--json same --html same", ("same",)),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    for name in ("one", "two"):
        Path(f"{name}.toml").write_text('name = "mine"')
    assert_names(refused(capfd, "bench", "success", *options.split()), *named)
