"""The JSON document of refined grasps: one object, SI units, what was not computed is null."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from grasp_refine.report.outcome import Outcome
from grasp_refine.report.proof import Proof, simulation_entry
from grasp_refine.report.writing import SCHEMA
from grasp_refine.solvers.status import Status
from grasp_refine.versions import versions


def run_document(
    outcome: Outcome, proof: Proof | None = None, *, config: Mapping[str, Any], seed: int, wall_s: float, cpu_s: float
) -> dict[str, Any]:
    """The document of `run`: totals, and one entry per grasp.

    Args:
        outcome: All grasps.
        proof: What simulation says of them, where it was asked.
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
            "success_before": None if proof is None else int(proof.before.success.sum()),
            "success_after": None if proof is None else int(proof.after.success.sum()),
            "wall_s": wall_s,
            "cpu_s": cpu_s,
        },
        "grasps": [_grasp(outcome, proof, i) for i in range(len(outcome))],
    }


def _grasp(outcome: Outcome, proof: Proof | None, i: int) -> dict[str, Any]:
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
        "wrench_residual": {"before": outcome.wrench_residual[i, 0], "after": outcome.wrench_residual[i, 1]},
        "limits_violated": outcome.limits_violated[i],
        "moved": {
            "palm_m": outcome.palm_m[i],
            "palm_rad": outcome.palm_rad[i],
            "joints_rad": outcome.joints_rad[i],
        },
        "simulation": {
            "before": None if proof is None else simulation_entry(proof.before, i, proof.protocol),
            "after": None if proof is None else simulation_entry(proof.after, i, proof.protocol),
        },
    }


def settings(value: Any) -> Any:
    """A value as JSON can hold it; a dataclass says its `type`, because fields may hold one of several."""
    if is_dataclass(value):
        return {
            "type": type(value).__name__,
            **{field.name: settings(getattr(value, field.name)) for field in fields(value)},
        }
    return value
