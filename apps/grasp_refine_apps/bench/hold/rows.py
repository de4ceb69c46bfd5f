"""Rows of results: one flat entry for each method, pooled, and for each object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from grasp_refine.validation.trials import Reason
from grasp_refine_apps.bench.hold.measures import Measures
from grasp_refine_apps.bench.hold.runner import GroupResult

Row = dict[str, Any]


def column(name: str, setting: str) -> str:
    """Key of a number of a simulation setting."""
    return f"{name}_{setting.replace('-', '_')}"


def rows(parts: Sequence[GroupResult], settings: Sequence[str]) -> list[Row]:
    """Return all rows of a run: for each method the pooled one, then, of several objects, one for each.

    Args:
        parts: Results of the methods, which are the same, in the same order, for each group of grasps; the first method
            decides which grasps held before.
        settings: Names of the simulation settings.
    """
    methods = list(dict.fromkeys(part.method for part in parts))
    objects = list(dict.fromkeys(part.object for part in parts))
    found = []
    for method in methods:
        for name in ("all", *(objects if len(objects) > 1 else ())):
            before, after = (
                [part for part in parts if part.method == one and name in ("all", part.object)]
                for one in (methods[0], method)
            )
            found.append(
                {
                    "method": method.name,
                    "starts": method.starts,
                    "label": method.label,
                    "object": name,
                    **_statistics(before, after, settings),
                }
            )
    return found


def _statistics(before: Sequence[GroupResult], after: Sequence[GroupResult], settings: Sequence[str]) -> Row:
    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in after])

    measures = Measures(
        *(np.concatenate([getattr(part.measures, field.name) for part in after]) for field in fields(Measures))
    )
    refined = after[0].method.starts is not None
    moved = {
        f"moved_{name.replace('_', '_median_')}": _median(
            np.concatenate([getattr(part.moved, name) for part in after]) if refined else np.empty(0)
        )
        for name in ("palm_m", "palm_rad", "joints_rad")
    }
    cpu, wall = 1e3 * joined("cpu_s"), 1e3 * joined("wall_s")
    # Grasps that could not be measured count as the worst.
    depth, own, residual = (
        np.nan_to_num(values, nan=np.inf)
        for values in (measures.penetration_m, measures.self_penetration_m, measures.wrench_residual)
    )
    return {
        "grasps": len(depth),
        **_verdicts(before, after, settings, measures.quality),
        "cpu_ms_median": _median(cpu),
        "cpu_ms_mean": _mean(cpu),
        "wall_ms_median": _median(wall),
        "wall_ms_mean": _mean(wall),
        "stages_cpu_ms": _mean(1e3 * joined("stages_cpu_s")),
        "penetration_mean_m": float(depth.mean()),
        "penetration_q95_m": float(np.quantile(depth, 0.95, method="higher")),
        "self_penetration_max_m": float(own.max()),
        "contact_gap_median_m": _median(measures.contact_gap_m),
        "wrench_residual_median": float(np.median(residual)),
        "wrench_residual_q75": float(np.quantile(residual, 0.75, method="higher")),
        **moved,
        "quality_median": float(np.median(measures.quality)),
        "starts_mean": _mean(joined("starts")),
    }


def _verdicts(
    before: Sequence[GroupResult], after: Sequence[GroupResult], settings: Sequence[str], quality: np.ndarray
) -> Row:
    """Outcome of the simulation by setting, and how well the quality predicts it."""
    found: dict[str, Row] = {name: {} for name in ("success", "lost", "auc", "reasons")}
    for setting in settings:
        first, reason = (np.concatenate([part.reason[setting] for part in parts]) for parts in (before, after))
        held_before, held = first == Reason.HELD, reason == Reason.HELD
        found["success"][column("success", setting)] = float(held.mean())
        lost = float((~held[held_before]).mean()) if held_before.any() else None
        found["lost"][column("lost", setting)] = lost
        found["auc"][column("auc", setting)] = auc(quality, held)
        found["reasons"][column("reasons", setting)] = {
            one.label: int((reason == one).sum()) for one in Reason if one != Reason.HELD and (reason == one).any()
        }
    return {key: value for columns in found.values() for key, value in columns.items()}


def auc(score: np.ndarray, success: np.ndarray) -> float | None:
    """Probability that a random success has a higher score than a random failure; ties count half.

    Args:
        score: Scores (N,).
        success: True for successes (N,).

    Returns:
        The area under the curve of hits against false alarms; None where all or none are successes.
    """
    yes, no = score[success], score[~success]
    if not len(yes) or not len(no):
        return None
    order = np.sort(no)
    below, upto = np.searchsorted(order, yes, "left"), np.searchsorted(order, yes, "right")
    return float((below + upto).mean() / (2 * len(no)))


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None
