"""The report of stability: counts that fit into 80 columns, and commands that ask again."""

from __future__ import annotations

import re
from io import StringIO

from rich.console import Console

from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.report import Report
from grasp_refine_apps.bench.stability.rows import Cell
from grasp_refine_apps.bench.stability.study import StabilityStudy, again
from stability_cells import derivative, forward


def printed(rows: list[Row], seed: int = 0, crashes: int = 0) -> list[str]:
    console = Console(file=StringIO(), width=80)
    for part in StabilityStudy((), seed).report(rows, [""] * crashes).printed():
        console.print(part)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def counts(line: str) -> list[int]:
    """The numbers of a line."""
    return [int(number) for number in re.findall(r"\d+", line)]


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


def report(*cells: Cell, problems: int = 0) -> Report:
    return StabilityStudy(()).report([cell.row() for cell in cells], [""] * problems)
