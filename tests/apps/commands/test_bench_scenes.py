"""`refine-grasp bench scenes` as a user meets it: rows with and without knowledge of the scene, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.mark.slow
def test_a_grasp_in_a_scene_is_refined_planned_and_followed(capfd: pytest.CaptureFixture[str]) -> None:
    """Known, the mug is lifted off its table; the pooled rows are those of the one scene."""
    assert main(["bench", "scenes", "--preset", "smoke", "--json", "found.json", "--html", "found.html"]) == 0
    out, _ = capfd.readouterr()
    assert "without knowing" in out and max(map(len, map(str.rstrip, out.splitlines()))) <= 100
    rows = json.loads(Path("found.json").read_text())["rows"]
    assert [(row["scene"], row["known"]) for row in rows] == [
        ("all", True),
        ("all", False),
        ("mug-on-table", True),
        ("mug-on-table", False),
    ]
    for pooled, single in zip(rows[:2], rows[2:], strict=True):
        assert {**pooled, "scene": "mug-on-table"} == single
    known = rows[2]
    assert known["grasps"] == known["reachable"] == 1 and known["free"] == known["held"] == known["clean"] == [1, 1]
    assert Path("found.html").read_text(encoding="utf-8").count("franka_hand mug-on-table") == 2


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--scenes mug-on-tabel", ("mug-on-tabel", "mug-on-table")),
        ("--base 1,2", ("--base 1,2",)),
        ("--arm ur6 --scenes mug-on-table", ("ur6", "ur5e")),
        ("--arm allegro --scenes mug-on-table", ("allegro", "ends at several links")),
        ("--preset smoke --count 2", ("--preset smoke", "--count")),
    ],
)
def test_wrong_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    """In one line that names the value."""
    assert_names(refused(capfd, "bench", "scenes", *options.split()), *named)
