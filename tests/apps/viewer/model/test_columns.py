"""Columns of measures: how they sort and how they are read."""

import numpy as np
import pytest

from grasp_refine_apps.viewer.model.columns import Column

NAN = float("nan")


def column(values: list, **options: object) -> Column:
    return Column("key", "Label", "hint", np.array(values), **options)


@pytest.mark.parametrize(
    ("values", "up", "down"),
    [
        ([3.0, NAN, 1.0, 2.0], [2, 3, 0, 1], [0, 3, 2, 1]),
        # Equal values keep the order of the file, both ways.
        ([1.0, 0.0, 1.0, NAN, 0.0, NAN], [1, 4, 0, 2, 3, 5], [0, 2, 1, 4, 3, 5]),
        ([NAN, NAN], [0, 1], [0, 1]),
        (["b", "", "a", "b"], [2, 0, 3, 1], [0, 3, 2, 1]),
        ([np.inf, -np.inf, 0.0], [1, 2, 0], [0, 2, 1]),
    ],
)
def test_sorting_is_stable_and_puts_the_unknown_last(values: list, up: list[int], down: list[int]) -> None:
    assert column(values).order().tolist() == up
    assert column(values).order(descending=True).tolist() == down


def test_numbers_are_read_in_their_unit() -> None:
    error = column([0.00123, NAN], unit="mm", factor=1e3)
    assert (error.title, error.text(0), error.text(1)) == ("Label, mm", "1.23", "")
    assert column(["stalled"]).text(0) == "stalled"
    assert column(["stalled"]).title == "Label"
