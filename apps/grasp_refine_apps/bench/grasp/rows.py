"""Rows of results: one flat entry for each variant, set and kind of tasks, pooled, and for each object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from grasp_refine.core.array_records import join
from grasp_refine.refinement.solvers.status import Status
from grasp_refine_apps.bench.chart import Row, of_finite
from grasp_refine_apps.bench.grasp.measures import Measures
from grasp_refine_apps.bench.grasp.runner import GroupResult, SetResult, calls
from grasp_refine_apps.bench.grasp.variants import Variant
from grasp_refine_apps.bench.timing import cpu_share, split_stages

PARTS = split_stages("kinematics", "broad phase", "narrow phase", "derivative")
"""Parts of the CPU time that are measured separately."""

ERROR_LEVELS_M2 = {"acc_1e6": 1e-6, "acc_1e8": 1e-8}
"""Errors (m^2) below which every contact of a grasp must be."""
SHALLOW_DEPTH_M, SELF_DEPTH_M = 5e-5, 1e-5
"""Negligible penetration of the object, and of links in each other, in metres."""
DEEP_START_M, STUCK_DEPTH_M = 0.01, 5e-4
"""Depth (metres) from which a start counts as deep, and depth above which such a grasp did not escape."""


def rows(done: Sequence[SetResult]) -> list[Row]:
    """Return all rows of a run: for each job the pooled one, then one for each object."""
    return [row for one in done for row in _of_job(one)]


def _of_job(done: SetResult) -> list[Row]:
    by_object: dict[str, list[GroupResult]] = {}
    for part in done.parts:
        by_object.setdefault(part.tasks.object, []).append(part)
    groups = {"all": list(done.parts)} | (by_object if len(by_object) > 1 else {})
    task = done.task
    return [
        {
            "set": task.set,
            "hand": task.hand,
            "object": name,
            "task": task.kind,
            **task.variant.columns(),
            **_sizes(parts),
            **_statistics(parts, task.kind == "targets", task.variant),
            "grasps_per_s": _rate(done) if name == "all" else None,
            "cpu_share": cpu_share([part.watch for part in parts], PARTS),
        }
        for name, parts in groups.items()
    ]


def _sizes(parts: Sequence[GroupResult]) -> Row:
    """Sizes of the problems: means over all grasps."""
    touching = np.concatenate([part.touching.sum(axis=1) for part in parts])
    counts = [len(part.tasks) for part in parts]
    scenes = [part.tasks.scene for part in parts]
    return {
        "contacts_mean": float(touching.mean()),
        "joints": len(scenes[0].hand.joint_names),
        "pieces_mean": float(np.average([len(scene.object.body.pieces) for scene in scenes], weights=counts)),
    }


def _rate(done: SetResult) -> float | None:
    """Grasps per second of wall time, over all processes."""
    if done.span is None:
        return None
    return sum(len(part.tasks) for part in done.parts) / (done.span[1] - done.span[0])


def _statistics(parts: Sequence[GroupResult], aimed: bool, variant: Variant) -> Row:
    before, after, moved = (join(*(getattr(part, name) for part in parts)) for name in ("before", "after", "moved"))
    touching = np.concatenate([part.touching for part in parts])
    status, iterations, queries, cpu_s, wall_s, solver_cpu_s = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("status", "iterations", "queries", "cpu_s", "wall_s", "solver_cpu_s")
    )
    batch, several = variant.batch, sum(len(calls(len(part.tasks), variant)) for part in parts) > 1
    return {
        "grasps": len(status),
        "batch_mean": float(np.concatenate([[min(batch, len(p.tasks))] * len(p.tasks) for p in parts]).mean()),
        **contact_errors(after.contact_error, aimed),
        **_depths("before", before),
        **_depths("after", after),
        **_lengths("gap", np.abs(after.distance[touching]), "median", "p90", "worst"),
        **deep_starts(parts, aimed),
        "limits_violated": int(after.limits_violated.sum()),
        **{f"status_{one.name.lower()}": int((status == one).sum()) for one in Status if one != Status.RUNNING},
        "iterations_mean": float(iterations.mean()),
        "iterations_median": float(np.median(iterations)),
        "queries_mean": float(queries.mean()),
        "cpu_ms_per_grasp": 1e3 * float(cpu_s.mean()),
        # The grasps of a call share its time evenly: a single call has only a mean.
        "cpu_ms_per_grasp_median": 1e3 * float(np.median(cpu_s)) if several else None,
        "wall_ms_per_grasp": 1e3 * float(wall_s.mean()),
        "solver_cpu_ms_per_grasp": 1e3 * float(solver_cpu_s.mean()),
        **{
            f"moved_{name.replace('_', '_median_')}": of_finite(np.median, values)
            for name, values in vars(moved).items()
        },
    }


def contact_errors(error: np.ndarray, aimed: bool) -> Row:
    """Shares of grasps all of whose contacts are solved, and the median and worst of their worst contacts, in metres.

    Args:
        error: Errors (N, L) of contacts in square metres, NaN for links without a target.
        aimed: Whether there are targets.
    """
    names = (*ERROR_LEVELS_M2, "contact_error_median_m", "contact_error_worst_m")
    if not aimed:
        return dict.fromkeys(names)
    worst = np.where(np.isnan(error), -np.inf, error).max(axis=1)
    # A grasp whose targets could not be measured is not solved.
    worst = np.where(np.isinf(worst), np.inf, worst)
    solved = {name: float((worst < level).mean()) for name, level in ERROR_LEVELS_M2.items()}
    return {**solved, names[2]: float(np.sqrt(np.median(worst))), names[3]: float(np.sqrt(worst.max()))}


def deep_starts(parts: Sequence[GroupResult], aimed: bool) -> Row:
    """Count real grasps that start deep in the object, and how many did not escape."""
    if aimed:
        return {"deep_starts": None, "deep_stuck": None, "deep_stuck_grasps": None}
    deep, stuck = 0, []
    for part in parts:
        before, after = part.before.penetration, part.after.penetration
        deep += int((before >= DEEP_START_M).sum())
        for i in np.flatnonzero((before >= DEEP_START_M) & ~(after <= STUCK_DEPTH_M)):
            stuck.append(
                {
                    "object": part.tasks.object,
                    "index": int(part.tasks.index[i]),
                    "penetration_before_m": float(before[i]),
                    "penetration_after_m": float(after[i]),
                }
            )
    return {"deep_starts": deep, "deep_stuck": len(stuck), "deep_stuck_grasps": stuck}


def _depths(side: str, measures: Measures) -> Row:
    """Statistics of the penetration of the object, and of links in each other, before or after refinement."""
    deepest, own = measures.penetration, measures.self_penetration
    return {
        **_lengths(f"penetration_{side}", deepest, "mean", "median", "p95", "worst"),
        f"penetration_{side}_share_50um": float((deepest <= SHALLOW_DEPTH_M).mean()),
        **_lengths(f"self_penetration_{side}", own, "mean", "worst"),
        f"self_penetration_{side}_share_above_10um": float((~(own <= SELF_DEPTH_M)).mean()),
    }


STATISTICS: dict[str, Callable[[np.ndarray], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "p90": lambda values: np.quantile(values, 0.9, method="higher"),
    "p95": lambda values: np.quantile(values, 0.95, method="higher"),
    "worst": np.max,
}
"""Name in a key of a row -> statistic."""


def _lengths(name: str, values: np.ndarray, *statistics: str) -> Row:
    """Statistics of lengths (N,) in metres, None without any; an unmeasured length counts as the largest."""
    values = np.where(np.isnan(values), np.inf, values)
    return {f"{name}_{one}_m": float(STATISTICS[one](values)) if len(values) else None for one in statistics}
