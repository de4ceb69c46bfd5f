"""Tables for people of the margins of grasps: each grasp, each factor, and before against after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from grasp_refine.core.plurals import count_text
from grasp_refine.results.table import NO_VALUE, by_object, listed, plain_table
from grasp_refine.validation.margins.factors import JOINT, MEANING, PUSH
from grasp_refine.validation.margins.intervals import difference_interval
from grasp_refine.validation.margins.limits import FORCE_RANGE_N, FRICTION_RANGE, STEPS, TORQUE_RANGE_NM, Limits
from grasp_refine.validation.margins.margins import NO_FACTOR, Margins


@dataclass(frozen=True)
class Limit:
    """One of the `Limits`, for people and files."""

    field: str
    """Field of `Limits`."""
    name: str
    """Key in files, with its unit."""
    title: str
    """Name for people."""
    unit: str
    """Unit for people."""
    range: tuple[float, float]
    """Range that was searched."""
    lower_is_better: bool = False
    """Whether less of it is better."""

    def of(self, limits: Limits) -> np.ndarray:
        """Return the values (N,); for the friction of a grasp that held at none, infinity."""
        values = getattr(limits, self.field)
        return np.where(np.isnan(values), np.inf, values)

    def text(self, value: float) -> str:
        """Return a value as people read it, without its unit."""
        low, high = self.range
        step = (high / low) ** (0.5**STEPS)
        if value == np.inf:
            return "none"
        if value == 0:
            return f"< {low:.2g}"
        if self.lower_is_better and value < low * step**1.5:
            return f"< {value:.2g}"
        if not self.lower_is_better and value > high / step**1.5:
            return f"> {value:.2g}"
        return f"{value:.2g}"


LIMITS = (
    Limit("friction", "lowest_friction", "lowest friction", "", FRICTION_RANGE, lower_is_better=True),
    Limit("force", "largest_force_n", "largest force", "N", FORCE_RANGE_N),
    Limit("torque", "largest_torque_nm", "largest torque", "N m", TORQUE_RANGE_NM),
)
"""All limits."""


def margins_table(
    margins: Margins, objects: np.ndarray, index: np.ndarray, hand: str, *, verbose: bool = False
) -> RenderableType:
    """Return a table of the grasps on each object, one of the factors, and a line on the limits.

    Args:
        margins: Margins of N grasps.
        objects: Name of the object of each (N,).
        index: Number of each within its object (N,).
        hand: Name of the hand.
        verbose: Whether all grasps are listed.
    """
    parts = by_object(
        objects, lambda name, rows: _grasps(margins.select(rows), index[rows], f"{hand} on {name}", verbose)
    )
    return Group(*parts, factors_table(margins, hand), *_limit_lines(margins))


def factors_table(margins: Margins, hand: str) -> Table:
    """Return a table of the mean probability under each factor, its cost, and the grasps that it costs most."""
    grasps, draws = count_text(len(margins), "grasp"), count_text(margins.draws, "drawn world")
    table = plain_table(f"{hand}: {grasps} in {draws}, mean probability of holding")
    table.add_column("", no_wrap=True)
    for head in ("held", "[95 %]", "costs", "[95 %]", "worst of"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("")
    worst, push = margins.worst, PUSH in margins.trials
    for name in margins.trials:
        mean, *between = margins.mean(name)
        cost = ["", ""]
        if push and name not in (JOINT, PUSH):
            change, *around = difference_interval(margins.held[name], margins.held[PUSH])
            cost = [f"{change:.3f}", _between(around)]
        most = str(int((worst == name).sum())) if name != JOINT else ""
        table.add_row(
            name, f"{mean:.3f}", _between(between), *cost, most, MEANING[name], style="bold" if name == JOINT else ""
        )
    return table


def margins_comparison(before: Margins, after: Margins, hand: str) -> RenderableType:
    """Return what changed between two margins of the same grasps in the same draws."""
    table = plain_table(f"{hand}: {count_text(len(after), 'grasp')} in the same drawn worlds, before → after")
    table.add_column("", no_wrap=True)
    for head in ("before", "after", "change", "[95 %]", "better in", "worse in"):
        table.add_column(head, justify="right", no_wrap=True)
    for name in (name for name in after.trials if name in before.trials):
        old, new = before.held[name], after.held[name]
        change, *between = difference_interval(old, new)
        counts = (np.sign(new.sum(axis=1) - old.sum(axis=1)) == sign for sign in (1, -1))
        table.add_row(
            name,
            f"{old.mean():.3f}",
            f"{new.mean():.3f}",
            f"{change:+.3f}",
            _between(between, "+"),
            *(str(int(each.sum())) for each in counts),
            style="bold" if name == JOINT else "",
        )
    if before.limits is not None and after.limits is not None:
        for limit in LIMITS:
            old, new = limit.of(before.limits), limit.of(after.limits)
            better = (new < old, new > old)
            table.add_row(
                f"{limit.title} of half, {limit.unit}".rstrip(", "),
                *(limit.text(_reached(limit, side, 0.5)) for side in (before.limits, after.limits)),
                "",
                "",
                *(str(int(each.sum())) for each in (better if limit.lower_is_better else better[::-1])),
            )
    return table


def _grasps(margins: Margins, index: np.ndarray, what: str, verbose: bool) -> Table:
    """Return the table of the grasps on one object."""
    first = margins.probability[:, 0]
    title = f"{what}: {count_text(len(margins), 'grasp')} in drawn worlds"
    shown, title = listed(np.argsort(first, kind="stable"), title, verbose)
    table = plain_table(title)
    heads = ["\n grasp", f"{margins.trials[0]}\nheld", "\n[95 %]", "costs most\nfactor", "alone\nheld"]
    limits = margins.limits
    if limits is not None:
        heads += ["friction\nleast", "force\nN", "torque\nN m"]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    worst, probability, interval = margins.worst, margins.probability, margins.interval[:, 0]
    for i in shown:
        name = str(worst[i])
        alone = NO_VALUE if name == NO_FACTOR else f"{probability[i, margins.trials.index(name)]:.2f}"
        held = Text(f"{first[i]:.2f}", "green" if first[i] == 1 else "yellow" if first[i] >= 0.5 else "red")
        cells = [] if limits is None else [limit.text(limit.of(limits)[i]) for limit in LIMITS]
        table.add_row(str(index[i]), held, _between(interval[i], digits=2), name or NO_VALUE, alone, *cells)
    if len(margins) > 1:
        table.add_section()
        mean, *between = margins.mean(margins.trials[0])
        cells = [] if limits is None else [limit.text(_reached(limit, limits, 0.5)) for limit in LIMITS]
        table.add_row("all", f"{mean:.2f}", _between(between, digits=2), "", "", *cells, style="bold")
    return table


def _limit_lines(margins: Margins) -> list[Text]:
    """Return a line for each limit: the value that half and nine of ten grasps reach."""
    if margins.limits is None:
        return []
    lines = []
    for limit in LIMITS:
        title = f"{limit.title}, {limit.unit}".rstrip(", ")
        parts = (limit.text(_reached(limit, margins.limits, share)) for share in (0.5, 0.9))
        lines.append(Text(f"{title}: {' / '.join(parts)} (half / nine of ten of the grasps)"))
    return lines


def _reached(limit: Limit, limits: Limits, share: float) -> float:
    """Return the value that a share of the grasps reaches or betters."""
    values = np.sort(limit.of(limits))
    ordered = values if limit.lower_is_better else values[::-1]
    return float(ordered[max(int(np.ceil(share * len(ordered))), 1) - 1])


def _between(pair: Sequence[float] | np.ndarray, sign: str = "", digits: int = 3) -> str:
    low, high = pair
    return f"{low:{sign}.{digits}f} {high:{sign}.{digits}f}"
