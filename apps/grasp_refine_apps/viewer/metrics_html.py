"""Measures of one grasp, before and after refinement, as a few lines of HTML."""

from __future__ import annotations

from html import escape

from grasp_refine.validation.measures import COMPARED, Measure
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.columns import FAILED_TEXT, HELD, REASON, STATUS
from grasp_refine_apps.viewer.measuring import unmeasured

STYLE = """<style>
.gr-metrics{font:13px/1.45 system-ui,sans-serif;margin:.2em .8em .6em;overflow-wrap:anywhere}
.gr-metrics table{border-collapse:collapse}
.gr-metrics td{padding:0 14px 0 0}.gr-metrics td:nth-child(n+2){text-align:right}
.gr-metrics td:last-child{font-weight:600}
</style>"""
"""Style sheet."""


def metrics_html(collection: Collection, number: int) -> str:
    """Return name, status, verdict and measures of a grasp as HTML; of a refined one, before and after."""
    heading = [f"<b>{escape(collection.label(number))}</b> as in its file"]
    status, held, reason = (collection.columns.get(column.key) for column in (STATUS, HELD, REASON))
    if status is not None and status.known[number]:
        heading.append(escape(status.text(number)))
    if held is not None and held.known[number]:
        why = f" ({reason.text(number)})" if reason is not None and reason.known[number] else ""
        failed = held.values[number] == FAILED_TEXT
        heading.append(escape(f"{'failed' if failed else 'held'} in simulation{why}"))
    if collection.mark(number):
        heading.append(f"marked {escape(collection.mark(number))}")
    rows = [row for measure in COMPARED if (row := _row(collection, measure, number))]
    if not rows:
        text = "not measured yet" if unmeasured(collection)[number] else "could not be measured"
    else:
        refined = any(len(row) > 2 for row in rows)
        head = ("", "before", "after") if refined else ()
        text = "<table>" + "".join(_line(row) for row in ([head] if head else []) + rows) + "</table>"
    return f'{STYLE}<div class="gr-metrics">{" · ".join(heading)}<br>{text}</div>'


def _row(collection: Collection, measure: Measure, number: int) -> tuple[str, ...]:
    """Name and value of a measure, or name, value before and value after; empty where it is not known."""
    before, after = (collection.columns.get(entry) for entry in measure.entries.values())
    if after is None or not after.known[number]:
        return ()
    if before is None or not before.known[number]:
        return after.title, after.text(number)
    return after.title, before.text(number), after.text(number)


def _line(row: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
