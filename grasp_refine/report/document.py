"""The JSON document of refined grasps: one object, SI units, what was not computed is null."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from grasp_refine.report.outcome import Outcome
from grasp_refine.report.writing import SCHEMA
from grasp_refine.solvers.status import Status
from grasp_refine.versions import versions


def run_document(
    outcome: Outcome, *, config: Mapping[str, Any], seed: int, wall_s: float, cpu_s: float
) -> dict[str, Any]:
    """The document of `run`: totals, and one entry per grasp.

    Args:
        outcome: All grasps.
        config: All settings.
        seed: Seed of everything that was drawn.
        wall_s: Wall time of the whole command, loading and decomposition included.
        cpu_s: Its CPU time.
    """
    return {
        "schema": SCHEMA,
        "command": "run",
        "versions": versions(),
        "config": config,
        "seed": seed,
        "totals": {
            "n": len(outcome),
            "converged": int((outcome.status == Status.CONVERGED).sum()),
            # Success is that of a simulation.
            "success_before": None,
            "success_after": None,
            "wall_s": wall_s,
            "cpu_s": cpu_s,
        },
        "grasps": [_grasp(outcome, i) for i in range(len(outcome))],
    }


def _grasp(outcome: Outcome, i: int) -> dict[str, Any]:
    status = Status(outcome.status[i])
    worst, mean = outcome.worst_error[i], outcome.mean_error[i]
    return {
        "index": outcome.index[i],
        "row": outcome.row[i],
        "object": outcome.object[i],
        "status": status.label,
        "advice": status.advice,
        "iterations": outcome.iterations[i],
        "queries": outcome.queries[i],
        "wall_s": outcome.wall_s[i],
        "cpu_s": outcome.cpu_s[i],
        "quality": None,
        "contact_error_m": {
            "before": {"max": worst[0], "mean": mean[0]},
            "after": {"max": worst[1], "mean": mean[1]},
        },
        "penetration_m": {"before": outcome.penetration[i, 0], "after": outcome.penetration[i, 1]},
        "self_penetration_m": {"before": outcome.self_penetration[i, 0], "after": outcome.self_penetration[i, 1]},
        "wrench_residual": None,
        "limits_violated": outcome.limits_violated[i],
        "moved": {
            "palm_m": outcome.palm_m[i],
            "palm_rad": outcome.palm_rad[i],
            "joints_rad": outcome.joints_rad[i],
        },
        "simulation": None,
    }


def settings(value: Any) -> Any:
    """A value as JSON can hold it; a dataclass says its `type`, because fields may hold one of several."""
    if is_dataclass(value):
        return {
            "type": type(value).__name__,
            **{field.name: settings(getattr(value, field.name)) for field in fields(value)},
        }
    return value
