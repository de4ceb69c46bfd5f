"""What simulation says of refined grasps, before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.text import Text

from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.trials import Reason, Trials


@dataclass(frozen=True, eq=False)
class Proof:
    """The same N grasps in simulation, as they came and refined."""

    protocol: Protocol
    """How they were simulated."""
    before: Trials
    """The grasps as they came."""
    after: Trials
    """The refined grasps, with pregrasps and squeezes of their own."""


def proof_lines(proof: Proof) -> list[Text]:
    """How many grasps held before and after, and why the others did not."""
    before, after = proof.before.success, proof.after.success
    color = "green" if after.sum() >= before.sum() else "red"
    lines = [
        Text.assemble(
            (f"held in simulation: {before.sum()} → {after.sum()} of {len(after)}", color),
            f" ({proof.protocol.name}; {int((after & ~before).sum())} won, {int((before & ~after).sum())} lost)",
        )
    ]
    worst = proof.after.reason[np.arange(len(after)), proof.after.worst]
    for reason in list(Reason)[1:]:
        count = int((worst == reason).sum())
        if count:
            lines.append(Text.assemble((f"{count} {reason.label}", "yellow"), f": {reason.meaning(proof.protocol)}"))
    return lines


def simulation_entry(trials: Trials, i: int, protocol: Protocol) -> dict[str, Any]:
    """What simulation says of one grasp, for JSON; SI units."""
    worst = trials.worst[i]
    directions = [
        {
            "direction": direction,
            "reason": Reason(trials.reason[i, d]).label,
            "time_s": trials.time_s[i, d],
            "displacement_m": trials.displacement_m[i, d],
            "angle_rad": trials.angle_rad[i, d],
            "contacts": _names(trials, trials.contacts[i, d]),
        }
        for d, direction in enumerate(trials.directions)
    ]
    return {
        "setting": protocol.name,
        "success": trials.success[i],
        **directions[worst],
        "directions": directions,
        "closing": {
            "displacement_m": trials.closing_m[i],
            "angle_rad": trials.closing_rad[i],
            "pregrasp_penetration_m": trials.penetration_m[i],
            "contacts_grasp": _names(trials, trials.contacts_grasp[i]),
            "contacts_squeeze": _names(trials, trials.contacts_squeeze[i]),
        },
    }


def _names(trials: Trials, touching: np.ndarray) -> list[str]:
    return [trials.links[link] for link in np.flatnonzero(touching)]
