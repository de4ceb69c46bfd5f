"""Reports of benchmarks: tables, charts and notes, as text for a terminal and as one HTML file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from typing import Any, Literal

import numpy as np
from rich.box import SIMPLE
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table as RichTable

from grasp_refine.validation.margins.intervals import wilson
from grasp_refine_apps.bench.chart import Chart, Row, entry
from grasp_refine_apps.report.html_page import rendered

SCALES = {"%": 100.0, "mm": 1e3, "µm": 1e6, "°": degrees(1.0)}
"""Unit of a table -> its number in the unit of rows, which are shares, metres and radians; others are as in rows."""

MISSING = "–"
"""Text of a number that was not measured."""

MAX_LABEL_CHARACTERS = 26
"""Width of the first column in a terminal."""

Only = Literal["terminal", "page"]
"""Place of a part that is not shown everywhere."""


@dataclass(frozen=True)
class Column:
    """Column of a table, in a terminal and on a page."""

    key: str
    """Key in a row; "last.acc_1e6" is an entry of an entry."""
    head: str
    """Heading without the unit; in a terminal each word has a line of its own, and breaks at soft hyphens."""
    unit: str = ""
    """Unit in which the number is shown, see `SCALES`."""
    form: str | Callable[[Any], str] = ".3g"
    """Format of a number; or a function that formats any value but None."""
    better: Literal["higher", "lower"] | None = None
    """Direction of better numbers; the best of a table stands out on a page."""
    hint: str = ""
    """Explanation of the number."""
    only: Only | None = None
    """Place of the column; None: everywhere."""

    def text(self, row: Row) -> str:
        """Format the value of a row."""
        value = entry(row, self.key)
        if value is None or (isinstance(value, float) and not isfinite(value)):
            return MISSING
        if callable(self.form):
            return self.form(value)
        if isinstance(value, bool):
            return "yes" if value else ""
        if isinstance(value, str):
            return value
        text = f"{value * SCALES[self.unit] if self.unit in SCALES else value:{self.form}}"
        return text.replace("e-0", "e-").replace("e+0", "e+")

    def best(self, rows: Sequence[Row]) -> str | None:
        """Return the text of the best number of a table; None where no number is better than the others."""
        values = [row for row in rows if self.better is not None and self.text(row) != MISSING]
        if len({self.text(row) for row in values}) < 2:
            return None
        choose = max if self.better == "higher" else min
        return self.text(choose(values, key=lambda row: entry(row, self.key)))


@dataclass(frozen=True)
class Cell:
    """A cell of a table on a page."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Table:
    """Rows side by side; the first column names them."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    note: str = ""
    """Paragraph above the table, on a page."""
    only: Only | None = None
    """Place of the table; None: everywhere."""
    folded: bool = False
    """Whether the table is folded on a page."""

    def shown(self, where: Only) -> list[Column]:
        """Return the columns that are shown in a terminal, or on a page."""
        return [column for column in self.columns if column.only in (None, where)]

    def cells(self) -> list[list[Cell]]:
        """Return the cells of each row on a page."""
        columns = self.shown("page")
        best = [column.best(self.rows) for column in columns]
        return [
            [Cell(text := column.text(row), text == top) for column, top in zip(columns, best, strict=True)]
            for row in self.rows
        ]

    def markdown(self) -> str:
        """Return the columns of a page as a table in Markdown."""
        columns = self.shown("page")
        heads = [f"{column.head}, {column.unit}" if column.unit else column.head for column in columns]
        lines = [heads, ["---"] * len(heads), *([cell.text for cell in cells] for cells in self.cells())]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def printed(self) -> RichTable:
        """Return the table for a terminal."""
        first, *columns = self.shown("terminal")
        table = RichTable(title=self.title, title_justify="left", box=SIMPLE, padding=0, show_edge=False)
        table.add_column(first.head, overflow="fold", min_width=7, max_width=MAX_LABEL_CHARACTERS)
        for column in columns:
            words = f"{column.head} {column.unit}".strip().replace("\u00ad", "-\n").replace(" ", "\n")
            sentence = column is columns[-1] and any(isinstance(entry(row, column.key), str) for row in self.rows)
            table.add_column(words, justify="left" if sentence else "right", no_wrap=not sentence)
        for row in self.rows:
            table.add_row(*(escape(column.text(row)) for column in (first, *columns)))
        return table


def interval(name: str, held: np.ndarray) -> Row:
    """Return the share that held and its interval; None without any."""
    keys = name, f"{name}_lower", f"{name}_upper"
    if not len(held):
        return dict.fromkeys(keys)
    lower, upper = wilson(np.asarray(held.sum()), len(held))
    return dict(zip(keys, (float(held.mean()), float(lower), float(upper)), strict=True))


def failed_table(problems: Sequence[str]) -> list[Table]:
    """Return the table of the cases that failed, given "case: traceback" of each; none without."""
    failed = [problem.partition(": ") for problem in problems]
    lines = [{"case": case, "reason": reason.strip().splitlines()[-1]} for case, _, reason in failed]
    return [Table("Cases that failed", [Column("case", "case"), Column("reason", "failed")], lines)] if lines else []


@dataclass(frozen=True)
class Note:
    """Paragraphs of text, separated by empty lines."""

    text: str
    title: str = ""
    only: Only | None = "page"
    """Its place; None: everywhere."""
    verbatim: bool = False
    """Whether line breaks are kept."""


@dataclass(frozen=True)
class Figures:
    """Pictures of grasps before and after, on a page."""

    title: str
    note: str
    """Paragraph above them."""
    entries: Sequence[dict[str, Any]]
    """Entries of the macro `figure`, as `batch.page.case_entry` returns them."""
    only: Only = "page"


@dataclass(frozen=True)
class Report:
    """Report of a run."""

    title: str
    parts: Sequence[Table | Chart | Note | Figures]
    """Contents, in this order."""
    failed: bool = False
    """Whether something is wrong, so that the command ends with exit code 1."""

    def printed(self) -> Iterator[RenderableType]:
        """Yield tables and notes for a terminal."""
        for part in self.parts:
            if isinstance(part, Table) and part.only != "page":
                yield from (part.printed(), "")
            if isinstance(part, Note) and part.only != "page":
                yield escape(part.text)

    def markdown(self, document: dict[str, Any]) -> str:
        """Return the notes and unfolded tables of the page, and the command and cost of the run, as Markdown."""
        parts = []
        for part in self.parts:
            if isinstance(part, Table) and not part.folded and part.only != "terminal":
                parts += [f"### {part.title}", part.note, part.markdown()]
            elif isinstance(part, Note) and not part.verbatim and part.only != "terminal":
                parts += [f"### {part.title}" if part.title else "", part.text]
        host, version = document["machine"], document["versions"]["grasp-refine"]
        made = f"{document['cpu_s'] / 60:.1f} minutes of CPU time on {host['cpus']} x {host['cpu']}, version {version}"
        return "\n\n".join(filter(None, [*parts, f"`{document['invocation']}`: {made}."])) + "\n"

    def page(self, document: dict[str, Any]) -> str:
        """Render the report as HTML; equal input gives equal text.

        Args:
            document: The JSON document of the benchmark.
        """
        kinds = {Table: "table", Chart: "chart", Note: "note", Figures: "figures"}
        parts = [(kinds[type(part)], part) for part in self.parts if isinstance(part, Chart) or part.only != "terminal"]
        return rendered(__package__, document=document, report=self, parts=parts)
