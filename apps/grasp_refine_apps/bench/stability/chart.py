"""Heat maps: a square for all cells that share some keys, darker the nearer the worst error is to its tolerance.

They are tables, not pictures: each square has its counts as text, and the colours are those of the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import log10

from grasp_refine_apps.bench.stability.counts import Counts, group_rows, total_counts
from grasp_refine_apps.bench.stability.labels import FAULT_LABELS, ordered, words
from grasp_refine_apps.bench.stability.rows import WRONG, Row

PALEST_ERROR = 1e-8
"""Error over tolerance of the palest square; the darkest one that is not wrong has 1."""


@dataclass(frozen=True)
class Square:
    """All cells of one row and column."""

    look: str
    """Style: "right", "wrong", "refused", or "none" where there is no such cell."""
    depth: int
    """Percent of the darkest colour."""
    text: str
    """Text of the square: number of faults."""
    hint: str
    """Full description."""


@dataclass(frozen=True)
class Line:
    """A row of squares."""

    heads: tuple[tuple[str, int], ...]
    """Labels of the row, each with the number of rows that it spans; those of the row above are not repeated."""
    squares: tuple[Square, ...]


@dataclass(frozen=True)
class HeatMap:
    """Squares by the keys of rows and columns."""

    corner: tuple[str, ...]
    """Keys of the rows."""
    columns: tuple[str, ...]
    lines: tuple[Line, ...]


def heat_map(rows: Iterable[Row], down: Sequence[str], across: str, error: str) -> HeatMap:
    """Make the heat map of some rows.

    Args:
        rows: Rows to count.
        down: Keys that have a row for each combination that occurs.
        across: Key whose values are the columns.
        error: Key of the error that colours the squares, over its tolerance.
    """
    rows = list(rows)
    columns = ordered(across, (row[across] for row in rows))
    found = group_rows(rows, (*down, across))
    names = _ordered({key[:-1] for key in found}, down)
    lines = []
    for place, name in enumerate(names):
        heads = tuple(
            (words(key, name[k]), sum(other[: k + 1] == name[: k + 1] for other in names))
            for k, key in enumerate(down)
            if place == 0 or names[place - 1][: k + 1] != name[: k + 1]
        )
        where = [words(key, value) for key, value in zip(down, name, strict=True)]
        squares = tuple(
            _square(found.get((*name, column), []), ", ".join([*where, words(across, column)]), error)
            for column in columns
        )
        lines.append(Line(heads, squares))
    return HeatMap(tuple(down), tuple(words(across, column) for column in columns), tuple(lines))


def _ordered(names: set[tuple[object, ...]], keys: Sequence[str]) -> list[tuple[object, ...]]:
    places = [{value: place for place, value in enumerate(ordered(key, (name[k] for name in names)))}
              for k, key in enumerate(keys)]  # fmt: skip
    return sorted(names, key=lambda name: [places[k][value] for k, value in enumerate(name)])


def _square(rows: Sequence[Row], where: str, error: str) -> Square:
    if not rows:
        return Square("none", 0, "", f"{where}: there is no such cell")
    found = total_counts(rows)
    largest = found.largest[error]
    hint = f"{where}: {found['queries']} queries, {_describe(found)}"
    hint += "" if largest is None else f", worst error {largest:.1e} of its tolerance"
    if found.wrong:
        return Square("wrong", 100, str(found.wrong), hint)
    if found["refused"] == found["queries"]:
        return Square("refused", 0, "", hint)
    return Square("right", depth(largest), "", hint)


def depth(error: float | None) -> int:
    """Percent of the darkest colour for an error over its tolerance; logarithmic."""
    if error is None or error <= PALEST_ERROR:
        return 0
    return round(100 * min(1.0, 1 - log10(error) / log10(PALEST_ERROR)))


def _describe(found: Counts) -> str:
    said = [f"{found[name]} {FAULT_LABELS[name]}" for name in WRONG if found[name]] or ["none wrong"]
    return ", ".join([*said, *([f"{found['refused']} refused"] if found["refused"] else [])])
