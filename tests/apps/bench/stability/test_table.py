"""What the benchmark prints: counts that fit into 80 columns, and commands that ask again."""

from __future__ import annotations

import re
from io import StringIO

import pytest
from rich.console import Console

from grasp_refine_apps.bench.stability.cases import KINDS, METHODS, STATES
from grasp_refine_apps.bench.stability.labels import again
from grasp_refine_apps.bench.stability.rows import Row
from grasp_refine_apps.bench.stability.table import bench_tables, number
from stability_cells import derivative, forward


def printed(rows: list[Row], seed: int = 0, crashes: int = 0) -> list[str]:
    console = Console(file=StringIO(), width=80)
    for part in bench_tables(rows, seed, crashes):
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


def test_crashes_are_told_though_they_have_no_rows():
    assert counts(printed([forward().row()], crashes=2)[-1]) == [1, 10, 0, 2], "cells, queries, faults, crashes"


def test_what_is_wrong_is_told_with_its_command():
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


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (0.0, "0"), (3e-12, "3e-12"), (0.04, "4e-2"), (1.0, "1e+0"), (2e6, "2e+6")]
)
def test_errors_have_one_digit(value: float | None, text: str):
    assert number(value) == text
