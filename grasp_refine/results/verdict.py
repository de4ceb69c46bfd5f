"""Verdicts on grasps by quality, which is an estimate, and by simulation, with advice on grasps that may slip."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import isfinite

import numpy as np
from rich.text import Text

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.plurals import whole
from grasp_refine.forces.quality import CONFIDENCE
from grasp_refine.measures.formulas import COSTLY_M
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.phases import CLOSE
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome

HOLDS = CONFIDENCE
"""Quality, the estimated probability of holding, from which on a grasp should hold: what refinement aims at."""

BAR = f"{HOLDS:g} or more"
"""`HOLDS` in words."""


REGION_ADVICE = "sample grasps there (`grasps='sample:N'`), try more `starts`, or widen the region"
"""Advice on grasps that touch where they should not."""


def should_hold(quality: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Return True where a grasp (N,) should hold; False without a quality."""
    return np.nan_to_num(quality) >= HOLDS


def is_unseen(outcome: Outcome) -> Bool[np.ndarray, " N"]:
    """Return True for refined grasps (N,) that should hold a scanned object if it is what it seems, but may not be."""
    return ~should_hold(outcome.quality[:, 1]) & should_hold(outcome["likely_quality"][:, 1])


def touches_outside(outcome: Outcome) -> Bool[np.ndarray, "N 2"]:
    """Return True where a grasp touches the object outside of the regions, before and after (N, 2)."""
    return outcome.usable[:, None] & (outcome["region_miss_m"] > COSTLY_M[0])


def slip_advice(config: Config) -> str:
    """Return advice on grasps that may slip."""
    if config.holds:
        ways = ["more `starts`"]
        if config.max_move != MaxMove():
            ways.append("a wider `max_move`")
        if config.freeze:
            ways.append("fewer parts in `freeze`")
        if isfinite(config.seconds):
            ways.append("more `seconds`")
        return f"try {', '.join(ways)}, or other grasps"
    if not config.solver.needs_autograd:
        return "only their geometry was refined, forces were not balanced"
    return f"forces are balanced with `solver` levenberg-marquardt only, {type(config.solver).__name__.lower()} cannot"


def status_advice(status: Status, config: Config) -> str:
    """Return advice on a refinement with this status; empty when there is nothing to do."""
    if status == Status.BUDGET and isfinite(config.seconds):
        return "the time or the iterations ran out while the loss still fell: raise `seconds`, or refine it again"
    if status == Status.BUDGET and config.holds and config.solver.iterations >= CLOSE.iterations:
        return "gaps were still closing when the iterations of a start ran out: refine the result again"
    limits = [name for name in ("max_move", "freeze") if getattr(config, name) != getattr(Config(), name)]
    if status == Status.STALLED and limits:
        return f"{status.advice}; it may be {' or '.join(f'`{name}`' for name in limits)} that stops it"
    return status.advice


def advice(outcome: Outcome, config: Config) -> list[str]:
    """Return advice on each of N grasps."""
    slips = outcome.usable & ~should_hold(outcome.quality[:, 1]) & config.holds
    outside, unseen = touches_outside(outcome)[:, 1], is_unseen(outcome)
    texts = []
    each = zip(outcome.status, slips, outside, unseen, outcome.weakness.tolist(), strict=True)
    for status, slip, miss, hidden, weakness in each:
        parts = [status_advice(Status(status), config)]
        if miss:
            parts.append(f"{weakness}: {REGION_ADVICE}")
        elif hidden:
            parts.append(f"not seen: {weakness}")
        elif slip:
            why = f" ({weakness})" if weakness else ""
            parts.append(f"may slip{why}: {slip_advice(config)}")
        texts.append("; ".join(filter(None, parts)))
    return texts


def estimate_line(good: int, before: int | None, count: int) -> Text:
    """Return a line on the number of `count` grasps with a quality of `HOLDS` or more, now and, if known, before."""
    color = "green" if good == count else "yellow"
    numbers = f"{'' if before is None else f'{whole(before)} → '}{whole(good)} of {whole(count)}"
    hint = "" if before is None else "; `validate` simulates"
    return Text.assemble(f"quality {BAR} (an estimate): ", (numbers, color), hint)


def held_line(protocol: str, held: tuple[int, int], gained: int, lost: int, count: int) -> Text:
    """Return a line on the number of `count` grasps that held in simulation, before and after, gained and lost."""
    color = "green" if held[1] >= held[0] else "red"
    how = f" ({protocol})" if protocol else ""
    text = f"held in simulation{how}: {whole(held[0])} → {whole(held[1])} of {whole(count)}"
    return Text.assemble((text, color), f"; gained {whole(gained)}, lost {whole(lost)}")


@dataclass(frozen=True)
class Agreement:
    """Agreement of quality and simulation on some grasps."""

    good: int = 0
    """Number of grasps with a quality of `HOLDS` or more."""
    good_held: int = 0
    """Number of these that held in simulation."""
    others: int = 0
    """Number of grasps with a lower quality, or without one."""
    others_held: int = 0
    """Number of these that held in simulation."""

    @staticmethod
    def of(good: Bool[np.ndarray, " N"], held: Bool[np.ndarray, " N"]) -> Agreement:
        """Return the agreement on N grasps, given which have a quality of `HOLDS` or more, and which held."""
        counts = (good, good & held, ~good, ~good & held)
        return Agreement(*(int(count.sum()) for count in counts))

    @property
    def count(self) -> int:
        """Number of grasps."""
        return self.good + self.others

    @property
    def held(self) -> int:
        """Number of grasps that held in simulation."""
        return self.good_held + self.others_held

    def __add__(self, other: Agreement) -> Agreement:
        """Return the agreement on the grasps of both."""
        return Agreement(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def line(self, when: str = "") -> Text:
        """Return the agreement in words, such as: quality 0.952 or more (an estimate): 1 of 4, which held."""
        text = f"{when}quality {BAR} (an estimate): {whole(self.good)} of {whole(self.count)}"
        failed = self.good - self.good_held
        if self.good:
            which = "which" if self.good == 1 else f"{whole(failed)} of which" if failed else "all of which"
            text += f", {which} {'did not hold' if failed else 'held'}"
        if self.others == 1:
            text += f"; the other {'held' if self.others_held else 'did not hold'}"
        elif self.others:
            text += f"; {whole(self.others_held)} of the {whole(self.others)} others held"
        return Text(text)
