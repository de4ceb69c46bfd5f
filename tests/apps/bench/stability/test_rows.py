"""Cells: their entries, and what counts as wrong."""

from __future__ import annotations

import json

import pytest

from grasp_refine.core.json_files import dumps
from grasp_refine_apps.bench.stability.rows import WRONG, Cell, total, worst, wrong
from stability_cells import derivative, forward


def test_a_row_has_an_entry_for_each_field_and_goes_through_json():
    row = forward(state="deep", translation=1e6).row()
    assert list(row) == list(Cell.__dataclass_fields__) and len(row) == 31
    assert (row["kind"], row["state"], row["translation"], row["method"]) == ("box", "deep", 1e6, None)
    assert json.loads(dumps(row)) == row


@pytest.mark.parametrize("name", WRONG)
def test_every_kind_of_fault_is_seen(name: str):
    row = forward(**{name: 3}).row()
    assert wrong(row) == total([row])["wrong"] == total([row])[name] == 3


def test_refusals_and_faults_of_others_are_no_faults():
    cell = forward(refused=10, mujoco_queries=10, mujoco_wrong=10, collapsed=10, refusal="too thin")
    assert total([cell.row()])["wrong"] == 0
    assert total([cell.row()])["refused"] == total([cell.row()])["mujoco_wrong"] == 10


def test_counts_add_up_and_the_largest_error_stays():
    rows = [forward(wrong_sign=1).row(), forward(wrong_sign=2, error_max=0.5).row(), derivative(refused=3).row()]
    found = total(rows)
    names = ("cells", "queries", "wrong_sign", "refused", "wrong")
    assert [found[name] for name in names] == [3, 23, 3, 3, 3]
    largest = {"error_max": 0.5, "distance_error_max_m": 1e-15, "points_error_max": 1e-5, "derivative_error_max": 1e-3}
    assert found.items() >= largest.items()
    nothing = total([forward(error_max=None, distance_error_max_m=None, points_error_max=None).row()])
    assert {nothing[name] for name in largest} == {None}


def test_the_worst_is_what_is_wrong_most_often_then_what_is_nearest_to_it():
    near, far = forward(error_max=0.9).row(), forward(state="far", error_max=1e-9).row()
    few, many = forward(kind="ball", wrong_points=1).row(), forward(kind="ball", state="far", wrong_sign=2).row()
    slips = derivative(derivative_error_max=0.1).row()
    none = forward(state="deep", error_max=None, points_error_max=None).row()
    # Of one body and state only the worst is shown, here not the second that is near.
    rows = [far, none, few, forward(error_max=0.8).row(), slips, near, many]
    assert worst(rows, 9, 9) == [many, few] and worst(rows, 1, 9) == [many]
    rows = [row for row in rows if not wrong(row)]
    assert worst(rows, 0, 9) == [near, slips, far] and worst(rows, 9, 1) == [near] and worst([none], 9, 9) == []
