"""Sizes that cannot have been meant are asked about, with what each unit would make of them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from grasp_refine.errors import MeshError
from grasp_refine.geometry.units import UNITS, check_size


@pytest.mark.parametrize("extents", [[0.09, 0.06, 0.04], [0.002, 0.002, 0.002], [1.9, 0.1, 0.1]])
def test_sizes_of_things_are_taken(extents: list[float]) -> None:
    check_size(np.array(extents), None, "mug")


@pytest.mark.parametrize(
    ("extents", "message"),
    [
        (
            [90.0, 60.0, 40.0],
            "mug: is 90 x 60 x 40 m if its numbers are metres, which is no size for a hand; in which unit is it? "
            "--unit cm if it is 900 x 600 x 400 mm, --unit mm if it is 90 x 60 x 40 mm, --unit m if that is right, or",
        ),
        ([3.5, 3.0, 2.0], "--unit in if it is 88.9 x 76.2 x 50.8 mm, --unit m if that is right, or another --scale"),
        ([5e-4, 5e-4, 5e-4], "mug: is 0.5 x 0.5 x 0.5 mm if its numbers are metres"),
        ([5e-4, 5e-4, 5e-4], "in which unit is it? --unit m if that is right, or another --scale"),
    ],
)
def test_other_sizes_are_asked_about(extents: list[float], message: str) -> None:
    with pytest.raises(MeshError, match=re.escape(message)):
        check_size(np.array(extents), None, "mug")


def test_units_are_metres() -> None:
    assert UNITS["in"] == pytest.approx(2.54 * UNITS["cm"]) and UNITS["cm"] == 10 * UNITS["mm"]


def test_a_unit_that_was_said_is_named_in_the_question() -> None:
    check_size(np.array([90.0, 60.0, 40.0]), "mm", "mug")
    check_size(np.array([90.0, 60.0, 40.0]), "m", "mug")
    expected = (
        "mug: is 2.29 x 1.52 x 1.02 m if its numbers are inches, which is no size for a hand; in which unit is it? "
        "--unit cm if it is 900 x 600 x 400 mm, --unit mm if it is 90 x 60 x 40 mm, or another --scale"
    )
    with pytest.raises(MeshError, match=re.escape(expected)):
        check_size(np.array([90.0, 60.0, 40.0]), "in", "mug")
