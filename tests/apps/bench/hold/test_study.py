"""Rows: numbers that can be counted by hand, and what is shown of them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rich.console import Console

from grasp_refine.core.json_files import dumps
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.bench.hold.measure import GroupResult, Method
from grasp_refine_apps.bench.hold.study import HoldStudy, auc, rows

PROTOCOLS = ("dexgraspbench", "strict")
NAN = np.nan
AS_CAME, OWN_STAGES, GEOMETRY_ONLY = Method("as-came"), Method("own-stages"), Method("geometry-only", 1)
H, M, T = Reason.HELD, Reason.MOVED, Reason.ROTATED


def part(
    method: Method, name: str, easy: list[Reason], hard: list[Reason], cpu_s: float = NAN, quality: float = 0.5
) -> GroupResult:
    n = len(easy)
    ramp = np.arange(n, dtype=float)
    values = {
        "penetration_m": 1e-3 * ramp, "self_penetration_m": 1e-4 * ramp, "contact_gap_m": 1e-5 * ramp,
        "wrench_residual": 1e-2 * ramp, "quality": quality + 0.01 * ramp, "cpu_ms": 1e3 * cpu_s * (1.0 + ramp),
        "wall_ms": 2e3 * cpu_s * (1.0 + ramp), "stages_cpu_ms": np.full(n, NAN if method == AS_CAME else 30.0),
        "starts": np.full(n, NAN if method.starts is None else float(method.starts)),
    }  # fmt: skip
    moved = {"moved_palm_m": 0.01, "moved_palm_rad": 0.1, "moved_joints_rad": 0.2}
    values |= {name: np.full(n, NAN if method.starts is None else value) for name, value in moved.items()}
    return GroupResult(method, name, values, {"dexgraspbench": np.array(easy), "strict": np.array(hard)})


@pytest.fixture
def parts() -> list[GroupResult]:
    """Four grasps on a cup and one on a can, by three methods; of the cup three hold at first."""
    found = []
    for name, came, after, twice in (
        ("cup", [H, H, H, M], [H, T, H, H], [H, H, H, H]),
        ("can", [M], [M], [H]),
    ):
        bad = [M] * len(came)
        found += [
            part(AS_CAME, name, came, bad),
            part(OWN_STAGES, name, came, bad),
            part(GEOMETRY_ONLY, name, after, bad, 0.01),
            part(Method("forces", 6), name, twice, after, 0.1),
        ]
    return found


def test_what_holds_is_counted_pooled_and_by_object(parts: list[GroupResult]):
    found = rows(parts, PROTOCOLS)
    assert [row["object"] for row in found] == ["all", "cup", "can"] * 4
    came, own, geometry, forces = (row for row in found if row["object"] == "all")
    assert [row["success_dexgraspbench"] for row in (came, own, geometry, forces)] == [0.6, 0.6, 0.6, 1.0]
    assert [row["success_strict"] for row in (came, geometry, forces)] == [0.0, 0.0, 0.6]
    # Of the three that held, the second one is lost.
    assert [row["lost_dexgraspbench"] for row in (came, geometry, forces)] == [0.0, 1 / 3, 0.0]
    assert forces["lost_strict"] is None, "none held before"
    assert geometry["reasons_dexgraspbench"] == {"moved": 1, "rotated": 1} and forces["reasons_dexgraspbench"] == {}
    can = next(row for row in found if row["object"] == "can")
    assert (can["grasps"], can["success_dexgraspbench"], can["lost_dexgraspbench"]) == (1, 0.0, None)


def test_costs_are_as_in_all_grasps(parts: list[GroupResult]):
    came, own, geometry, forces = (row for row in rows(parts, PROTOCOLS) if row["object"] == "all")
    assert (came["method"], came["starts"], forces["method"], forces["starts"]) == ("as-came", None, "forces", 6)
    for name in ("cpu_ms_mean", "wall_ms_median", "moved_palm_median_m", "starts_mean"):
        assert came[name] is None and own[name] is None
    assert came["stages_cpu_ms"] is None and own["stages_cpu_ms"] == pytest.approx(30.0)
    # 10, 20, 30, 40 and 10 ms.
    assert (geometry["cpu_ms_mean"], geometry["cpu_ms_median"]) == pytest.approx((22.0, 20.0))
    assert geometry["wall_ms_mean"] == pytest.approx(44.0) and forces["starts_mean"] == 6.0
    assert geometry["moved_palm_median_m"] == 0.01 and geometry["moved_joints_median_rad"] == 0.2


def test_measures_are_pooled(parts: list[GroupResult]):
    row = rows(parts, PROTOCOLS)[0]
    # 0, 1, 2, 3 and 0 mm.
    assert row["penetration_mean_m"] == pytest.approx(1.2e-3) and row["penetration_q95_m"] == 3e-3
    assert row["self_penetration_max_m"] == pytest.approx(3e-4) and row["contact_gap_median_m"] == pytest.approx(1e-5)
    assert (row["wrench_residual_median"], row["wrench_residual_q75"]) == pytest.approx((0.01, 0.02))
    assert row["quality_median"] == pytest.approx(0.51)


def test_what_cannot_be_measured_counts_as_the_worst():
    bad = part(AS_CAME, "cup", [H, H], [H, H])
    bad.values["penetration_m"][:] = bad.values["wrench_residual"][:] = NAN
    (row,) = rows([bad], PROTOCOLS)
    assert row["penetration_mean_m"] == row["wrench_residual_median"] == np.inf
    assert json.loads(dumps(row))["penetration_mean_m"] is None


def test_auc_counts_pairs_in_the_right_order():
    score = np.array([0.9, 0.5, 0.5, 0.1])
    assert auc(score, np.array([True, True, False, False])) == (2 + 1.5) / 4
    assert auc(score, np.array([False, False, True, True])) == 0.5 / 4
    assert auc(score, np.array([True, False, False, False])) == 1.0
    assert auc(score, np.ones(4, dtype=bool)) is None and auc(score, np.zeros(4, dtype=bool)) is None


def test_auc_is_that_of_all_pairs():
    random = np.random.default_rng(0)
    score, success = random.integers(0, 9, 60) / 9.0, random.random(60) < 0.4
    pairs = np.subtract.outer(score[success], score[~success])
    assert auc(score, success) == pytest.approx(((pairs > 0) + 0.5 * (pairs == 0)).mean())


def test_tables_fit_into_a_terminal(parts: list[GroupResult]):
    longest = [
        part(one.method, f"core_{one.object}_523cddb320608c09a37f3fc191551700", [H] * 2, [H] * 2, 1.0) for one in parts
    ]
    console = Console(width=200)
    with console.capture() as capture:
        for shown in HoldStudy(ProblemSpec()).report(rows(longest, PROTOCOLS), ()).printed():
            console.print(shown)
    text = capture.get()
    assert max(map(len, map(str.rstrip, text.splitlines()))) <= 80
    assert text.count("100.0") > 8 and "6 starts" in text


def test_a_chart_has_a_level_for_what_is_not_refined(parts: list[GroupResult]):
    pytest.importorskip("matplotlib")
    chart, *_ = HoldStudy(ProblemSpec()).report(rows(parts, PROTOCOLS), ()).parts
    svg = chart.svg()
    assert all(name in svg for name in (*PROTOCOLS, "cup", "can", "strict, input grasps"))
