"""Table for people after a refinement: millimetres and degrees, before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from grasp_refine.core.plurals import count_text, whole
from grasp_refine.measures.measures import COMPARED, MEASURES, QUALITY, Measure
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.changed import Changed
from grasp_refine.results.fidelity_lines import fidelity_lines
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.simulated import SimulatedGrasps, closing_line, simulation_lines
from grasp_refine.results.verdict import (
    REGION_ADVICE,
    estimate_line,
    is_unseen,
    should_hold,
    slip_advice,
    status_advice,
    touches_outside,
)

MAX_LISTED_GRASPS = 40
"""Largest number of grasps that are all listed by default; of more, only the worst are."""
NUM_WORST_GRASPS = 10
"""Number of worst grasps that are listed."""

_COLORS = {
    Status.CONVERGED: "green",
    Status.STALLED: "yellow",
    Status.BUDGET: "yellow",
    Status.NO_TARGET: "red",
    Status.NOT_FINITE: "red",
    Status.UNREACHABLE: "red",
    Status.INVALID: "red",
    Status.OUT_OF_REACH: "red",
}

MAX_NUMBERED_GRASPS = 12
"""Largest number of grasps of an object that are listed by number in a line."""

NO_VALUE = "-"
"""Text of a missing value."""


def grasp_table(
    outcome: Outcome, hand: str, config: Config, simulated: SimulatedGrasps | None = None, *, verbose: bool = False
) -> RenderableType:
    """Return tables of all grasps by object, medians, and a verdict; of many grasps only the worst, unless `verbose`.

    The verdict on each is whether it held, where it was simulated; else, where grasps were made to hold, the estimate
    by quality; elsewhere it is the status of the refinement.

    Args:
        outcome: The grasps before and after.
        hand: Name of the hand.
        config: Settings of the refinement.
        simulated: The same grasps in simulation; None: not simulated.
        verbose: Whether all grasps are listed.
    """
    holds, held = config.holds, None if simulated is None else simulated.held

    def of_object(name: str, rows: np.ndarray) -> Table:
        part = None if held is None else held[rows]
        return _object_table(outcome.select(rows), f"{hand} on {name}", holds, part, verbose)

    parts, count = by_object(outcome.object, of_object), len(set(outcome.object.tolist()))
    if count > 1:
        total = _table(f"all {count} objects: {count_text(len(outcome), 'grasp')}", "")
        _add_summary(total, outcome)
        parts += [total, ""]
    lines = [_converged(outcome, config), _holding(outcome, config, held)]
    lines = lines[::-1] if holds else lines
    if simulated is not None:
        lines = [simulation_lines(simulated, outcome.quality), *lines]
    parts += [line for part in (*lines, _misplaced(outcome)) for line in part]
    parts += fidelity_lines(outcome) or Changed.of(outcome, config.confidence).lines()
    closing = []
    if simulated is not None:
        closing = [Text("before, ").append(closing_line(simulated.closing)).append("; after, they are our own")]
    return Group(*parts, *_summary_lines(outcome), *closing)


def _object_table(outcome: Outcome, what: str, holds: bool, held: np.ndarray | None, verbose: bool) -> Table:
    # Of many, grasps without a result come first, then grasps that did not hold, then the largest errors.
    errors = np.fmax(outcome["contact_error_m"][:, 1], outcome["penetration_m"][:, 1])
    badness = -outcome.quality[:, 1] if holds else errors
    good = np.zeros(len(outcome)) if held is None else held[:, 1]
    worst_first = np.lexsort((-np.nan_to_num(badness), good, outcome.usable))
    shown, title = listed(worst_first, f"{what}: {count_text(len(outcome), 'grasp')}", verbose)
    last = "held in\nsimulation" if held is not None else "\nestimate" if holds else "\nstatus"
    table = _table(title, last)
    for i in shown.tolist():
        values, changed = {key: outcome[key][i] for key in _TABLE_KEYS}, outcome.fidelity[i] or outcome.change[i]
        table.add_row(
            str(outcome.index[i]),
            *_cells(values, changed),
            _verdict(outcome, i, holds, held),
        )
    if len(outcome) > 1:
        table.add_section()
        _add_summary(table, outcome)
    return table


def by_object(objects: np.ndarray, table_of: Callable[[str, np.ndarray], Table]) -> list[RenderableType]:
    """Return the tables of the grasps (N,) on each object, an empty line after each, by its name and their rows."""
    names = dict.fromkeys(objects.tolist())
    return [part for name in names for part in (table_of(name, np.flatnonzero(objects == name)), "")]


def listed(worst_first: np.ndarray, title: str, verbose: bool) -> tuple[np.ndarray, str]:
    """Return the rows of a table of N grasps, of many only the worst unless `verbose`, and its title, which says so."""
    if len(worst_first) <= MAX_LISTED_GRASPS or verbose:
        return np.arange(len(worst_first)), title
    return worst_first[:NUM_WORST_GRASPS], f"{title}, the worst {NUM_WORST_GRASPS} (`verbose`: all)"


def plain_table(title: str = "", between: int = 1) -> Table:
    """Return an empty table with one rule below its heads, and `between` further spaces between its columns."""
    return Table(
        title=escape(title) or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, between, 0, 0),
        header_style="dim",
    )


def _table(title: str, last: str) -> Table:
    table = plain_table(title, between=0)
    table.add_column("\n grasp", justify="right", no_wrap=True)
    table.add_column("contact\nerror, mm", justify="right", no_wrap=True)
    table.add_column("penetration\nmm", justify="right", no_wrap=True)
    table.add_column("moved\nmm", justify="right", no_wrap=True)
    table.add_column("\nchange", no_wrap=True)
    table.add_column("\nquality", justify="center", no_wrap=True)
    table.add_column(last, no_wrap=True)
    return table


_TABLE_KEYS = ("contact_error_m", "penetration_m", "displacement_m", "quality")
"""Keys of the measures in the columns of the table; 80 columns of text hold no more."""


def _cells(values: Mapping[str, Any], change: str = "") -> list[RenderableType]:
    """Return the cells of a row, given the values of the measures `_TABLE_KEYS` and the change of the grasp."""
    error, depth, moved, quality = (values[key] * MEASURES[key].unit.factor for key in _TABLE_KEYS)
    return [_both(error), _both(depth), number_text(moved, 1), change, _graded(quality)]


def _verdict(outcome: Outcome, i: int, holds: bool, held: np.ndarray | None) -> Text:
    """Return the verdict on a grasp; see `grasp_table`."""
    status = Status(outcome.status[i])
    if held is not None:
        before, after = ("yes" if each else "no" for each in held[i])
        return Text.assemble(f"{before:>3} → ", (after, "green" if held[i, 1] else "red"))
    if holds and outcome.usable[i]:
        if touches_outside(outcome)[i, 1]:
            return Text("outside", "yellow")
        if not should_hold(outcome.quality[i])[1]:
            return Text("not seen" if is_unseen(outcome)[i] else "may slip", "yellow")
        gap = str(outcome.gap[i]).partition(" at ")[0]
        return Text.assemble(("should hold", "green"), (f", gap {gap}" if gap else "", "yellow"))
    return Text(status.label, _COLORS.get(status, ""))


def _add_summary(table: Table, outcome: Outcome) -> None:
    """Add rows of medians and of worst values."""
    for word in ("median", "worst"):
        values = {}
        for key in _TABLE_KEYS:
            worst = np.min if MEASURES[key].better == "higher" else np.max
            values[key] = _over(np.median if word == "median" else worst, outcome[key])
        table.add_row(word, *_cells(values), style="bold" if word == "median" else "")


def _over(of: Callable[..., Any], values: np.ndarray) -> Any:
    """Return a statistic over the grasps that have a value, a number or one per column; NaN where none has."""
    columns = values.reshape(len(values), -1).T
    kept = [column[~np.isnan(column)] for column in columns.astype(float)]
    return np.array([of(column) if len(column) else np.nan for column in kept]).reshape(values.shape[1:])[()]


def _holding(outcome: Outcome, config: Config, held: np.ndarray | None) -> list[Text]:
    """Return lines on the estimate by quality, where nothing was simulated, and advice on grasps that may slip."""
    before, after = (should_hold(quality) for quality in outcome.quality.T)
    # Grasps that touch elsewhere are marked.
    weak, unseen = outcome.usable & ~after & ~touches_outside(outcome)[:, 1], is_unseen(outcome)
    slips, how = weak & ~unseen, "may slip"
    lines = []
    if held is None:
        lines.append(estimate_line(int(after.sum()), int(before.sum()), len(outcome)))
    else:
        slips, how = slips & ~held[:, 1], f"did not hold and {'has' if slips.sum() == 1 else 'have'} a low quality"
    if slips.any():
        advice = slip_advice(config)
        lines.append(
            Text.assemble((f"{slips.sum()} {how}", "yellow"), f"{_numbers_in_brackets(outcome, slips)}: {advice}")
        )
        lines += _text_lines(outcome, slips, outcome.weakness)
    if (hidden := weak & unseen).any():
        count = Text(f"{hidden.sum()} not seen", "yellow")
        hint = f"{_numbers_in_brackets(outcome, hidden)}: they may hold or not, by what the object is behind"
        lines.append(Text.assemble(count, hint))
        lines += _text_lines(outcome, hidden, outcome.weakness)
    return lines


def _misplaced(outcome: Outcome) -> list[Text]:
    """Return lines on grasps that touch the object outside of the regions, where there are any."""
    if not np.isfinite(outcome["region_miss_m"]).any():
        return []
    outside = touches_outside(outcome)
    before, after = (whole(int(count)) for count in (outcome.usable[:, None] & ~outside).sum(axis=0))
    color = "yellow" if outside[:, 1].any() else "green"
    lines = [Text.assemble("touch only where they should: ", (f"{before} → {after} of {whole(len(outcome))}", color))]
    if outside[:, 1].any():
        numbers, how = _numbers_in_brackets(outcome, outside[:, 1]), f"{outside[:, 1].sum()} touch elsewhere"
        lines.append(Text.assemble((how, "yellow"), f"{numbers}: {REGION_ADVICE}"))
    return lines + _text_lines(outcome, outside[:, 1], outcome.weakness)


def _text_lines(outcome: Outcome, which: np.ndarray, texts: np.ndarray) -> list[Text]:
    """Return a line for each of the first of some grasps with its text, where it has one."""
    rows = [row for row in np.flatnonzero(which) if texts[row]][:MAX_NUMBERED_GRASPS]
    names = [numbers_text(outcome.object, outcome.index, np.arange(len(outcome)) == row) for row in rows]
    return [Text(f"  grasp {name}: {texts[row]}") for name, row in zip(names, rows, strict=True)]


def _converged(outcome: Outcome, config: Config) -> list[Text]:
    """Return lines on the number of grasps that converged or, where they should hold, touch, and advice on others."""
    done = outcome.usable & (outcome.gap == "") if config.holds else outcome.status == Status.CONVERGED
    color = "green" if done.all() else "yellow"
    how = "touch with all contact links" if config.holds else "converged"
    lines = [Text.assemble((f"{done.sum()} of {count_text(len(outcome), 'grasp')} {how}", color))]
    if config.holds and (gaps := outcome.usable & ~done).any():
        have = "has a gap" if gaps.sum() == 1 else "have a gap"
        lines.append(Text.assemble((f"{gaps.sum()} {have}", "yellow"), f"{_numbers_in_brackets(outcome, gaps)}:"))
        lines += _text_lines(outcome, gaps, outcome.gap)
    for status in Status:
        count = int((outcome.status == status).sum())
        advice = status_advice(status, config)
        if count and advice and not (config.holds and status == Status.STALLED):
            numbers = _numbers_in_brackets(outcome, outcome.status == status)
            lines.append(Text.assemble((f"{count} {status.label}", _COLORS[status]), f"{numbers}: {advice}"))
    return lines


def _numbers_in_brackets(outcome: Outcome, which: np.ndarray) -> str:
    """Return the numbers of some grasps in brackets, unless they are many."""
    return f" ({numbers_text(outcome.object, outcome.index, which)})" if which.sum() <= MAX_NUMBERED_GRASPS else ""


def _summary_lines(outcome: Outcome) -> list[Text]:
    """Return lines on improved measures, and on the cost; none without grasps."""
    if not len(outcome):
        return []
    # The quality has a line of its own.
    measures = [each for each in COMPARED if each is not QUALITY and each.name in outcome.measures]
    changes = [_improvement(measure, outcome[measure.name][outcome.usable]) for measure in measures]
    lines = [Text(change) for change in changes if change]
    starts = [] if (outcome["starts"] <= 1).all() else [(outcome["starts"], "starts", "{:.0f}".format)]
    costs = (*starts, (outcome["iterations"], "iterations", "{:.0f}".format), (outcome["wall_s"], "", _seconds))
    parts = (f"{text(_over(np.median, values))} / {text(values.max())} {unit}".rstrip() for values, unit, text in costs)
    return [*lines, Text(f"a grasp took {', '.join(parts)} (median / most)")]


def _improvement(measure: Measure, values: np.ndarray) -> str:
    """Return text on the number of grasps in which a measure (N, 2) fell or rose; empty if it is negligible in all."""
    known = values[np.isfinite(values).all(axis=1)]
    relevant = known[(known > measure.unit.negligible).any(axis=1)]
    if not len(relevant):
        return ""
    change = relevant[:, 1] - relevant[:, 0]
    counts = (("fell", int((change < 0).sum())), ("rose", int((change > 0).sum())))
    text = " and ".join(f"{verb} in {count}" for verb, count in counts if count) or "stayed in 0"
    mean = " → ".join(measure.text(value, ".3f") for value in known.mean(axis=0))
    return (
        f"{measure.title} {text} of {count_text(len(relevant), 'grasp')} with any; mean {mean} {measure.unit.symbol}"
    ).rstrip()


def numbers_text(objects: np.ndarray, index: np.ndarray, which: np.ndarray) -> str:
    """Return the numbers of grasps (N,) as text, of many the first ones; by object where there are several."""
    names = list(dict.fromkeys(objects.tolist()))
    parts = []
    for name in names:
        numbers = [str(number) for number in index[which & (objects == name)]]
        if numbers:
            more = f" and {len(numbers) - MAX_NUMBERED_GRASPS} more" if len(numbers) > MAX_NUMBERED_GRASPS else ""
            parts.append((f"{name} " if len(names) > 1 else "") + ", ".join(numbers[:MAX_NUMBERED_GRASPS]) + more)
    return "; ".join(parts)


def _both(values: np.ndarray) -> str:
    """Return a value before and after."""
    before, after = (number_text(value, int(value < 99.995) + int(value < 999.95)) for value in values)
    return f"{before} → {after:<4}"


def _graded(values: np.ndarray) -> Text:
    """Return quality before and after, coloured by whether the grasp should hold."""
    before, after = (number_text(value, 3) for value in values)
    return Text.assemble(f"{before:>5} → ", (f"{after:<5}", "green" if should_hold(values)[1] else "yellow"))


def number_text(value: float, digits: int) -> str:
    """Return a number with `digits` after the point, or `NO_VALUE` where it is not finite."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NO_VALUE


def measure_text(measure: Measure, value: float) -> str:
    """Return a value of a measure in SI units as people read it, or `NO_VALUE` where it is not finite."""
    return measure.text(value) if np.isfinite(value) else NO_VALUE


def _seconds(value: float) -> str:
    if value < 0.0995:
        return f"{1e3 * value:.0f} ms"
    return f"{value:.2f} s" if value < 9.995 else f"{value:.0f} s"
