"""The schema of measures: keys that programs read, units, and formulas in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.formulas import MeasuredRefinement
from grasp_refine.measures.geometry import movement
from grasp_refine.measures.measures import (
    COMPARED,
    COUNT,
    MEASURES,
    METRE,
    MOVEMENTS,
    RECORDED,
    VALIDATED,
    Measure,
    add_measure,
)
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.results.console import text_of
from grasp_refine.results.document import measure_entries
from grasp_refine.results.result_files import refined_set, result_entries
from grasp_refine.results.result_numbers import number_entries
from grasp_refine.results.table import grasp_table
from grasp_refine.scene.scene import links_of
from grasp_refine_apps.batch.rows import column_kinds
from grasp_refine_apps.viewer.model.columns import numeric_columns
from made_results import plain_outcome
from refusals import refused


def test_measures_of_a_refinement_are_each_its_own():
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, :3], T[1, 0, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], 0.25
    q = np.array([[0.1, 0.2], [0.1, -0.3]])
    cost = {"starts": 2, "iterations": 3, "queries": 4, "wall_s": 5.0, "cpu_s": 6.0}
    measured = MeasuredRefinement(
        **{name: np.array([value]) for name, value in cost.items()},
        loss=np.array([8.0]),
        movement=movement(T[:1], q[:1], T[1:], q[1:], np.array([False, True])),
        displacement=np.array([0.3]),
        contacts_moved=np.array([0.4]),
        links_kept=np.array([0.5]),
    )
    found = {one.name: one.formula(measured).item() for one in RECORDED if not one.of_grasps}
    moved = {"displacement_m": 0.3, "contacts_moved_m": 0.4, "links_kept": 0.5}
    moved |= {
        "moved_palm_m": 0.25,
        "moved_palm_rad": np.pi / 2,
        "moved_joints_rad": 0.0,
        "moved_slides_m": 0.5,
    }
    assert found == pytest.approx({**cost, "loss_m2": 8.0, **moved}) and [one.name for one in MOVEMENTS] == list(moved)
    measured.loss[0] = np.inf
    assert np.isnan(MEASURES["loss_m2"].formula(measured)).all()


@pytest.fixture
def height() -> Iterator[Measure]:
    """A measure that a script has added."""
    measure = Measure("palm_height_m", "palm height", "height of the palm", METRE, lambda it: it.T_world_root[:, 2, 3])
    add_measure(measure)
    yield measure
    MEASURES.remove(measure.name)


def test_an_added_measure_stands_where_ours_stand(height: Measure):
    entries = ["palm_height_m_before", "palm_height_m_after"]
    assert height in RECORDED and height in COMPARED and height in VALIDATED and height not in MOVEMENTS
    outcome = plain_outcome(2, palm_height_m=[[0.3, 0.1], [0.3, 0.2]])
    assert outcome.entries()[entries[1]].tolist() == [0.1, 0.2]
    assert measure_entries(outcome.entries(), 1)["palm_height_m"] == {"before": 0.3, "after": 0.2}
    assert "palm height" in text_of(grasp_table(outcome, "allegro", Config()))
    assert [number_entries()[entry] for entry in entries] == entries
    assert {column_kinds()[entry] for entry in entries} == {"number"}
    assert {column.key: column.unit for column in numeric_columns()}[entries[1]] == "mm"
    hand, ball = load_hand("allegro", candidates=16), load_object("sphere:0.03")
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 2, 3] = 0.2, 0.3
    assert metrics(hand, ball, T, np.zeros((2, len(hand.joint_names)))).palm_height_m.tolist() == [0.2, 0.3]


def test_outcomes_from_before_an_addition_have_no_values_of_it():
    outcome = plain_outcome(2)
    add_measure(Measure("late_m", "added too late", "added late", METRE, lambda it: it.q[:, 0]))
    try:
        assert "late_m_after" not in outcome.entries() and "quality_after" in outcome.entries()
        assert "too late" not in text_of(grasp_table(outcome, "allegro", Config()))
    finally:
        MEASURES.remove("late_m")


def test_names_of_entries_in_files_are_taken():
    hand = load_hand("allegro", candidates=16)
    links = links_of(hand)
    outcome = plain_outcome(1, links=len(links), q=hand.rest[None])
    measures = {entry for one in MEASURES for entry in one.entries.values()}
    written = refined_set(hand, links, outcome).arrays() | result_entries(links, outcome)
    columns = {*column_kinds()} - {entry for one in RECORDED for entry in one.entries.values()}
    for name in {*written, *columns} - measures:
        with refused(GraspRefineError, "taken"):
            add_measure(Measure(name.removesuffix("_before").removesuffix("_after"), "a", "b", COUNT, len))


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"name": "palm height_m"}, ("name", "'palm height_m'")),
        ({"name": "palm_height"}, ("name", "'palm_height'", "palm_height_m")),
        ({"name": "penetration_m"}, ("'penetration_m'", "taken")),
        ({"unit": "m"}, ("unit", "Unit", "'m'")),
        ({"formula": 1}, ("formula", "a function")),
        ({"better": "up"}, ("better", "'higher'", "'up'")),
    ],
)
def test_measures_that_do_not_fit_are_refused(
    changes: dict[str, Any], parts: tuple[str, ...], pytestconfig: pytest.Config
):
    if "name" not in changes and pytestconfig.getoption("jaxtyping_packages"):
        pytest.skip("checked annotations refuse another type first")
    with refused(GraspRefineError, *parts):
        add_measure(Measure(**{"name": "a_m", "title": "a", "hint": "b", "unit": METRE, "formula": len} | changes))
    with refused(GraspRefineError, "a Measure", "'penetration'"):
        add_measure("penetration")  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [0.0, np.zeros((2, 1)), np.zeros(3), np.array(["a", "b"])])
def test_values_of_another_shape_or_type_are_refused(value: Any):
    measure = Measure("odd_m", "odd", "odd", METRE, lambda it: value)
    with refused(GraspRefineError, "odd", "(2,)"):
        measure.values(np.zeros(2))
