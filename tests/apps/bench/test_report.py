"""Reports: numbers in their units, the best of a column, charts that repeat themselves, one self-contained page."""

from __future__ import annotations

import re
from typing import Any

import pytest

from grasp_refine_apps.bench.chart import Axis, Chart
from grasp_refine_apps.bench.report import Column, Note, Report, Table

ROWS = [
    {"name": "[a]", "gap_m": 1e-3, "turn_rad": 0.1, "share": 0.5, "ms": 2.0, "last": {"share": 0.25}, "warm": True},
    {"name": "<b>", "gap_m": 2e-6, "turn_rad": None, "share": 0.75, "ms": 3.0, "last": None, "warm": False},
]


@pytest.mark.parametrize(
    ("column", "texts"),
    [
        (Column("name", "name"), ["[a]", "<b>"]),
        (Column("gap_m", "gap", "mm"), ["1", "0.002"]),
        (Column("gap_m", "gap", "µm", ".0f"), ["1000", "2"]),
        (Column("gap_m", "gap", "m", ".0e"), ["1e-3", "2e-6"]),
        (Column("turn_rad", "turn", "°", ".2f"), ["5.73", "–"]),
        (Column("share", "hits", "%", ".1f"), ["50.0", "75.0"]),
        (Column("ms", "CPU", "ms", ".1f"), ["2.0", "3.0"]),
        (Column("last.share", "last", "%", ".0f"), ["25", "–"]),
        (Column("warm", "warm"), ["yes", ""]),
        (Column("ms", "CPU", form=lambda value: f"about {value:g}"), ["about 2", "about 3"]),
    ],
)
def test_numbers_are_shown_in_their_unit(column: Column, texts: list[str]):
    assert [column.text(row) for row in ROWS] == texts


@pytest.mark.parametrize(("better", "best"), [("higher", "75.0"), ("lower", "50.0"), (None, None)])
def test_the_best_of_a_column_stands_out(better: Any, best: str | None):
    assert Column("share", "hits", "%", ".1f", better).best(ROWS) == best
    assert Column("share", "hits", "%", ".1f", better).best(ROWS[:1]) is None


def table(**changed: Any) -> Table:
    columns = (
        Column("name", "name"),
        Column("share", "hits at all", "%", ".1f", "higher"),
        Column("ms", "CPU", "ms", only="page"),
        Column("gap_m", "gap", "mm", only="terminal"),
    )
    return Table("some rows", columns, ROWS, **changed)


DOCUMENT = {
    "preset": "smoke", "seed": 3, "invocation": "refine-grasp bench <x>", "cpu_s": 2.0, "engine": "native",
    "machine": {"cpus": 2, "cpu": "a processor", "system": "Linux"}, "versions": {"coal": "3"},
    "problems": ["it <broke>"],
}  # fmt: skip


def chart(**changed: Any) -> Chart:
    rows = [{"x": 10.0**k, "y": 0.1 * k, "line": f"line {line}"} for k in range(3) for line in range(2)]
    rows.append({"x": None, "y": 0.15, "line": "a level"})
    axes = {"x": Axis("x", "time", "s"), "y": (Axis("y", "hits", "%", least=0.01),)} | changed
    return Chart("Hits over time", rows, axes["x"], axes["y"], lambda row: row["line"], lambda row: "panel")


def test_a_page_holds_everything_and_escapes_names():
    pytest.importorskip("matplotlib")
    parts = [Note("one\n\ntwo", "Intro"), chart(), table()]
    report = Report("A benchmark", [*parts, Table("terminal", (), (), only="terminal")])
    text = report.page(DOCUMENT)
    assert text == report.page(DOCUMENT) and not re.search(r"""(?:src|href)=["']https?:""", text)
    assert "<p>one</p>" in text and "<p>two</p>" in text and text.count("<svg") == 1 and "<b>75.0</b>" in text
    assert "&lt;b&gt;" in text and "it &lt;broke&gt;" in text and "bench &lt;x&gt;" in text
    assert "terminal" not in text
    assert "hits at all, %" in text and "CPU, ms" in text and "gap" not in text.partition("<body>")[2]
