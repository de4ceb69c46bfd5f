"""Sizes that cannot have been meant are asked about, with what each unit would make of them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.units import UNITS, check_size
from refusals import assert_names, refused


@pytest.mark.parametrize("extents", [[0.09, 0.06, 0.04], [0.002, 0.002, 0.002], [1.9, 0.1, 0.1]])
def test_sizes_of_things_are_taken(extents: list[float]) -> None:
    check_size(np.array(extents), None, "mug")


def offered(caught: pytest.ExceptionInfo[BaseException]) -> list[str]:
    """The units that the question names as choices."""
    return re.findall(r"`unit='(\w+)'`", str(caught.value))


@pytest.mark.parametrize(
    ("extents", "size", "choices"),
    [
        ([90.0, 60.0, 40.0], "90 x 60 x 40 m", {"cm": "900 x 600 x 400 mm", "mm": "90 x 60 x 40 mm"}),
        (
            [3.5, 3.0, 2.0],
            "3.5 x 3 x 2 m",
            {"cm": "35 x 30 x 20 mm", "mm": "3.5 x 3 x 2 mm", "in": "88.9 x 76.2 x 50.8 mm"},
        ),
        ([5e-4, 5e-4, 5e-4], "0.5 x 0.5 x 0.5 mm", {}),
    ],
)
def test_other_sizes_are_asked_about(extents: list[float], size: str, choices: dict[str, str]) -> None:
    with refused(MeshError, "mug", size, "metres", "`scale`") as caught:
        check_size(np.array(extents), None, "mug")
    assert offered(caught) == [*choices, "m"]
    # After each unit, the size that it means.
    assert_names(str(caught.value).partition("`unit=")[2], *choices.values())


def test_units_are_metres() -> None:
    assert UNITS["in"] == pytest.approx(2.54 * UNITS["cm"]) and UNITS["cm"] == 10 * UNITS["mm"]


def test_a_unit_that_was_said_is_named_in_the_question() -> None:
    check_size(np.array([90.0, 60.0, 40.0]), "mm", "mug")
    check_size(np.array([90.0, 60.0, 40.0]), "m", "mug")
    with refused(MeshError, "mug", "2.29 x 1.52 x 1.02 m", "inches", "`scale`") as caught:
        check_size(np.array([90.0, 60.0, 40.0]), "in", "mug")
    assert offered(caught) == ["cm", "mm"]
    assert_names(str(caught.value), "900 x 600 x 400 mm", "90 x 60 x 40 mm")
