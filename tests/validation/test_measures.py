"""The schema of measures: keys that programs read, units, and formulas in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.measures.formulas import MeasuredRefinement
from grasp_refine.measures.geometry import movement
from grasp_refine.measures.measures import COMPARED, MEASURE, MEASURES, MOVEMENTS, RECORDED, VALIDATED, Measure
from grasp_refine.refinement.refine import Refinement

LENGTHS = ("contact_error", "penetration", "self_penetration", "scene_penetration", "region_miss", "arm_dexterity")


def test_keys_in_files_are_those_that_programs_know():
    entries = {entry for measure in RECORDED for entry in measure.entries.values()}
    both = ("quality", "wrench_residual", *LENGTHS)
    assert entries == {
        *(f"{key}_{side}" for key in both for side in ("before", "after")),
        *("starts", "iterations", "queries", "loss", "limits_violated", "cpu_s", "wall_s"),
        *("moved_palm_m", "moved_palm_rad", "moved_joints_rad", "moved_slides_m"),
    }
    columns = {column for measure in RECORDED for column in measure.columns.values()}
    assert columns == {
        f"{entry}_m" if entry.startswith(LENGTHS) else entry.replace("loss", "loss_m2") for entry in entries
    }
    assert {measure.name for measure in VALIDATED} == {
        *("quality", "wrench_residual", "contact_error_m", "penetration_m", "self_penetration_m"),
        "scene_penetration_m",
        *("region_miss_m", "contact_distance_m", "contact_number", "limits_violated", "arm_dexterity_m"),
    }
    assert [measure.key for measure in COMPARED] == list(both)


def test_quality_and_contacts_are_better_high_and_errors_and_costs_low():
    found = {better: {one.key for one in MEASURES if one.better == better} for better in ("higher", "lower", "")}
    assert found["higher"] == {"quality", "contact_number", "arm_dexterity"}
    assert found[""] == {"starts", *(one.key for one in MOVEMENTS)}
    assert len(found["lower"]) + 8 == len(MEASURES)


@pytest.mark.parametrize("measure", MEASURES, ids=lambda one: one.key)
def test_people_read_the_unit_that_is_named(measure: Measure):
    """The factor is that from the SI unit of the key to the symbol."""
    factor = {"mm": 1e3, "mm²": 1e6, "°": 180 / np.pi, "s": 1.0, "": 1.0}[measure.unit.symbol]
    suffix = {"mm": "_m", "mm²": "_m2", "°": "_rad", "s": "_s", "": ""}[measure.unit.symbol]
    assert measure.unit.factor == pytest.approx(factor) and measure.unit.suffix == suffix
    assert measure.text(2.0, ".3f") == f"{2 * factor:.3f}"


def test_measures_of_a_refinement_are_each_its_own():
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, :3], T[1, 0, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], 0.25
    q = np.array([[0.1, 0.2], [0.1, -0.3]])
    cost = {"starts": 2, "iterations": 3, "queries": 4, "wall_s": 5.0, "cpu_s": 6.0}
    none = np.zeros((1, 1, 3))
    refinement = Refinement(
        T[1:], q[1:], none[..., 0] > 0, none, none, np.ones(1, dtype=int), np.array([[7.0, 8.0]]),
        **{key: np.array([value]) for key, value in cost.items()},
    )  # fmt: skip
    measured = MeasuredRefinement(refinement, movement(T[:1], q[:1], T[1:], q[1:], np.array([False, True])))
    found = {one.key: one.formula(measured).item() for one in RECORDED if not one.of_grasps}
    moved = {"moved_palm_m": 0.25, "moved_palm_rad": np.pi / 2, "moved_joints_rad": 0.0, "moved_slides_m": 0.5}
    assert found == pytest.approx({**cost, "loss": 8.0, **moved}) and [one.key for one in MOVEMENTS] == list(moved)
    refinement.loss[0, 1] = np.inf
    assert np.isnan(MEASURE["loss"].formula(measured)).all()
