"""Rows: numbers that can be counted by hand, and who is pooled with whom."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from grasp_refine.measures.geometry import Movement
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.grasp.measures import Measures
from grasp_refine_apps.bench.grasp.rows import contact_errors, rows
from grasp_refine_apps.bench.grasp.runner import GroupResult, SetResult, SetTask
from grasp_refine_apps.bench.grasp.tasks import Tasks
from grasp_refine_apps.bench.grasp.variants import Kind, Variant

NAN = np.nan
# Of a scene, rows count joints and pieces only.
SCENES = {
    name: Mock(
        Scene,
        hand=SimpleNamespace(joint_names=("a", "b", "c")),
        object=SimpleNamespace(body=SimpleNamespace(pieces=(None,) * pieces)),
    )
    for name, pieces in (("cup", 7), ("can", 2))
}


def measures(depth: list[float], error: list[list[float]] | None = None, own: float = 0.0) -> Measures:
    n = len(depth)
    errors = np.full((n, 2), NAN) if error is None else np.array(error)
    points = np.zeros((n, 2, 3))
    return Measures(
        contact_error=errors,
        distance=np.array([[-d, 0.002] for d in depth]),
        penetration=np.array(depth),
        self_penetration=np.full(n, own),
        limits_violated=np.zeros(n, dtype=np.int64),
        point_link=points,
        point_object=points,
    )


def part(kind: Kind, name: str, before: Measures, after: Measures, cpu_s: list[float]) -> GroupResult:
    n = len(cpu_s)
    return GroupResult(
        tasks=Tasks(name, 1.0, SCENES[name], np.arange(10, 10 + n)),
        before=before,
        after=after,
        moved=Movement(np.full(n, 0.01), np.full(n, 0.1), np.full(n, 0.2), np.full(n, np.nan)),
        touching=np.tile([True, False], (n, 1)),
        status=np.full(n, Status.CONVERGED),
        iterations=np.arange(1, n + 1),
        queries=np.full(n, 7),
        cpu_s=np.array(cpu_s),
        wall_s=2.0 * np.array(cpu_s),
        solver_cpu_s=np.array(cpu_s),
    )


def done(kind: Kind, parts: list[GroupResult], variant: Variant | None = None) -> SetResult:
    task = SetTask(variant or Variant(), "set", "hand", kind, tuple(p.tasks for p in parts), 0, 1e-10, 1)
    return SetResult(task, tuple(parts))


@pytest.fixture
def nothing() -> SetResult:
    """Five real grasps on two objects; three start deep, of which one is freed."""
    cup = part("nothing", "cup", measures([0.02, 0.012, 0.001]), measures([0.02, 4e-4, 0.0]), [1e-3, 2e-3, 9e-3])
    can = part("nothing", "can", measures([0.01, 0.0]), measures([6e-4, 5e-5], own=2e-5), [1e-3, 2e-3])
    return done("nothing", [cup, can])


def test_a_grasp_counts_when_all_its_contacts_do():
    error = np.array([[1e-7, NAN], [2e-6, 1e-12], [1e-9, 4e-9], [9e-9, 9e-7]])
    found = contact_errors(error, aimed=True)
    assert (found["acc_1e6"], found["acc_1e8"]) == (0.75, 0.25)
    assert found["contact_error_worst_m"] == pytest.approx(2e-6**0.5)
    assert found["contact_error_median_m"] == pytest.approx(((1e-7 + 9e-7) / 2) ** 0.5)
    nobody = contact_errors(np.full((2, 2), NAN), aimed=True)
    assert (nobody["acc_1e6"], nobody["contact_error_worst_m"]) == (0.0, np.inf)
    assert set(contact_errors(error, aimed=False).values()) == {None}


def test_deep_starts_are_counted_and_named_if_they_stay(nothing: SetResult):
    pooled, cup, can = rows([nothing])
    assert [row["object"] for row in (pooled, cup, can)] == ["all", "cup", "can"]
    assert [(row["deep_starts"], row["deep_stuck"]) for row in (pooled, cup, can)] == [(3, 2), (2, 1), (1, 1)]
    assert [(one["object"], one["index"]) for one in pooled["deep_stuck_grasps"]] == [("cup", 10), ("can", 10)]
    assert can["deep_stuck_grasps"][0]["penetration_after_m"] == 6e-4


def test_depths_are_as_in_all_grasps(nothing: SetResult):
    row = rows([nothing])[0]
    assert row["grasps"] == 5
    assert row["penetration_before_mean_m"] == pytest.approx((0.02 + 0.012 + 0.001 + 0.01) / 5)
    assert row["penetration_after_worst_m"] == row["penetration_after_p95_m"] == 0.02
    assert row["penetration_after_share_50um"] == 0.4
    assert row["self_penetration_after_share_above_10um"] == 0.4
    # Of the link that should touch only.
    assert row["gap_median_m"] == pytest.approx(4e-4) and row["gap_worst_m"] == 0.02
    assert row["acc_1e6"] is None
    assert row["status_converged"] == 5 and row["status_stalled"] == 0 and "status_running" not in row


def test_times_are_means_and_their_median_is_reported_where_there_are_several_calls(nothing: SetResult):
    pooled, cup, _ = rows([nothing])
    assert pooled["cpu_ms_per_grasp"] == pytest.approx(3.0)
    # One call for each object.
    assert pooled["cpu_ms_per_grasp_median"] == pytest.approx(2.0) and cup["cpu_ms_per_grasp_median"] is None
    single = done("nothing", list(nothing.parts), Variant(batch=1))
    row, cup, _ = rows([single])
    assert row["cpu_ms_per_grasp"] == pytest.approx(3.0) and row["wall_ms_per_grasp"] == pytest.approx(6.0)
    assert row["cpu_ms_per_grasp_median"] == pytest.approx(2.0) and cup["cpu_ms_per_grasp_median"] is not None
    assert (row["batch"], row["batch_mean"]) == (1, 1.0)
    # Three and two grasps cannot fill a batch of 64.
    assert rows([nothing])[0]["batch_mean"] == pytest.approx((3 * 3 + 2 * 2) / 5)


def targets(variant: Variant, error: float, cpu_s: float) -> SetResult:
    after = measures([0.0, 0.0], [[error, NAN], [error, error / 4]])
    return done("targets", [part("targets", "cup", measures([0.02, 0.0]), after, [cpu_s, cpu_s])], variant)


@pytest.fixture
def found(nothing: SetResult) -> list[dict[str, Any]]:
    """Rows of two solvers at two budgets each, with targets, and of the real grasps."""
    made = [
        targets(Variant(solver, budget=budget), error, cpu)
        for solver, budget, error, cpu in (
            ("levenberg-marquardt", 10, 1e-4, 1e-3),
            ("levenberg-marquardt", 20, 1e-20, 2e-3),
            ("adam", 100, 1e-3, 0.1),
            ("adam", 200, 4e-7, 0.2),
        )
    ]
    return rows([nothing, *made])


def test_sizes_rates_and_shares_are_as_in_all_grasps(nothing: SetResult):
    for one, seconds in zip(nothing.parts, (1.0, 3.0), strict=True):
        one.watch.spent["kinematics"].cpu_s, one.watch.spent["forces"].cpu_s = seconds, 1.0
    all_objects, cup, _ = rows([replace(nothing, span=(10.0, 12.5))])
    assert (all_objects["joints"], all_objects["contacts_mean"]) == (3, 1.0)
    assert (all_objects["pieces_mean"], cup["pieces_mean"]) == (pytest.approx((3 * 7 + 2 * 2) / 5), 7.0)
    assert (all_objects["grasps_per_s"], cup["grasps_per_s"]) == (2.0, None)
    assert list(all_objects["cpu_share"]) == ["kinematics", "broadphase", "narrowphase", "derivative", "solver"]
    assert all_objects["cpu_share"]["kinematics"] == pytest.approx(4.0 / 6.0) and cup["cpu_share"]["solver"] == 0.5
    assert rows([nothing])[0]["grasps_per_s"] is None
