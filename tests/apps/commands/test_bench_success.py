"""`refine-grasp bench success` as a user meets it: its presets, documents that repeat themselves, and refusals."""

from __future__ import annotations

import json
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


@pytest.mark.slow
def test_grasps_with_stages_are_tried_with_both_and_again_the_same():
    asked = [*gripper_grasps(), "--starts", "3"]
    found = [of(success(*asked, "--threads", threads), "all") for threads in "12"]
    for first, again in zip(*found, strict=True):
        assert numbers(first) == numbers(again)
    given, own, geometry, closest = found[0]
    assert [row["method"] for row in found[0]] == ["as-given", "own-stages", "geometry-only", "closest"]
    assert len({row["refined"] for row in found[0]}) == 4 and "3" in closest["refined"]
    # Nothing presses as given; ours does.
    assert given["success_dexgraspbench"] == given["success_strict"] == 0.0 and own["success_dexgraspbench"] == 1.0
    assert given["contact_error_median_m"] == own["contact_error_median_m"] == pytest.approx(0.0025)
    assert all(row["lost_strict"] is None and row["contact_error_median_m"] < 1e-4 for row in (geometry, closest))


@pytest.mark.slow
def test_a_grasp_in_a_scene_is_refined_planned_and_followed(capfd: pytest.CaptureFixture[str]):
    """Known, the mug is lifted off its table."""
    rows = success("--preset scenes --scenes mug-on-table --hands franka_hand --count 1")
    out, _ = capfd.readouterr()
    assert "unaware" in out and max(map(len, map(str.rstrip, out.splitlines()))) <= 100
    known = [row for row in of(rows, "source") if row["label"] == "sampled"]
    verdicts = ("reachable", "trajectory is free", "held and lifted", "and nothing hit")
    assert [[row[f"held_{name}"] for name in verdicts] for row in known] == [[1] * 4] * 2
    assert all(row["pushed_max_m"] is None for row in known), "nothing stands beside it"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--starts 0", ("--starts", "1", "0")),
        ("--protocols upside-down", ("upside-down", "strict")),
        ("--protocols one.toml two.toml", ("--protocols", "mine")),
        ("--engines bullet", ("--engines", "bullet", "mujoco", "drake")),
        ("--targets nearest", ("--targets",)),
        ("--hands no_gripper", ("no_gripper",)),
        ("--preset scenes --scenes mug-on-tabel", ("mug-on-tabel", "mug-on-table")),
        ("--preset scenes --stand 1,2", ("--stand 1,2",)),
        ("--preset scenes --arm ur6 --scenes mug-on-table", ("ur6", "ur5e")),
        ("--preset scenes --arm allegro --scenes mug-on-table", ("allegro", "ends at several links")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    for name in ("one", "two"):
        Path(f"{name}.toml").write_text('name = "mine"')
    assert_names(refused(capfd, "bench", "success", *options.split()), *named)
