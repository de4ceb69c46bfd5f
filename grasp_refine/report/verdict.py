"""Whether grasps should hold, by their quality, and what a user can do about those that may slip."""

from __future__ import annotations

from math import isfinite

import numpy as np
from jaxtyping import Bool, Float
from rich.text import Text

from grasp_refine.config import Config
from grasp_refine.holding import CLOSE, GOOD
from grasp_refine.max_move import MaxMove
from grasp_refine.report.outcome import Outcome
from grasp_refine.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.solvers.status import Status

HOLDS = 1.0 / (1.0 + GOOD)
"""A grasp of this quality or better should hold."""

BAR = f"{HOLDS:.3f} or more"
"""The same in words."""


def should_hold(quality: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Which grasps (N,) should hold; those without a quality should not."""
    return np.nan_to_num(quality) >= HOLDS


def made_to_hold(outcome: Outcome, config: Config) -> bool:
    """Whether the refinement was to make grasps hold, and not just to touch, or to reach targets."""
    return config.holds and not outcome.aimed.any()


def slip_advice(outcome: Outcome, config: Config) -> str:
    """What a user can do about grasps that may slip."""
    if made_to_hold(outcome, config):
        ways = ["more --starts"]
        if config.max_move != MaxMove():
            ways.append("a wider --max-move")
        if isfinite(config.seconds):
            ways.append("more --seconds")
        return f"try {', '.join(ways)}, or other grasps"
    if outcome.aimed.any():
        return "links touch where the targets say; without targets, forces are balanced too"
    if isinstance(config.solver, LevenbergMarquardt):
        return "only their geometry was refined, forces were not balanced"
    return f"forces are balanced with --solver levenberg-marquardt only, {type(config.solver).__name__.lower()} cannot"


def status_advice(status: Status, outcome: Outcome, config: Config) -> str:
    """What a user can do about a refinement that ended so; empty when there is nothing to do."""
    if status == Status.BUDGET and isfinite(config.seconds):
        return "the time or the iterations ran out while the loss still fell: raise --seconds, or refine it again"
    if status == Status.BUDGET and made_to_hold(outcome, config) and config.solver.iterations >= CLOSE.iterations:
        return "gaps were still closing when the iterations of a start ran out: refine the result again"
    if status == Status.STALLED and config.max_move != MaxMove():
        return f"{status.advice}; it may be --max-move that stops it"
    return status.advice


def advice(outcome: Outcome, config: Config) -> list[str]:
    """What a user can do about each of N grasps."""
    slips = outcome.usable & ~should_hold(outcome.quality[:, 1]) & made_to_hold(outcome, config)
    parts = (
        (status_advice(Status(status), outcome, config), f"may slip: {slip_advice(outcome, config)}" if slip else "")
        for status, slip in zip(outcome.status, slips, strict=True)
    )
    return ["; ".join(filter(None, pair)) for pair in parts]


def foretold_line(quality: Float[np.ndarray, " N"], held: Bool[np.ndarray, " N"]) -> Text:
    """How well quality foretold what held in simulation."""
    good = should_hold(quality)
    others = "" if good.all() else f", and {(~good & held).sum()} of the {(~good).sum()} others"
    return Text(
        f"{good.sum()} of {len(good)} should hold by their quality ({BAR}): {(good & held).sum()} of these did{others}"
    )
