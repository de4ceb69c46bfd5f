"""The report of stability: counts that fit into 80 columns, and commands that ask again."""

from __future__ import annotations

from grasp_refine_apps.bench.stability.study import again
from stability_cells import derivative, forward


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
