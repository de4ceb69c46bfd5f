"""The report of stability: counts that fit into 80 columns, and commands that ask again."""

from __future__ import annotations

import re
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.report import Report, Table
from grasp_refine_apps.bench.stability.cases import KINDS, METHODS, STATES
from grasp_refine_apps.bench.stability.rows import Cell
from grasp_refine_apps.bench.stability.study import StabilityStudy, again, length, words
from stability_cells import derivative, forward


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.0, "0"), (1e-6, "1 µm"), (1e-4, "0.1 mm"), (1e-3, "1 mm"), (0.01, "1 cm"), (0.1, "10 cm"), (1.0, "1 m"),
     (10.0, "10 m"), (1e3, "1 km"), (1e6, "1000 km"), (0.25, "25 cm"), (1e-9, "0.001 µm")],
)  # fmt: skip
def test_lengths_are_said_as_people_do(metres: float, said: str):
    assert length(metres) == said


def test_places_and_batches_are_distinguished():
    assert words("translation", 0.0) == "at the origin" and words("translation", 1e3) == "1 km away"
    assert words("batch", 7) == "batch 7" and words("method", None) == "–"


def printed(rows: list[Row], seed: int = 0, crashes: int = 0) -> list[str]:
    console = Console(file=StringIO(), width=80)
    for part in StabilityStudy((), seed).report(rows, [""] * crashes).printed():
        console.print(part)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def counts(line: str) -> list[int]:
    """The numbers of a line."""
    return [int(number) for number in re.findall(r"\d+", line)]


def test_counts_of_a_large_run_fit_into_80_columns():
    count = {
        "queries": 1_234_567,
        "points_compared": 70_000,
        "collapsed": 1234,
        "mujoco_queries": 12_345,
        "mujoco_wrong": 1234,
    }
    rows = [forward(kind=kind, state=STATES[k], **count).row() for k, kind in enumerate(KINDS)]
    rows += [derivative(method=method, queries=123_456).row() for method in METHODS]
    found = printed(rows)
    assert max(map(len, found)) <= 80
    for kind in KINDS:
        (line,) = (line for line in found if line.split()[:1] == [kind])
        assert line.split()[1:] == ["1234567", *"000000", "70000", "1234", "1e-6", "1e-5"]
    (line,) = (line for line in found if line.startswith("zeroth-order"))
    assert line.split()[1:] == ["123456", *"000000", "1e-3"]
    assert counts(found[-1]) == [15, 11_111_103, 740_736, 0, 11_106], "cells, queries, derivatives, faults, collapsed"
    assert counts(found[-2]) == [111_105, 11_106], "queries of MuJoCo, and how many it has wrong"


def test_all_is_the_sum_over_states_and_nothing_is_counted_twice():
    found = printed([forward(wrong_sign=1).row(), forward(kind="ball", state="deep", not_finite=2, refused=5).row()])
    (line,) = (line for line in found if line.split()[:1] == ["all"])
    assert line.split() == ["all", "20", "5", "0", "2", "0", "1", "0", "0", "0", "1e-6", "1e-5"]
    assert counts(found[-1]) == [2, 20, 3, 5], "cells, queries, faults, refused"


def test_crashes_are_reported_though_they_have_no_rows():
    assert counts(printed([forward().row()], crashes=2)[-1]) == [1, 10, 0, 2], "cells, queries, faults, crashes"


def test_what_is_wrong_is_reported_with_its_command():
    text = "\n".join(printed([forward().row(), forward(state="deep", wrong_sign=2).row()], seed=3))
    assert re.search(r"\b2 wrong sign, float64\b.* 1e-5\b.*\n  refine-grasp bench stability --kinds box", text)
    assert "--states deep" in text and "--seed 3" in text and "--states near" not in text
    text = "\n".join(printed([forward().row()]))
    assert re.search(r"\bfloat64\b.* 1e-5\b.*\n  refine-grasp", text)
    found = printed([forward(error_max=None, points_error_max=None).row()])
    assert "refine-grasp" not in "\n".join(found) and counts(found[-1]) == [1, 10, 0], "cells, queries, faults"


def test_commands_name_all_that_a_cell_depends_on():
    asked = again(forward(diagonal=1e-6, translation=1e6, dtype="float32").row(), 5).removeprefix("refine-grasp ")
    assert asked == (
        "bench stability --kinds box --diagonals 1e-06 --states near --measures forward --dtypes float32 --batches 4 "
        "--engines python --translations 1000000.0 --queries 10 --seed 5"
    )
    asked = again(derivative().row(), 0).removeprefix("refine-grasp ")
    assert asked == (
        "bench stability --kinds box --diagonals 0.1 --states near --measures derivative --dtypes float64 "
        "--methods distance --neighborhoods adaptive --differentiated 3"
    )


def test_commands_name_sizes_and_places_to_the_last_digit():
    """Poses depend on them."""
    asked = again(forward(diagonal=0.12345678, translation=1 / 3).row(), 0).split()
    assert float(asked[asked.index("--diagonals") + 1]) == 0.12345678
    assert float(asked[asked.index("--translations") + 1]) == 1 / 3


def report(*cells: Cell, problems: int = 0) -> Report:
    return StabilityStudy(()).report([cell.row() for cell in cells], [""] * problems)


def test_a_report_fails_where_something_is_wrong_or_crashed():
    assert not report(forward(collapsed=3, mujoco_queries=5, mujoco_wrong=2, refused=1)).failed
    assert report(forward(wrong_sign=1)).failed and report(forward(), problems=1).failed


def tables(found: Report) -> dict[str, list[dict[str, Any]]]:
    return {part.title: list(part.rows) for part in found.parts if isinstance(part, Table)}


def test_refusals_are_listed_with_their_bodies_and_mujoco_apart():
    thin = [
        forward(kind="plate", diagonal=size, refused=10, error_max=None, refusal="too thin") for size in (1e-4, 0.1)
    ]
    part = forward(kind="plate", diagonal=10.0, refused=5, wrong_sign=1, refusal="too thin", where="pose 3")
    found = tables(report(*thin, forward(mujoco_queries=5, mujoco_wrong=2), part))
    assert found["Refusals"] == [{"reason": "too thin", "queries": 25, "bodies": "plate of 0.1 mm, 10 cm, 10 m"}]
    (mujoco,) = found["MuJoCo in comparison"]
    assert (mujoco["kind"], mujoco["mujoco_queries"], mujoco["mujoco_wrong"]) == ("box", 5, 2)
    (wrong,) = found["Wrong cells, or those nearest to it"]
    assert wrong["wrong"] == "1 wrong sign; pose 3" and "--diagonals 10.0" in wrong["command"]
    assert {"Refusals", "MuJoCo in comparison"}.isdisjoint(tables(report(forward())))
