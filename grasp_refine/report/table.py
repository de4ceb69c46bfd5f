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

from grasp_refine.report.outcome import Outcome
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
}
NEGLIGIBLE = 1e-5
"""Errors and depths below this (metres) are not worth mentioning."""

NONE = "-"
"""Stands for what there is none of."""


def grasp_table(outcome: Outcome, hand: str, *, verbose: bool = False) -> RenderableType:
    """Tables of all grasps by object, medians, and a verdict; of many grasps only the worst, unless `verbose`."""
    objects = list(dict.fromkeys(outcome.object.tolist()))
    parts: list[RenderableType] = []
    for name in objects:
        of_object = outcome.select(np.flatnonzero(outcome.object == name))
        parts += [_object_table(of_object, f"{hand} on {name}", verbose), ""]
    if len(objects) > 1:
        total = _table(f"all {len(objects)} objects: {count_text(len(outcome), 'grasp')}")
        _add_summary(total, outcome)
        parts += [total, ""]
    return Group(*parts, *_verdict(outcome))


def _object_table(outcome: Outcome, what: str, verbose: bool) -> Table:
    shown, title = np.arange(len(outcome)), f"{what}: {count_text(len(outcome), 'grasp')}"
    if len(outcome) > LONGEST and not verbose:
        # Grasps without a result come first, then by how far they are from what was wanted.
        badness = np.fmax(outcome.worst_error[:, 1], outcome.penetration[:, 1])
        shown = np.lexsort((-np.nan_to_num(badness), outcome.usable))[:WORST]
        title += f", the worst {WORST} (--verbose: all)"
    table = _table(title)
    for i in shown:
        table.add_row(*_row(outcome, int(i)))
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


def _table(title: str) -> Table:
    table = plain_table(title, between=0)
    table.add_column("\n grasp", justify="right", no_wrap=True)
    table.add_column("contact error\nmm, worst", justify="center", no_wrap=True)
    table.add_column("penetration\nmm, worst", justify="center", no_wrap=True)
    table.add_column("palm moved\nmm   deg", justify="right", no_wrap=True)
    table.add_column("joints\ndeg", justify="right", no_wrap=True)
    table.add_column("\n iter", justify="right", no_wrap=True)
    table.add_column("\ntime", justify="right", no_wrap=True)
    table.add_column("\n status", no_wrap=True)
    return table


def _row(outcome: Outcome, i: int) -> list[RenderableType]:
    status = Status(outcome.status[i])
    return [
        str(outcome.index[i]),
        _change(outcome.worst_error[i] * 1e3),
        _change(outcome.penetration[i] * 1e3),
        _moved(outcome.palm_m[i], outcome.palm_rad[i]),
        number_text(np.degrees(outcome.joints_rad[i]), 1),
        str(outcome.iterations[i]),
        _seconds(outcome.wall_s[i]),
        Text(f" {status.label}", _COLORS.get(status, "")),
    ]


def _add_summary(table: Table, outcome: Outcome) -> None:
    """Rows of medians and of worst values."""
    for word, of in (("median", np.median), ("worst", np.max)):
        table.add_row(
            word,
            _change(_over(of, outcome.worst_error) * 1e3),
            _change(_over(of, outcome.penetration) * 1e3),
            _moved(_over(of, outcome.palm_m), _over(of, outcome.palm_rad)),
            number_text(np.degrees(_over(of, outcome.joints_rad)), 1),
            f"{_over(of, outcome.iterations):.0f}",
            _seconds(_over(of, outcome.wall_s)),
            style="bold" if word == "median" else "",
        )


def _over(of: Callable[..., Any], values: np.ndarray) -> Any:
    """A statistic over the grasps that have a value, a number or one per column; NaN where none has."""
    columns = values.reshape(len(values), -1).T
    kept = [column[~np.isnan(column)] for column in columns.astype(float)]
    return np.array([of(column) if len(column) else np.nan for column in kept]).reshape(values.shape[1:])[()]


def _verdict(outcome: Outcome) -> list[Text]:
    """How many converged, what became of the grasps, and what can be done about those that did not converge."""
    converged = int((outcome.status == Status.CONVERGED).sum())
    color = "green" if converged == len(outcome) else "yellow"
    lines = [Text.assemble((f"{converged} of {count_text(len(outcome), 'grasp')} converged", color))]
    measures = (
        ("contact error", outcome.worst_error),
        ("penetration", outcome.penetration),
        ("self-penetration", outcome.self_penetration),
    )
    changes = [_improvement(name, values[outcome.usable]) for name, values in measures]
    lines += [Text(f"less {change}") for change in changes if change]
    for status in Status:
        count = int((outcome.status == status).sum())
        if count and status.advice:
            lines.append(Text.assemble((f"{count} {status.label}", _COLORS[status]), f": {status.advice}"))
    return lines


def _improvement(name: str, values: np.ndarray) -> str:
    """In how many grasps a measure (N, 2) in metres fell, if it was or is anywhere worth mentioning."""
    known = values[np.isfinite(values).all(axis=1)]
    relevant = known[(known > NEGLIGIBLE).any(axis=1)]
    if not len(relevant):
        return ""
    better = int((relevant[:, 1] < relevant[:, 0]).sum())
    mean = " → ".join(number_text(value * 1e3, 3) for value in known.mean(axis=0))
    return f"{name} in {better} of {len(relevant)} with any; mean {mean} mm"


def _change(values: np.ndarray) -> str:
    before, after = (number_text(value, 2 if value < 99.995 else 1) for value in values)
    return f"{before:>6} → {after:<5}"


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
