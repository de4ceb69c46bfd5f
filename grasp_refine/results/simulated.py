"""Simulated grasps before and after their refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Group
from rich.text import Text

from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Bool
from grasp_refine.results.console import html_of
from grasp_refine.results.verdict import Agreement, held_line, should_hold
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engine_table import ENGINES, EngineName
from grasp_refine.validation.robustness import SEED
from grasp_refine.validation.trials import NUMBERS, Reason, Trials


@dataclass(frozen=True, eq=False)
class SimulatedGrasps:
    """N grasps in simulation, input and refined."""

    protocol: Protocol
    """Protocol of the simulation."""
    in_before: Mapping[EngineName, Trials]
    """Name of each engine -> trials of the input grasps in it."""
    closing: Mapping[str, str]
    """Source of the input grasps' pregrasps and squeezes: stage -> "file" or "own"."""
    in_after: Mapping[EngineName, Trials]
    """Name of each engine -> trials of the refined grasps in it, with our own pregrasps and squeezes."""

    @property
    def before(self) -> Trials:
        """Trials of the input grasps in the first engine, which decides."""
        return next(iter(self.in_before.values()))

    @property
    def after(self) -> Trials:
        """Trials of the refined grasps in the first engine, which decides."""
        return next(iter(self.in_after.values()))

    @property
    def held(self) -> Bool[np.ndarray, "N 2"]:
        """True where a grasp held, before and after (N, 2)."""
        return np.stack([self.before.success, self.after.success], axis=1)

    def lines(self) -> list[Text]:
        """Return lines on the number of grasps that held before and after, and the reasons of failures."""
        before, after = self.held.T
        changed = int((after & ~before).sum()), int((before & ~after).sum())
        held = held_line(self.protocol.label, (int(before.sum()), int(after.sum())), *changed, len(after))
        return [held, *reason_lines(self.after, self.protocol), *self._other_engines()]

    def _other_engines(self) -> list[Text]:
        """Return a line on each engine but the first."""
        return [
            Text(
                f"in {ENGINES[name].title}: {self.in_before[name].success.sum()} → {after.success.sum()} held, "
                f"{(after.success == self.after.success).mean():.0%} as in {ENGINES[next(iter(self.in_after))].title}"
            )
            for name, after in list(self.in_after.items())[1:]
        ]

    def select(self, rows: np.ndarray) -> SimulatedGrasps:
        """Return the grasps `rows`, in that order."""
        return replace(self, in_before=take(self.in_before, rows), in_after=take(self.in_after, rows))

    def __repr__(self) -> str:
        before, after = self.held.sum(axis=0)
        return f"{type(self).__name__}({self.protocol.name}: {before} → {after} of {len(self.held)} held)"

    def __str__(self) -> str:
        return "\n".join(line.plain for line in self.lines())

    def _repr_html_(self) -> str:
        """Return the lines as HTML, for a notebook."""
        return html_of(Group(*self.lines()))


def reason_lines(trials: Trials, protocol: Protocol) -> list[Text]:
    """Return lines on the number of grasps that failed, by reason."""
    outcome = trials.outcome
    joints = {Reason.HAND_UNSTABLE: f" ({', '.join(trials.runaways)})"}
    return [
        Text.assemble((f"{(outcome == reason).sum()} {reason.label}", "red"), f"{joints.get(reason, '')}: {meaning}")
        for reason, meaning in ((reason, reason.meaning(protocol)) for reason in list(Reason)[1:])
        if (outcome == reason).any()
    ]


def closing_line(owners: Mapping[str, str]) -> Text:
    """Return a line on the source of pregrasps and squeezes, given as stage -> "file" or "own"."""
    words = {"file": "of the file", "own": "our own"}
    if len(set(owners.values())) == 1:
        return Text(f"pregrasps and squeezes are {words[owners['squeeze']]}")
    return Text(f"pregrasps are {words[owners['pregrasp']]}, squeezes {words[owners['squeeze']]}")


def simulation_lines(simulated: SimulatedGrasps, quality: np.ndarray) -> list[Text]:
    """Return `SimulatedGrasps.lines` and lines on the agreement with quality (N, 2)."""
    before, after = simulated.held.T
    return [
        *simulated.lines(),
        Agreement.of(should_hold(quality[:, 0]), before).line("before, "),
        Agreement.of(should_hold(quality[:, 1]), after).line("after, "),
    ]


def simulation_entry(trials: Trials, i: int, protocol: Protocol) -> dict[str, Any]:
    """Return the trials of one grasp for JSON; SI units."""
    worst = trials.worst[i]
    directions = [
        {
            "direction": direction,
            "reason": Reason(trials.reason[i, d]).label,
            **{name: getattr(trials, name)[i, d] for name in NUMBERS},
            "contacts": _names(trials, trials.contacts[i, d]),
        }
        for d, direction in enumerate(trials.directions)
    ]
    return {
        "protocol": protocol.name,
        "rule": protocol.rule,
        "success": trials.success[i],
        "label": None if trials.label is None else trials.label[i],
        **directions[worst],
        "reason": Reason(trials.outcome[i]).label,
        "runaway_joint": None if trials.runaway is None else trials.runaway[i] or None,
        "directions": directions,
        "closing": {
            "displacement_m": trials.closing_m[i],
            "angle_rad": trials.closing_rad[i],
            "pregrasp_penetration_m": trials.penetration_m[i],
            "contacts_grasp": _names(trials, trials.contacts_grasp[i]),
            "contacts_squeeze": _names(trials, trials.contacts_squeeze[i]),
        },
        **(
            {}
            if trials.pushed_m is None
            else {"pushed_m": dict(zip(trials.neighbours, trials.pushed_m[i].tolist(), strict=True))}
        ),
    }


def engine_entries(engines: Mapping[EngineName, Trials], i: int, protocol: Protocol) -> dict[str, Any]:
    """Return the verdict of each engine on one grasp for JSON, and the trials in all but the first, which decides."""
    certificate = {
        name: {
            "held": trials.success[i],
            "reason": Reason(trials.outcome[i]).label,
            "version": ENGINES[name].version,
            "protocol": protocol.name,
            "seed": SEED,
        }
        for name, trials in engines.items()
    }
    further = list(engines.items())[1:]
    return {
        "certificate": certificate,
        "engines": {name: simulation_entry(trials, i, protocol) for name, trials in further},
    }


def _names(trials: Trials, touching: np.ndarray) -> list[str]:
    return [trials.links[link] for link in np.flatnonzero(touching)]
