"""JSON document of refined grasps: one object, SI units; values that were not computed are null."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from grasp_refine.collision.engine import chosen
from grasp_refine.core.json_files import SCHEMA
from grasp_refine.core.machine import machine
from grasp_refine.core.versions import versions
from grasp_refine.measures.measures import RECORDED, SIDES
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.term import Term
from grasp_refine.results.changed import Changed
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.profile import Profile, profile_entry
from grasp_refine.results.simulated import SimulatedGrasps, engine_entries, simulation_entry
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
    values, texts = outcome.entries(), outcome.texts()
    forces = None if outcome.forces is None else outcome.forces.flat()
    return {
        "schema": SCHEMA,
        "command": "run",
        "versions": versions(),
        "machine": machine(),
        "engine": chosen("auto"),
        "config": config,
        "seed": refined.seed,
        "totals": {
            "n": len(outcome),
            "converged": int((outcome.status == Status.CONVERGED).sum()),
            "good_before": int(should_hold(outcome.quality[:, 0]).sum()),
            "good_after": int(should_hold(outcome.quality[:, 1]).sum()),
            **Changed.of(outcome, refined.confidence).entry(),
            "success_before": None if simulated is None else int(simulated.before.success.sum()),
            "success_after": None if simulated is None else int(simulated.after.success.sum()),
            "wall_s": wall_s,
            "cpu_s": cpu_s,
        },
        "profile": profile_entry(profile),
        "grasps": [
            {
                "index": outcome.index[i],
                "row": outcome.row[i],
                "object": outcome.object[i],
                **{name: values[i] for name, values in texts.items()},
                "advice": text,
                **measure_entries(values, i),
                "forces": None if forces is None else forces.of_grasp(i),
                "simulation": dict.fromkeys(SIDES)
                if simulated is None
                else {
                    side: simulation_entry(getattr(simulated, side), i, simulated.protocol)
                    | engine_entries(getattr(simulated, f"in_{side}"), i, simulated.protocol)
                    for side in SIDES
                },
            }
            for i, text in enumerate(advice(outcome, refined))
        ],
    }


def measure_entries(values: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the measures of one grasp for JSON, SI units.

    Args:
        values: Entries of a result file.
        i: Row of the grasp in them.
    """

    def at(entry: str) -> Any:
        return values[entry][i] if entry in values else None

    return {
        measure.name: {side: at(entry) for side, entry in measure.entries.items()}
        if measure.compared
        else at(measure.name)
        for measure in RECORDED
    }


def settings(value: Any) -> Any:
    """Return a value for JSON; a dataclass gets an entry `type`, because fields may hold one of several types."""
    if is_dataclass(value):
        return {
            "type": type(value).__name__,
            **{field.name: settings(getattr(value, field.name)) for field in fields(value)},
        }
    if isinstance(value, Term):
        return {"type": type(value).__name__, "weight": value.weight}
    return [*map(settings, value)] if isinstance(value, tuple) else value
