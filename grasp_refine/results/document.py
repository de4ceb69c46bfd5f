"""JSON document of refined grasps: one object, SI units; values that were not computed are null."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from grasp_refine.collision.engine import chosen
from grasp_refine.core.json_files import SCHEMA
from grasp_refine.core.versions import versions
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.profile import Profile, profile_entry
from grasp_refine.results.simulated import SimulatedGrasps, simulation_entry
from grasp_refine.results.verdict import advice, should_hold


def run_document(
    outcome: Outcome,
    refined: Config,
    simulated: SimulatedGrasps | None = None,
    *,
    config: Mapping[str, Any],
    wall_s: float,
    cpu_s: float,
    profile: Profile | None = None,
) -> dict[str, Any]:
    """Return the document of `run`: totals, and one entry per grasp.

    Args:
        outcome: All grasps.
        refined: Settings of their refinement.
        simulated: The grasps in simulation; None: not simulated.
        config: All settings of the command.
        wall_s: Wall time of the whole command in seconds, loading and decomposition included.
        cpu_s: CPU time of the whole command in seconds.
        profile: Time by stage; None: not measured.
    """
    return {
        "schema": SCHEMA,
        "command": "run",
        "versions": versions(),
        "engine": chosen("auto"),
        "config": config,
        "seed": refined.seed,
        "totals": {
            "n": len(outcome),
            "converged": int((outcome.status == Status.CONVERGED).sum()),
            "good_before": int(should_hold(outcome.quality[:, 0]).sum()),
            "good_after": int(should_hold(outcome.quality[:, 1]).sum()),
            "success_before": None if simulated is None else int(simulated.before.success.sum()),
            "success_after": None if simulated is None else int(simulated.after.success.sum()),
            "wall_s": wall_s,
            "cpu_s": cpu_s,
        },
        "profile": profile_entry(profile),
        "grasps": [_grasp(outcome, simulated, i, text) for i, text in enumerate(advice(outcome, refined))],
    }


def _grasp(outcome: Outcome, simulated: SimulatedGrasps | None, i: int, advice: str) -> dict[str, Any]:
    worst, mean = outcome.worst_error[i], outcome.mean_error[i]
    return {
        "index": outcome.index[i],
        "row": outcome.row[i],
        "object": outcome.object[i],
        "status": Status(outcome.status[i]).label,
        "advice": advice,
        "starts": outcome.starts[i],
        "iterations": outcome.iterations[i],
        "queries": outcome.queries[i],
        "wall_s": outcome.wall_s[i],
        "cpu_s": outcome.cpu_s[i],
        "quality": {"before": outcome.quality[i, 0], "after": outcome.quality[i, 1]},
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
            "before": None if simulated is None else simulation_entry(simulated.before, i, simulated.protocol),
            "after": None if simulated is None else simulation_entry(simulated.after, i, simulated.protocol),
        },
    }


def settings(value: Any) -> Any:
    """Return a value for JSON; a dataclass gets an entry `type`, because fields may hold one of several types."""
    if is_dataclass(value):
        return {
            "type": type(value).__name__,
            **{field.name: settings(getattr(value, field.name)) for field in fields(value)},
        }
    return value
