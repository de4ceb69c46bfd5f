"""Charts of the alignment benchmark as SVG: error and misses against CPU time, and against a swept setting.

The output is deterministic: equal rows give equal bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine_apps.bench.align.labels import (
    METHODS,
    SWEPT,
    Row,
    at_largest_budget,
    budget,
    kinds_of,
    labels_of,
    name_of,
    swept,
)
from grasp_refine_apps.report.html_page import COLORS, PLAIN
from grasp_refine_apps.report.panels import (
    MARKERS,
    Line,
    Style,
    draw,
    logarithmic,
    share_axis,
    time_axis,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MIN_ERROR_M2 = 1e-14
"""Errors below this (m^2, a tenth of a micrometre) are drawn at it."""
MAX_LINES = 12
"""With more lines than this, a swept setting is shown at its best value only."""


def styles(rows: Sequence[Row], labels: Sequence[str]) -> dict[str, Style]:
    """Label -> style: the first variant of a method has the method's colour, others a colour that no method uses."""
    owner = {label: name_of(row) for row, label in zip(rows, labels, strict=True)}
    place = {label: METHODS.index(method) if method in METHODS else 0 for label, method in owner.items()}
    spare = [k for k in range(len(COLORS)) if k not in place.values()]
    found: dict[str, Style] = {}
    used: dict[int, int] = {}
    for label, index in place.items():
        if index in used and spare:
            index = spare.pop(0)
        again = used[index] = used.get(index, -1) + 1
        marker = MARKERS[(index + 3 * again) % len(MARKERS)]
        found[label] = Style(COLORS[index][0], marker, ("-", "--", ":", "-.")[again % 4])
    return found


@dataclass(frozen=True)
class TimeChart:
    """The main chart, and a note to be printed below it."""

    svg: str
    note: str


def time_chart(rows: Sequence[Row]) -> TimeChart:
    """Chart error and share of misses against CPU time per pair, a column for each kind and a line for each variant."""
    rows = [row for row in rows if _positive(row.get("cpu_s_per_pair"))]
    note = ""
    labels = labels_of(rows)
    for key in swept(rows):
        if len(set(labels)) > MAX_LINES:
            rows = _at_best(rows, key)
            labels = labels_of(rows)
            note += f" Each method is shown with its best {SWEPT[key]} only."
    style = styles(rows, labels)

    def lines(kind: str, height: Callable[[Row], tuple[float, bool] | None]) -> list[Line]:
        found = []
        for label, its in style.items():
            mine = [row for row, name in zip(rows, labels, strict=True) if name == label and row["kind"] == kind]
            points = [
                (row["cpu_s_per_pair"], *y)
                for row in sorted(mine, key=lambda row: (row["cpu_s_per_pair"], budget(row)))
                if (y := height(row)) is not None
            ]
            if points:
                found.append(Line(label, its, *zip(*points, strict=True)))
        return found

    def miss(row: Row) -> tuple[float, bool] | None:
        if not _finite(row.get("acc_1e6")):
            return None
        least = 0.5 / max(row.get("targets") or 1, 1)
        share = 1.0 - row["acc_1e6"]
        return max(share, least), share < least

    def error(row: Row) -> tuple[float, bool] | None:
        return (max(row["d5"], MIN_ERROR_M2), row["d5"] < MIN_ERROR_M2) if _finite(row.get("d5")) else None

    panels = [
        ("median error  [m²]", error, _error_axis),
        ("targets missed by more than 1 mm", miss, share_axis),
    ]
    kinds = kinds_of(rows)
    grid = [[(f"{kind} bodies", lines(kind, height), axis) for kind in kinds] for _, height, axis in panels]
    hollow = any(any(line.open) for row in grid for _, lines_, _ in row for line in lines_)
    if hollow:
        note += " A hollow marker means none missed (drawn at half a target) or an error too small to draw."
    svg = draw(
        grid, [name for name, _, _ in panels], "CPU time per pair of bodies", time_axis, "time", "Error over time"
    )
    return TimeChart(svg, note.strip())


def sweep_chart(rows: Sequence[Row], key: str) -> str:
    """Chart share of hits and median error at the largest budget against the setting `key`, a column for each kind."""
    rows = at_largest_budget(rows, labels_of(rows))
    labels = labels_of(rows, without=[key])
    style = styles(rows, labels)
    values = sorted({row[key] for row in rows if _finite(row.get(key))})

    def lines(kind: str, name: str, least: float) -> list[Line]:
        found = []
        for label, its in style.items():
            mine = [
                row
                for row, own in zip(rows, labels, strict=True)
                if own == label and row["kind"] == kind and _finite(row.get(key)) and _finite(row.get(name))
            ]
            mine.sort(key=lambda row: row[key])
            if mine:
                y = tuple(max(row[name], least) for row in mine)
                x = tuple(float(values.index(row[key])) for row in mine)
                found.append(Line(label, its, x, y, tuple(row[name] < least for row in mine)))
        return found

    def steps(axes: Axes, _: list[Line]) -> None:
        scale, unit = (1e3, " mm") if key == "margin" else (1.0, "")
        axes.set_xticks(range(len(values)), [f"{scale * value:g}{unit}" for value in values])
        axes.set_xlim(-0.3, len(values) - 0.7)

    kinds = kinds_of(rows)
    grid = [
        [(f"{kind} bodies", lines(kind, "acc_1e6", 0.0), _hit_axis) for kind in kinds],
        [(f"{kind} bodies", lines(kind, "d5", MIN_ERROR_M2), _error_axis) for kind in kinds],
    ]
    names = ["targets met within 1 mm", "median error  [m²]"]
    return draw(grid, names, SWEPT[key], steps, key, f"Results over the {SWEPT[key]}")


def _at_best(rows: Sequence[Row], key: str) -> list[Row]:
    """Select the rows of each variant at the value of `key` with the most hits at the largest budget."""
    names = labels_of(rows, without=[key])
    last = at_largest_budget(rows, labels_of(rows))
    last_names = {id(row): name for row, name in zip(rows, names, strict=True)}
    hits: dict[tuple[str, Any], list[float]] = {}
    for row in last:
        hits.setdefault((last_names[id(row)], row.get(key)), []).append(row.get("acc_1e6") or 0.0)
    best: dict[str, Any] = {}
    for (name, value), shares in hits.items():
        if name not in best or np.mean(shares) > np.mean(hits[name, best[name]]):
            best[name] = value
    return [row for row, name in zip(rows, names, strict=True) if row.get(key) == best[name]]


def _error_axis(axes: Axes, lines: list[Line]) -> None:
    values = [y for line in lines for y in line.y]
    logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [*values, 1e-6], _power)
    low, high = axes.get_ylim()
    for level, words in ((1e-6, "1 mm"), (1e-8, "0.1 mm")):
        if low < level < high:
            axes.axhline(level, color=PLAIN["muted"][0], linewidth=0.8, dashes=(4, 3), zorder=2)
            text = axes.text(0.01, level, words, color=PLAIN["muted"][0], va="bottom", ha="left", fontsize=7.5)
            text.set_transform(axes.get_yaxis_transform())


def _hit_axis(axes: Axes, lines: list[Line]) -> None:
    low = min((y for line in lines for y in line.y), default=0.0)
    # Near 100 % the differences would vanish on the whole scale.
    start = 0.0 if low < 0.5 else min(np.floor(low * 20) / 20, 0.95)
    axes.set_ylim(start - 0.02 * (1 - start), 1 + 0.03 * (1 - start))
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.4g} %")


def _power(value: float) -> str:
    exponent = int(np.floor(np.log10(value) + 1e-9))
    digit = round(value / 10.0**exponent)
    power = "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if digit == 1 else f"{digit}·{power}"


def _finite(value: Any) -> bool:
    return value is not None and bool(np.isfinite(value))


def _positive(value: Any) -> bool:
    return _finite(value) and value > 0
