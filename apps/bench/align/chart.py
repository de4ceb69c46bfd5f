"""Charts of the alignment benchmark as SVG: error and misses against CPU time, and against a swept setting.

Colours in the SVG are variables of the page that holds it (`stylesheet`), so that they follow its light or dark
mode. The same rows give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .labels import METHODS, SWEPT, Row, at_largest_budget, budget, kinds_of, labels_of, swept

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = (
    ("#0067a5", "#62b8f2"),
    ("#c2410c", "#f58a50"),
    ("#047857", "#34c99a"),
    ("#a23b7d", "#e992c6"),
    ("#97650a", "#e8b33d"),
    ("#24292f", "#e6e9ed"),
    ("#7a828e", "#949daa"),
)
"""Colours of lines on a light and on a dark page, chosen to differ in brightness too."""
PLAIN = {"ink": ("#1b2430", "#e3e8ee"), "muted": ("#5b6676", "#9aa6b5"), "line": ("#d9dee6", "#343d49")}
PLAIN["page"] = ("#fffffe", "#14181d")
"""Text, side remarks, rules and the page itself."""
MARKERS = "os^DvPX"

FLOOR = 1e-14
"""Errors below this (m^2, a tenth of a micrometre) are drawn at it."""
CROWDED = 12
"""With more lines than this, a swept setting is shown at its best value only."""


@dataclass(frozen=True)
class Style:
    """How the line of a variant looks, in all panels."""

    color: str
    marker: str
    dashes: str


@dataclass(frozen=True)
class Line:
    """Points of one variant in one panel."""

    label: str
    style: Style
    x: tuple[float, ...]
    y: tuple[float, ...]
    open: tuple[bool, ...]
    """Points that stand for a smaller value than where they are drawn."""


def styles(rows: Sequence[Row], labels: Sequence[str]) -> dict[str, Style]:
    """Label -> style: the first variant of a method has the method's colour, others one that no method needs."""
    owner = {label: row["method"] for row, label in zip(rows, labels, strict=True)}
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


def stylesheet() -> tuple[str, str]:
    """Declarations of all colours for a light and for a dark page."""
    pairs = {**{f"c{k}": pair for k, pair in enumerate(COLORS)}, **PLAIN}
    light, dark = (" ".join(f"--{name}: {pair[mode]};" for name, pair in pairs.items()) for mode in (0, 1))
    return light, dark


@dataclass(frozen=True)
class TimeChart:
    """The picture that matters, and what has to be said about it."""

    svg: str
    note: str


def time_chart(rows: Sequence[Row]) -> TimeChart:
    """Error and share of misses against CPU time per pair, a column a kind and a line a variant."""
    rows = [row for row in rows if _positive(row.get("cpu_s_per_pair"))]
    note = ""
    labels = labels_of(rows)
    for key in swept(rows):
        if len(set(labels)) > CROWDED:
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
        return (max(row["d5"], FLOOR), row["d5"] < FLOOR) if _finite(row.get("d5")) else None

    panels = [
        ("median error  [m²]", error, _error_axis),
        ("targets missed by more than 1 mm", miss, _share_axis),
    ]
    kinds = kinds_of(rows)
    grid = [[(f"{kind} bodies", lines(kind, height), axis) for kind in kinds] for _, height, axis in panels]
    hollow = any(any(line.open) for row in grid for _, lines_, _ in row for line in lines_)
    if hollow:
        note += " A hollow marker stands for none missed (drawn at half a target) or an error too small to draw."
    svg = _draw(
        grid, [name for name, _, _ in panels], "CPU time per pair of bodies", _time_axis, "time", "Error over time"
    )
    return TimeChart(svg, note.strip())


def sweep_chart(rows: Sequence[Row], key: str) -> str:
    """Share of hits and median error at the largest budget against the setting `key`, a column a kind."""
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
        [(f"{kind} bodies", lines(kind, "d5", FLOOR), _error_axis) for kind in kinds],
    ]
    names = ["targets met within 1 mm", "median error  [m²]"]
    return _draw(grid, names, SWEPT[key], steps, key, f"Results over the {SWEPT[key]}")


def _at_best(rows: Sequence[Row], key: str) -> list[Row]:
    """The rows of each variant that have the value of `key` with the most hits at the largest budget."""
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


def _draw(
    grid: Sequence[Sequence[tuple[str, list[Line], Callable[[Axes, list[Line]], None]]]],
    names: Sequence[str],
    x_name: str,
    x_axis: Callable[[Axes, list[Line]], None],
    salt: str,
    title: str,
) -> str:
    """An SVG element of panels, a row a measure and a column a kind, with labels right of the line ends.

    Args:
        grid: Title, lines and vertical axis of each panel.
        names: What the vertical axis of each row shows.
        x_name: What all horizontal axes show.
        x_axis: Sets a horizontal axis up.
        salt: Keeps names inside this SVG apart from those of others on the page.
        title: What a screen reader says.
    """
    import matplotlib
    from matplotlib.figure import Figure

    columns = max((len(row) for row in grid), default=0)
    lines = [line for row in grid for _, its, _ in row for line in its]
    if not lines:
        return ""
    ink, muted, rule = (PLAIN[name][0] for name in ("ink", "muted", "line"))
    settings = {
        "svg.fonttype": "none",
        "svg.hashsalt": f"grasp-refine {salt}",
        "font.family": ["DejaVu Sans"],
        "font.size": 8.5,
        "text.color": ink,
        "axes.labelcolor": ink,
        "axes.edgecolor": muted,
        "axes.linewidth": 0.6,
        "xtick.color": muted,
        "ytick.color": muted,
        "grid.color": rule,
        "grid.linewidth": 0.6,
    }
    # Inches.
    left, label, gap, top, bottom = 0.62, 0.12 + 0.072 * max(len(line.label) for line in lines), 0.12, 0.3, 0.5
    width = 11.4 if columns > 1 else 7.2
    most = max(len(its) for row in grid for _, its, _ in row)
    high = max(2.5, 0.165 * most + 0.1)
    height = len(grid) * (high + top + bottom)
    wide = width / columns - left - label - gap
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(width, height))
        figure.patch.set_visible(False)
        for r, row in enumerate(grid):
            for c, (heading, its, y_axis) in enumerate(row):
                x0 = c * width / columns + left
                y0 = height - (r + 1) * (high + top + bottom) + bottom
                axes = figure.add_axes([x0 / width, y0 / height, wide / width, high / height])
                axes.set_title(f"{heading}: {names[r]}", loc="left", fontsize=9, fontweight="bold")
                _plot(axes, its)
                y_axis(axes, its)
                x_axis(axes, its)
                axes.set_xlabel(x_name)
                _label_ends(axes, its, high)
        out = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(out, format="svg", metadata=nothing)
    return _inlined(out.getvalue(), title)


def _plot(axes: Axes, lines: Sequence[Line]) -> None:
    axes.patch.set_visible(False)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True)
    axes.set_axisbelow(True)
    for line in lines:
        color, its = line.style.color, line.style
        axes.plot(line.x, line.y, its.dashes, color=color, linewidth=1.6, zorder=3)
        for hollow in (False, True):
            chosen = np.array(line.open) == hollow
            axes.plot(
                np.array(line.x)[chosen],
                np.array(line.y)[chosen],
                its.marker,
                color=color,
                markersize=4.5,
                markerfacecolor=PLAIN["page"][0] if hollow else color,
                zorder=4,
            )


def _label_ends(axes: Axes, lines: Sequence[Line], high: float) -> None:
    """Write each label right of the panel of `high` inches, at the height of its line's end if there is room."""
    if not lines:
        axes.text(0.5, 0.5, "no data", transform=axes.transAxes, ha="center", color=PLAIN["muted"][0])
        return
    to_panel = axes.transData + axes.transAxes.inverted()
    ends = np.array([to_panel.transform((line.x[-1], line.y[-1]))[1] for line in lines])
    for line, at in zip(lines, spread(ends, 0.155 / high), strict=True):
        axes.annotate(
            line.label,
            (line.x[-1], line.y[-1]),
            (1.03, at),
            textcoords="axes fraction",
            va="center",
            color=line.style.color,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": line.style.color, "linewidth": 0.5, "alpha": 0.5, "shrinkB": 3},
        )


def spread(heights: np.ndarray, gap: float) -> np.ndarray:
    """Heights (N,) moved apart to at least `gap`, in the same order, inside [0, 1] if they fit."""
    order = np.argsort(heights, kind="stable")
    placed = np.clip(heights[order], 0.0, 1.0)
    for _ in range(200):
        close = gap - np.diff(placed)
        if (close <= 1e-9).all():
            break
        push = np.maximum(close, 0.0) / 2
        placed[:-1] -= push
        placed[1:] += push
        if gap * (len(placed) - 1) <= 1.0:
            placed = np.clip(placed, gap * np.arange(len(placed)), 1.0 - gap * np.arange(len(placed))[::-1])
    result = np.empty_like(placed)
    result[order] = placed
    return result


def _time_axis(axes: Axes, lines: list[Line]) -> None:
    _logarithmic(axes.xaxis, axes.set_xscale, axes.set_xlim, [x for line in lines for x in line.x], _seconds)


def _error_axis(axes: Axes, lines: list[Line]) -> None:
    values = [y for line in lines for y in line.y]
    _logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [*values, 1e-6], _power)
    low, high = axes.get_ylim()
    for level, words in ((1e-6, "1 mm"), (1e-8, "0.1 mm")):
        if low < level < high:
            axes.axhline(level, color=PLAIN["muted"][0], linewidth=0.8, dashes=(4, 3), zorder=2)
            place = {"transform": axes.get_yaxis_transform(), "va": "bottom", "ha": "left", "fontsize": 7.5}
            axes.text(0.01, level, words, color=PLAIN["muted"][0], **place)


def _share_axis(axes: Axes, lines: list[Line]) -> None:
    values = [y for line in lines for y in line.y]
    _logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [*values, 1.0], lambda value: f"{100 * value:g} %")


def _hit_axis(axes: Axes, lines: list[Line]) -> None:
    low = min((y for line in lines for y in line.y), default=0.0)
    # Near 100 % the differences would vanish on the whole scale.
    start = 0.0 if low < 0.5 else min(np.floor(low * 20) / 20, 0.95)
    axes.set_ylim(start - 0.02 * (1 - start), 1 + 0.03 * (1 - start))
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.4g} %")


def _logarithmic(axis: Any, scale: Callable, limits: Callable, values: list[float], words: Callable) -> None:
    """Set an axis up for values, with ticks at 1, 2 and 5 where there are few decades."""
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

    low, high = (min(values), max(values)) if values else (0.1, 1.0)
    decades = np.log10(high / low)
    # Within less than a decade there would be ticks at any value, and too many.
    pad = 10 ** max(0.06 * decades, 0.12, 0.53 - 0.5 * decades)
    # In this order the old limits, which may be alike, are never made logarithmic.
    limits(low / pad, high * pad)
    scale("log")
    if decades < 2.2:
        axis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
        axis.set_minor_locator(NullLocator())
    else:
        axis.set_major_locator(LogLocator(10, numticks=10))
        axis.set_minor_locator(LogLocator(10, subs=(), numticks=10))
    axis.set_major_formatter(lambda value, _: words(value))
    axis.set_minor_formatter(NullFormatter())


def _seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if value >= 0.999 * size:
            return f"{value / size:.4g} {unit}"
    return f"{1e6 * value:.4g} µs"


def _power(value: float) -> str:
    exponent = int(np.floor(np.log10(value) + 1e-9))
    digit = round(value / 10.0**exponent)
    power = "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if digit == 1 else f"{digit}·{power}"


def _inlined(svg: str, title: str) -> str:
    """The SVG element alone, as wide as there is room, with the page's variables for colours."""
    svg = svg[svg.index("<svg") :]
    head, body = svg.split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    # Names of groups would occur twice on a page with two charts; nothing refers to them.
    body = re.sub(r' id="[A-Za-z0-9]+_\d+"', "", body)
    body = body.replace("font-family: 'DejaVu Sans'", "font-family: inherit").replace("'DejaVu Sans'", "inherit")
    for name, (light, _) in {**{f"c{k}": pair for k, pair in enumerate(COLORS)}, **PLAIN}.items():
        body = body.replace(light, f"var(--{name})")
    return f'{head} class="chart" role="img" aria-label="{title}">{body}'


def _finite(value: Any) -> bool:
    return value is not None and bool(np.isfinite(value))


def _positive(value: Any) -> bool:
    return _finite(value) and value > 0
