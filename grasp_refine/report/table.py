"""The table that a person reads after a refinement: millimetres and degrees, before and after."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from grasp_refine.config import Config
from grasp_refine.report.outcome import Outcome
from grasp_refine.report.verdict import BAR, made_to_hold, should_hold, slip_advice, status_advice
from grasp_refine.solvers.status import Status

LONGEST = 40
"""Most grasps that are all listed without being asked for; of more, only the worst are."""
WORST = 10

_COLORS = {
    Status.CONVERGED: "green",
    Status.STALLED: "yellow",
    Status.BUDGET: "yellow",
    Status.NO_TARGET: "red",
    Status.NOT_FINITE: "red",
    Status.UNREACHABLE: "red",
    Status.INVALID: "red",
}
NEGLIGIBLE = 1e-5
"""Errors and depths below this (metres) are not worth mentioning."""

BALANCED = 1e-3
"""Wrench residuals below this are not worth mentioning."""

MANY = 12
"""Most grasps of an object that are listed by number in a line."""

NONE = "-"
"""Stands for what there is none of."""


def grasp_table(outcome: Outcome, hand: str, config: Config, *, verbose: bool = False) -> RenderableType:
    """Tables of all grasps by object, medians, and a verdict; of many grasps only the worst, unless `verbose`.

    Where grasps were made to hold, the verdict on each is by its quality; elsewhere it is how the refinement ended.
    """
    holds = made_to_hold(outcome, config)
    objects = list(dict.fromkeys(outcome.object.tolist()))
    parts: list[RenderableType] = []
    for name in objects:
        of_object = outcome.select(np.flatnonzero(outcome.object == name))
        parts += [_object_table(of_object, f"{hand} on {name}", holds, verbose), ""]
    if len(objects) > 1:
        total = _table(f"all {len(objects)} objects: {count_text(len(outcome), 'grasp')}", "")
        _add_summary(total, outcome)
        parts += [total, ""]
    lines = [_converged(outcome, config), _holding(outcome, config)]
    return Group(*parts, *(line for part in (lines[::-1] if holds else lines) for line in part), *_account(outcome))


def _object_table(outcome: Outcome, what: str, holds: bool, verbose: bool) -> Table:
    shown, title = np.arange(len(outcome)), f"{what}: {count_text(len(outcome), 'grasp')}"
    if len(outcome) > LONGEST and not verbose:
        # Grasps without a result come first, then by how far they are from what was wanted.
        errors = np.fmax(outcome.worst_error[:, 1], outcome.penetration[:, 1])
        badness = -outcome.quality[:, 1] if holds else errors
        shown = np.lexsort((-np.nan_to_num(badness), outcome.usable))[:WORST]
        title += f", the worst {WORST} (--verbose: all)"
    table = _table(title, "verdict" if holds else "status")
    for i in shown:
        table.add_row(*_row(outcome, int(i), holds))
    if len(outcome) > 1:
        table.add_section()
        _add_summary(table, outcome)
    return table


def plain_table(title: str, between: int = 1) -> Table:
    """An empty table with one rule below its heads, and so much space more than one between its columns."""
    return Table(
        title=escape(title),
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
    table.add_column("contact error\nmm, worst", justify="center", no_wrap=True)
    table.add_column("penetration\nmm, worst", justify="center", no_wrap=True)
    table.add_column("palm moved\nmm   deg", justify="right", no_wrap=True)
    table.add_column("joints\ndeg", justify="right", no_wrap=True)
    table.add_column("\nquality", justify="center", no_wrap=True)
    table.add_column(f"\n {last}", no_wrap=True)
    return table


def _row(outcome: Outcome, i: int, holds: bool) -> list[RenderableType]:
    status = Status(outcome.status[i])
    good = should_hold(outcome.quality[i])[1]
    verdict = ("should hold", "green") if good else ("may slip", "yellow")
    return [
        str(outcome.index[i]),
        _change(outcome.worst_error[i] * 1e3),
        _change(outcome.penetration[i] * 1e3),
        _moved(outcome.palm_m[i], outcome.palm_rad[i]),
        number_text(np.degrees(outcome.joints_rad[i]), 1),
        _graded(outcome.quality[i]),
        Text(" ").append(*(verdict if holds and outcome.usable[i] else (status.label, _COLORS.get(status, "")))),
    ]


def _add_summary(table: Table, outcome: Outcome) -> None:
    """Rows of medians and of worst values."""
    for word, of, of_quality in (("median", np.median, np.median), ("worst", np.max, np.min)):
        table.add_row(
            word,
            _change(_over(of, outcome.worst_error) * 1e3),
            _change(_over(of, outcome.penetration) * 1e3),
            _moved(_over(of, outcome.palm_m), _over(of, outcome.palm_rad)),
            number_text(np.degrees(_over(of, outcome.joints_rad)), 1),
            _graded(_over(of_quality, outcome.quality)),
            style="bold" if word == "median" else "",
        )


def _over(of: Callable[..., Any], values: np.ndarray) -> Any:
    """A statistic over the grasps that have a value, a number or one per column; NaN where none has."""
    columns = values.reshape(len(values), -1).T
    kept = [column[~np.isnan(column)] for column in columns.astype(float)]
    return np.array([of(column) if len(column) else np.nan for column in kept]).reshape(values.shape[1:])[()]


def _holding(outcome: Outcome, config: Config) -> list[Text]:
    """How many grasps should hold, and what can be done about the others."""
    before, after = should_hold(outcome.quality[:, 0]), should_hold(outcome.quality[:, 1])
    color = "green" if after.all() else "yellow"
    said = f"{after.sum()} of {count_text(len(outcome), 'grasp')} should hold"
    lines = [Text.assemble((said, color), f" (quality {BAR}), {before.sum()} as they came")]
    slips = outcome.usable & ~after
    if slips.any():
        said, advice = f"{slips.sum()} may slip", slip_advice(outcome, config)
        lines.append(Text.assemble((said, "yellow"), f"{_which(outcome, slips)}: {advice}"))
    return lines


def _converged(outcome: Outcome, config: Config) -> list[Text]:
    """How many converged, and what can be done about the others."""
    converged = int((outcome.status == Status.CONVERGED).sum())
    color = "green" if converged == len(outcome) else "yellow"
    lines = [Text.assemble((f"{converged} of {count_text(len(outcome), 'grasp')} converged", color))]
    for status in Status:
        count = int((outcome.status == status).sum())
        advice = status_advice(status, outcome, config)
        if count and advice:
            which = _which(outcome, outcome.status == status)
            lines.append(Text.assemble((f"{count} {status.label}", _COLORS[status]), f"{which}: {advice}"))
    return lines


def _which(outcome: Outcome, which: np.ndarray) -> str:
    """Which grasps, in brackets, unless they are many."""
    return f" ({numbers_text(outcome.object, outcome.index, which)})" if which.sum() <= MANY else ""


def _account(outcome: Outcome) -> list[Text]:
    """What became better, and what it cost."""
    measures = (
        ("wrench residual", outcome.wrench_residual, BALANCED, 1.0, ""),
        ("contact error", outcome.worst_error, NEGLIGIBLE, 1e3, " mm"),
        ("penetration", outcome.penetration, NEGLIGIBLE, 1e3, " mm"),
        ("self-penetration", outcome.self_penetration, NEGLIGIBLE, 1e3, " mm"),
    )
    changes = [
        _improvement(name, values[outcome.usable], least, factor, unit)
        for name, values, least, factor, unit in measures
    ]
    lines = [Text(f"less {change}") for change in changes if change]
    starts = [] if (outcome.starts <= 1).all() else [(outcome.starts, "starts", "{:.0f}".format)]
    costs = (*starts, (outcome.iterations, "iterations", "{:.0f}".format), (outcome.wall_s, "", _seconds))
    told = (f"{say(_over(np.median, values))} / {say(values.max())} {unit}".rstrip() for values, unit, say in costs)
    return [*lines, Text(f"a grasp took {', '.join(told)} (median / most)")]


def _improvement(name: str, values: np.ndarray, negligible: float, factor: float, unit: str) -> str:
    """In how many grasps a measure (N, 2) fell, if it was or is anywhere worth mentioning."""
    known = values[np.isfinite(values).all(axis=1)]
    relevant = known[(known > negligible).any(axis=1)]
    if not len(relevant):
        return ""
    better = int((relevant[:, 1] < relevant[:, 0]).sum())
    mean = " → ".join(number_text(value * factor, 3) for value in known.mean(axis=0))
    return f"{name} in {better} of {len(relevant)} with any; mean {mean}{unit}"


def numbers_text(objects: np.ndarray, index: np.ndarray, which: np.ndarray) -> str:
    """Which grasps (N,): their numbers, of many the first ones; by object where there are several."""
    names = list(dict.fromkeys(objects.tolist()))
    parts = []
    for name in names:
        numbers = [str(number) for number in index[which & (objects == name)]]
        if numbers:
            more = f" and {len(numbers) - MANY} more" if len(numbers) > MANY else ""
            parts.append((f"{name} " if len(names) > 1 else "") + ", ".join(numbers[:MANY]) + more)
    return "; ".join(parts)


def _change(values: np.ndarray) -> str:
    before, after = (number_text(value, 2 if value < 99.995 else 1) for value in values)
    return f"{before:>5} → {after:<4}"


def _graded(values: np.ndarray) -> Text:
    """Quality before and after, coloured by whether the grasp should hold."""
    before, after = (number_text(value, 3) for value in values)
    return Text.assemble(f"{before:>5} → ", (f"{after:<5}", "green" if should_hold(values)[1] else "yellow"))


def _moved(metres: float, radians: float) -> str:
    return f"{number_text(metres * 1e3, 1):>5} {number_text(np.degrees(radians), 1):>5}"


def number_text(value: float, digits: int) -> str:
    """A number with so many digits after the point, or what stands for none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def _seconds(value: float) -> str:
    if value < 0.0995:
        return f"{1e3 * value:.0f} ms"
    return f"{value:.2f} s" if value < 9.995 else f"{value:.0f} s"


def count_text(number: int, word: str) -> str:
    """So many of a thing."""
    return f"{number} {word}{'' if number == 1 else 's'}"
