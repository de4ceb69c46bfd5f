"""`refine-grasp bench grasp` as a user meets it: tables, documents that repeat themselves, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from command_line import document, refused
from grasp_refine_apps.bench.grasp.presets import PLACES
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")

BOX = ("bench", "grasp", "--object", "rounded_box")
TINY = (*BOX, "--count", "2", "--batches", "2")


def numbers(row: dict[str, Any]) -> dict[str, float]:
    """The numbers of a row but for times."""
    return {
        key: value
        for key, value in row.items()
        if isinstance(value, int | float) and not ("_ms_per_grasp" in key or key.endswith("_per_s"))
    }


# Runs


def test_a_run_prints_its_tables_and_writes_its_rows(capfd: pytest.CaptureFixture[str]):
    found = document(*TINY, "--noise", "0.1")
    out, error = capfd.readouterr()
    assert error == ""
    titles = [line for line in out.splitlines() if "allegro example" in line and "2 grasps" in line]
    assert ["targets" in title for title in titles] == [True, False] and "nothing" in titles[1]
    assert max(map(len, map(str.rstrip, out.splitlines()))) <= 80 and "bench.json" in out
    assert list(found) == [
        "schema", "command", "invocation", "versions", "machine", "engine", "preset", "config", "seed", "wall_s",
        "cpu_s", "problems", "rows",
    ]  # fmt: skip
    assert (found["schema"], found["command"], found["preset"]) == (1, "bench grasp", None)
    assert found["invocation"] == ("refine-grasp bench grasp --object rounded_box --batches 2 --count 2 --noise 0.1")
    targets, nothing = found["rows"]
    for row in found["rows"]:
        assert (row["set"], row["hand"], row["object"]) == ("allegro example", "allegro", "all")
        assert (row["solver"], row["derivative"], row["batch"], row["grasps"]) == (
            "levenberg-marquardt", "contact-kinematics", 2, 2
        )  # fmt: skip
        assert row["limits_violated"] == 0
        assert sum(value for key, value in row.items() if key.startswith("status_")) == 2
        assert 0 < row["iterations_mean"] <= row["budget"] and row["queries_mean"] > 0
        assert row["cpu_ms_per_grasp"] > 0 and row["wall_ms_per_grasp"] > 0
        assert row["penetration_after_mean_m"] <= row["penetration_before_mean_m"]
    assert (targets["task"], nothing["task"]) == ("targets", "nothing")
    assert targets["acc_1e6"] == 1.0 and targets["contact_error_worst_m"] < 1e-3
    # The disturbance is undone.
    assert 0.005 < targets["moved_palm_median_m"] < 0.05
    assert nothing["acc_1e6"] is None and nothing["deep_starts"] == 0 and nothing["gap_median_m"] < 5e-5
    assert {path.name for path in Path().iterdir()} == {"bench.json"}


@pytest.mark.slow
def test_neither_processes_nor_batches_change_what_comes_out():
    options = (*BOX, "--count", "2", "--tasks", "targets", "--batches", "1", "2")
    single, together = map(numbers, document(*options)["rows"])
    (elsewhere,) = map(numbers, document(*options[:-2], "2", "--workers", "2")["rows"])
    # But for rounding.
    assert elsewhere == pytest.approx(together, rel=1e-3, abs=1e-9)
    together |= {"batch": 1, "batch_mean": 1.0}
    assert together == pytest.approx(single, rel=1e-3, abs=1e-9)


def test_sets_of_the_assets_are_found_by_name(shared_assets: Path):
    options = ["--sets", "leap_cube", "--tasks", "nothing", "--count", "2", "--batches", "2"]
    (row,) = document("bench", "grasp", "--assets", shared_assets, *options)["rows"]
    assert (row["set"], row["hand"], row["grasps"]) == ("leap_cube", "leap_right", 2)
    assert all((shared_assets / place.hand).is_file() for place in PLACES.values())


# Bad input


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --solvers adam", ("--preset smoke", "--solvers")),
        ("--preset workers --workers 2", ("--preset workers", "--workers")),
        ("--batches 0", ("--batches", "1", "0")),
        ("--shift -1", ("--shift", "finite", "negative", "-1")),
        ("--derivatives distance", ("--derivatives", "descent", "adam")),
        ("--sets mine --assets .", ("--sets", "mine")),
        ("--sets leap_cube", ("--sets", "--assets")),
        ("--sets leap_cube --assets .", ("--assets .", "grasps/normalised/leap_cube.npz")),
        ("--assets . --object mug", ("--assets", "hands", "objects", "grasps")),
        ("--targets mine.npz", ("--targets",)),
        ("--object teapot", ("'allegro'", "'teapot'")),
        ("--json same --html same", ("same",)),
        ("--json .", (".: ", "folder")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "grasp", *options.split()), *named)
