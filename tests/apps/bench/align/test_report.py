"""The report of the alignment benchmark: labels, which rows are compared, and what tables and charts are made of."""

from __future__ import annotations

import re
from typing import Any

import pytest

from grasp_refine_apps.bench.align.report import (
    MAX_LINES,
    at_best,
    at_largest_budget,
    epsilons,
    labels_of,
    ordered,
    report,
    swept,
)
from grasp_refine_apps.bench.chart import Chart
from grasp_refine_apps.bench.report import Table


def row(method: str = "distance", kind: str = "convex", **changes: Any) -> dict[str, Any]:
    """A row with plausible numbers."""
    errors = {"targets": 200, "acc_1e6": 0.9, "acc_1e8": 0.8, "d5": 1.23e-9, "d9": 4e-5}
    return {
        "kind": kind,
        "method": method,
        "neighborhood": "adaptive" if method == "distance" else None,
        "solver": "descent",
        "transport": False,
        "margin": 0.001,
        "budget": 100,
        "budget_s": None,
        "pairs": 4,
        **errors,
        "reachable": errors | {"acc_1e6": 0.95},
        "unfiltered": errors | {"acc_1e6": 0.7},
        "last": errors | {"acc_1e6": 0.5},
        "patch": None,
        "pair": "all",
        "target_class": "all",
        "witness": "plain",
        "epsilon": None,
        "coupling": "coupled",
        "step_size": 10.0,
        "optimise": "T2",
        "dtype": "float64",
        "forward_us": 30.0,
        "backward_us": 40.0,
        "sampling_us": 5.0,
        "queries_mean": 80.0,
        "iterations_mean": 80.0,
        "cpu_s_per_pair": 1.5,
        "wall_s_per_pair": 1.0,
        "cpu_share": {"broadphase": 0.1, "narrowphase": 0.4, "derivative": 0.3, "solver": 0.2},
        **changes,
    }


def several() -> list[dict[str, Any]]:
    """Two methods, two kinds, two budgets, with rows of two classes and of a pair."""
    rows = []
    for kind in ("concave", "convex"):
        for k, method in enumerate(("analytical", "distance")):
            for budget in (10, 100):
                share, time = 0.4 + 0.2 * k + 0.002 * budget, 0.01 * budget * (k + 1)
                rows.append(row(method, kind, budget=budget, acc_1e6=share, d5=1e-4 / budget, cpu_s_per_pair=time))
            rows.append(row(method, kind, target_class="face-vertex", acc_1e6=0.1234 + 0.1 * k))
            rows.append(row(method, kind, target_class="face-face", acc_1e6=0.01))
            rows.append(row(method, kind, pair="mug / bowl", acc_1e6=0.4321))
    return rows


def least_squares(**changes: Any) -> dict[str, Any]:
    """A row of Levenberg-Marquardt."""
    nothing = {"neighborhood": None, "coupling": None, "step_size": None}
    return row("contact-kinematics", solver="levenberg-marquardt", **nothing, **changes)


def patched(epsilon: float = 1e-5, **changes: Any) -> dict[str, Any]:
    """Entries of a row that was measured by a patch witness, too."""
    patch = {"epsilon": epsilon, "targets": 200, "acc_1e6": 0.9871, "acc_1e8": 0.8, "d5": 1e-12, "d9": 3e-7}
    return {"epsilon": epsilon, "patch": patch, **changes}


def labelled(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{**one, "label": label} for one, label in zip(rows, labels_of(rows), strict=True)]


def tables(rows: list[dict[str, Any]]) -> dict[str, Table]:
    """The tables of a page by their titles, and of a terminal by kind."""
    return {
        part.title.split(",")[1].strip() if part.only == "terminal" else part.title: part
        for part in report(rows, "200 targets a pair").parts
        if isinstance(part, Table)
    }


def texts(table: Table, key: str) -> list[str]:
    (column,) = (column for column in table.columns if column.key == key)
    return [column.text(one) for one in table.rows]


def test_labels_say_only_what_differs():
    rows = [row(), row(transport=True), row("analytical"), row("analytical", budget=7)]
    assert labels_of(rows) == ["distance", "distance + EG", "analytical", "analytical"]
    rows = [row(margin=0.0), row(margin=0.0005, neighborhood="fixed")]
    assert labels_of(rows) == ["distance + adaptive + margin 0 mm", "distance + fixed + margin 0.5 mm"]
    assert labels_of(rows, without=["margin"]) == ["distance + adaptive", "distance + fixed"]
    assert len(set(labels_of([row(optimise="T1T2"), row()]))) == 2
    assert labels_of([row("contact-kinematics"), least_squares()]) == ["contact-kinematics", "levenberg-marquardt"]
    assert labels_of([row(**patched(2e-6, witness="patch"))]) == ["distance + patch 2 µm"]
    assert labels_of([]) == []


def test_the_largest_budget_of_each_variant_counts():
    rows = labelled([row(budget=100), row(budget=20), row("rigid", budget=20, kind="concave"), row("rigid", budget=50)])
    assert [one["budget"] for one in at_largest_budget(rows)] == [100, 20, 50]
    seconds = labelled([row(budget=None, budget_s=2.0), row(budget=None, budget_s=5.0)])
    assert at_largest_budget(seconds) == seconds[1:]


def test_rows_are_ordered_by_kind_method_setting_and_budget():
    rows = [least_squares(), row(margin=0.1, budget=9), row(margin=0.1, budget=7), row(margin=0.0), row(kind="concave")]
    order = [
        rows.index({key: value for key, value in one.items() if key != "label"}) for one in ordered(labelled(rows))
    ]
    assert order == [3, 2, 1, 0, 4]


def test_a_setting_is_swept_where_one_method_has_several_values_of_it():
    rows = [row(method, margin=margin) for method in ("distance", "rigid") for margin in (0.0, 0.0005, 0.002)]
    assert swept(rows) == ["margin"]
    assert swept([row(), row("rigid", margin=0.1)]) == []
    (chart,) = (part for part in report(rows, "").parts if isinstance(part, Chart) and "margin" in part.title)
    assert chart.x.steps == (0.0, 0.0005, 0.002)
    svg = chart.svg()
    assert all(f">{label}<" in svg for label in ("0 m", "500 µm", "2 mm", "distance", "rigid"))


def test_the_best_value_of_a_swept_setting_is_that_with_most_hits_at_the_largest_budget():
    rows = [row(step_size=1.0, acc_1e6=0.9, budget=9), row(step_size=1.0, acc_1e6=0.5), row(step_size=2.0, acc_1e6=0.6)]
    assert [one["step_size"] for one in at_best(labelled(rows), "step_size")] == [2.0]
    many = [row(step_size=float(k), acc_1e6=0.5 + 0.01 * k) for k in range(1, MAX_LINES + 2)]
    (times,) = (part for part in report(many, "").parts if isinstance(part, Chart) and "CPU" in part.title)
    assert [one["step_size"] for one in times.rows] == [MAX_LINES + 1.0]


def test_misses_are_not_rounded_away():
    found = tables([row(acc_1e6=0.99999), row("rigid", acc_1e6=1.0)])["Results, convex bodies"]
    assert texts(found, "acc_1e6") == ["99.9", "100"]


def test_misses_are_drawn_down_to_half_a_target():
    (times,) = (part for part in report([row(acc_1e6=1.0)], "").parts if isinstance(part, Chart))
    missed = next(axis for axis in times.y if axis.key == "missed")
    assert missed.least == 0.5 / 200 and times.rows[0]["missed"] == 0.0


def test_tables_compare_what_belongs_together():
    found = tables(several())
    for kind in ("convex", "concave"):
        printed = found[kind]
        assert texts(printed, "label") == [
            "distance",
            "distance",
            "  face-face",
            "analytical",
            "analytical",
            "  face-face",
        ]
        assert texts(printed, "budget_label") == ["10", "100", "100", "10", "100", "100"]
        assert texts(printed, "acc_1e6") == ["62.0", "80.0", "1.0", "42.0", "60.0", "1.0"]
        assert texts(found[f"Results, {kind} bodies"], "acc_1e6") == ["62.0", "80.0", "42.0", "60.0"]
        assert texts(found[f"Results, {kind} bodies"], "budget_label") == ["10", "100", "10", "100"]


def test_patch_witnesses_are_shown_where_they_were_measured():
    both = [row(**patched()), least_squares(**patched(witness="patch"))]
    assert epsilons(both) == "10 µm"
    printed = tables(both)["convex"]
    assert texts(printed, "patch.acc_1e6") == ["98.7", "98.7"] and "10 µm" in printed.title
    keys = {column.key for column in tables([row()])["convex"].columns}
    assert "unfiltered.acc_1e6" in keys and "patch.acc_1e6" not in keys


@pytest.mark.parametrize("rows", [[row()], [row(targets=0, acc_1e6=None, acc_1e8=None, d5=None, d9=None)]])
def test_one_row_suffices(rows: list[dict[str, Any]]):
    page = report(rows, "").page(
        {"preset": None, "seed": 5, "problems": [], "invocation": "x", "cpu_s": 3.0, "engine": "native", "versions": {}}
        | {"machine": {"cpus": 2, "cpu": "a processor", "system": "Linux"}}
    )
    assert not re.search(r"\bnan\b|\bNone\b", page)
    assert ("90.0" in page) == (rows[0]["targets"] > 0)
