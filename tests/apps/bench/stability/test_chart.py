"""Heat maps: what stands where, how dark it is, and what is written in it."""

from __future__ import annotations

import pytest

from grasp_refine_apps.bench.stability.chart import PALEST_ERROR, depth, heat_map
from grasp_refine_apps.bench.stability.labels import length, words
from stability_cells import derivative, forward

BODY = ("kind", "diagonal")


@pytest.mark.parametrize(
    ("error", "percent"),
    [(None, 0), (0.0, 0), (PALEST_ERROR / 10, 0), (PALEST_ERROR, 0), (1e-4, 50), (1.0, 100), (1e3, 100)],
)
def test_squares_are_darker_by_the_decade(error: float | None, percent: int):
    assert depth(error) == percent


def test_rows_and_columns_come_in_the_order_of_the_benchmark():
    cells = [
        forward(kind=kind, diagonal=size, state=state)
        for kind in ("plate", "ball")
        for size in (10.0, 1e-4)
        for state in ("concentric", "far", "gap-1e-12", "gap-1e-3")
    ]
    found = heat_map([cell.row() for cell in cells], BODY, "state", "error_max")
    assert found.corner == BODY and found.columns == ("far", "gap-1e-3", "gap-1e-12", "concentric")
    # A kind is said once for all its sizes.
    assert [line.heads for line in found.lines] == [
        (("ball", 2), ("0.1 mm", 1)), (("10 m", 1),), (("plate", 2), ("0.1 mm", 1)), (("10 m", 1),)
    ]  # fmt: skip


def test_a_square_is_of_the_worst_of_its_cells_and_says_how_many_are_wrong():
    rows = [
        forward().row(),
        forward(error_max=1e-2, dtype="float32").row(),
        forward(state="deep", wrong_distance=2, error_max=7.0).row(),
        forward(state="deep", wrong_sign=1, dtype="float32").row(),
        forward(kind="plate", refused=10, error_max=None).row(),
        forward(kind="plate", state="deep", refused=4).row(),
        forward(kind="slivers", state="deep").row(),
    ]
    box, plate, slivers = (line.squares for line in heat_map(rows, BODY, "state", "error_max").lines)
    assert [(one.look, one.depth, one.text) for one in box] == [("right", 75, ""), ("wrong", 100, "3")]
    assert box[0].hint == "box, 10 cm, near: 20 queries, none wrong, worst error 1.0e-02 of its tolerance"
    assert "20 queries, 2 wrong distance, 1 wrong sign, worst error 7.0e+00" in box[1].hint
    assert [one.look for one in plate] == ["refused", "right"] and plate[1].hint.count("4 refused") == 1
    assert [one.look for one in slivers] == ["none", "right"] and "no such cell" in slivers[0].hint


def test_methods_without_candidates_have_no_neighborhood():
    methods = [("zeroth-order", None), ("distance", "fixed"), ("distance", "adaptive")]
    rows = [derivative(method=name, neighborhood=near).row() for name, near in methods]
    found = heat_map(rows, ("method", "neighborhood"), "diagonal", "derivative_error_max")
    assert [line.heads for line in found.lines] == [
        (("distance", 2), ("adaptive", 1)), (("fixed", 1),), (("zeroth-order", 1), ("–", 1))
    ]  # fmt: skip
    assert found.columns == ("10 cm",) and [line.squares[0].depth for line in found.lines] == [62, 62, 62]


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.0, "0"), (1e-6, "1 µm"), (1e-4, "0.1 mm"), (1e-3, "1 mm"), (0.01, "1 cm"), (0.1, "10 cm"), (1.0, "1 m"),
     (10.0, "10 m"), (1e3, "1 km"), (1e6, "1000 km"), (0.25, "25 cm"), (1e-9, "0.001 µm")],
)  # fmt: skip
def test_lengths_are_said_as_people_do(metres: float, said: str):
    assert length(metres) == said


def test_places_and_batches_are_told_apart():
    assert words("translation", 0.0) == "at the origin" and words("translation", 1e3) == "1 km away"
    assert words("batch", 7) == "batch 7" and words("method", None) == "–"
