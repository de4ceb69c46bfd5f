"""Table of grasps as HTML: one row per grasp, one page at a time; clicks are sent through a widget of the page."""

from __future__ import annotations

from html import escape
from math import ceil

import numpy as np

from grasp_refine.core.array_types import Int
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import FAILED_TEXT, HELD, HELD_TEXT, HERE, STATUS, Column
from grasp_refine_apps.viewer.model.listing import MARK, NUMBER, Listing, column_of
from grasp_refine_apps.viewer.model.names import shortened
from grasp_refine_apps.viewer.panels.form import plain

ROWS_PER_PAGE = 15
"""Grasps on one page of the table."""
SHOWN_KEYS = (
    ("quality_after",),
    ("contact_error_m_after", "contact_distance_m_after"),
    ("penetration_m_after",),
    (HELD.key, STATUS.key),
    (HERE.key,),
    (MARK,),
)
"""Keys of the columns of the table; of several, the first one with known values."""
SHORT_LABELS = {
    "contact_error_m_after": "Error",
    "contact_distance_m_after": "Gap",
    "penetration_m_after": "Depth",
    HELD.key: "Test",
    NUMBER: "#",
}
"""Shorter labels for the narrow table."""
WIDTH_CLASSES = {
    "quality_after": "gr-wide",
    "penetration_m_after": "gr-wide",
    STATUS.key: "gr-word",
    HELD.key: "gr-word",
    HERE.key: "gr-word",
}
"""CSS classes of columns that are wider than a short number."""
CONVERGED_STATUS = "converged"
"""Status that is not coloured as a warning."""

STYLE = """<style>
.gr-table{font:11.5px/1.4 system-ui,sans-serif;margin:.3em .8em 1.4em}
.gr-table table{border-collapse:collapse;width:100%;table-layout:fixed}
.gr-table th,.gr-table td{padding:2px 3px;text-align:right;white-space:nowrap;overflow:hidden;text-overflow:ellipsis}
.gr-table th{cursor:pointer;user-select:none;border-bottom:1px solid rgba(128,128,128,.5);font-weight:600}
.gr-table th{vertical-align:top;width:42px}.gr-table th.gr-named{width:auto}.gr-table th.gr-wide{width:53px}
.gr-table th.gr-word{width:72px}
.gr-table th small{display:block;min-height:1.4em}
.gr-table small{font-weight:400;opacity:.65}
.gr-table td.gr-why{white-space:normal;text-align:left}
.gr-table th:first-child,.gr-table td:first-child{text-align:left}
.gr-table tbody tr{cursor:pointer;border-bottom:1px solid rgba(128,128,128,.18)}
.gr-table tbody tr:hover,.gr-table th:hover{background:rgba(128,128,128,.15)}
.gr-table tbody tr.gr-open,.gr-table tbody tr.gr-open:hover{background:rgba(34,139,230,.22)}
.gr-good{color:var(--gr-good)}.gr-bad{color:var(--gr-bad);font-weight:600}.gr-unsure{color:var(--gr-unsure)}
.gr-pages{display:flex;justify-content:space-between;align-items:center;padding-top:6px}
.gr-pages a{cursor:pointer;padding:1px 9px;border:1px solid rgba(128,128,128,.5);border-radius:4px;user-select:none}
.gr-pages a.gr-off{opacity:.3;pointer-events:none}
</style>"""
"""Style sheet for both colour schemes of the page."""


def shown_columns(collection: Collection) -> list[Column]:
    """Return the columns of the table, after the one that names the grasp."""
    found = []
    for keys in SHOWN_KEYS:
        columns = [column for key in keys if (column := column_of(collection, key)) is not None]
        known = [column for column in columns if column.known.any()]
        found += known[:1] or [column for column in columns if column.key == MARK]
    return found


def pages(numbers: Int[np.ndarray, " M"]) -> int:
    """Number of pages of a list, at least one."""
    return max(1, ceil(len(numbers) / ROWS_PER_PAGE))


def page_of(numbers: Int[np.ndarray, " M"], number: int) -> int:
    """Return the page of a list that holds a grasp; the first if it is not listed."""
    at = np.flatnonzero(numbers == number)
    return int(at[0]) // ROWS_PER_PAGE if len(at) else 0


def table_html(
    collection: Collection, listing: Listing, numbers: Int[np.ndarray, " M"], page: int, number: int, on_click: str
) -> str:
    """Return a page of the table.

    The attribute data-do of a row is "open <number>", of a header "sort <key>", and of an arrow "page <page>".

    Args:
        collection: The grasps.
        listing: Sorting of the grasps.
        numbers: Numbers of the listed grasps, in order.
        page: Number of the page, from 0.
        number: Number of the shown grasp.
        on_click: Script that sends the attribute data-do of the clicked part.
    """
    columns = shown_columns(collection)
    here = numbers[page * ROWS_PER_PAGE : (page + 1) * ROWS_PER_PAGE]
    several = len(collection.problem.groups) > 1 and len(set(collection.objects.tolist())) > 1
    first = _header(Column(NUMBER, "Grasp", "as in the file", np.zeros(0)), listing, "gr-named" if several else "")
    head = first + "".join(_header(column, listing, WIDTH_CLASSES.get(column.key, "")) for column in columns)
    body = "".join(_row(collection, columns, n, several=several, opened=n == number) for n in here.tolist())
    if not len(here):
        body = f'<tr><td colspan="{len(columns) + 1}">no grasp passes the filters</td></tr>'
    return (
        f'{STYLE}<div class="gr-table" onclick="{escape(on_click)}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        f"{footer_html(collection, numbers, page)}</div>"
    )


def _header(column: Column, listing: Listing, wide: str) -> str:
    label = SHORT_LABELS.get(column.key, column.label)
    arrow = ("▼ " if listing.descending else "▲ ") if column.key == listing.key else ""
    hint = f"{column.label}: {column.hint}; click to sort"
    return (
        f'<th class="{wide}" data-do="sort {escape(column.key)}" title="{escape(hint)}">{escape(label)}'
        f"<small>{arrow}{escape(column.unit)}</small></th>"
    )


def _row(collection: Collection, columns: list[Column], number: int, *, several: bool, opened: bool) -> str:
    group = collection.group(number)
    name = f" <small>{escape(shortened(group.object))}</small>" if several else ""
    why = collection.undrawn(number)
    if why:
        # Beside each other they would all be empty.
        cells = f'<td class="gr-unsure gr-why" colspan="{len(columns)}">{escape(plain(why))}</td>'
    else:
        cells = "".join(_cell(column, number) for column in columns)
    return (
        f'<tr data-do="open {number}"{" class=gr-open" if opened else ""} title="{escape(collection.name(number))}">'
        f"<td>{group.index[collection.member[number]]}{name}</td>{cells}</tr>"
    )


def _cell(column: Column, number: int) -> str:
    """Cell of a column; of work done here without the times, which are a hint."""
    text = column.text(number)
    if column.key == HERE.key:
        words = ", ".join(part.split(" ")[0] for part in text.split(", "))
        return f'<td title="{escape(text)}">{words}</td>'
    return f"<td{_class(column, number)}>{escape(text)}</td>"


def _class(column: Column, number: int) -> str:
    """Class of a cell, which sets its colour."""
    if not column.known[number]:
        return ""
    value = column.values[number]
    if column.key == "quality_after":
        name = "gr-good" if value >= HOLDS else "gr-unsure"
    elif column.key == STATUS.key:
        name = "" if value == CONVERGED_STATUS else "gr-unsure"
    else:
        name = {HELD_TEXT: "gr-good", "good": "gr-good", FAILED_TEXT: "gr-bad", "bad": "gr-bad"}.get(str(value), "")
    return f' class="{name}"' if name else ""


def footer_html(collection: Collection, numbers: Int[np.ndarray, " M"], page: int) -> str:
    """Return the arrows and the place in the list below a page of it."""
    last = pages(numbers) - 1
    first, end = page * ROWS_PER_PAGE + 1, min((page + 1) * ROWS_PER_PAGE, len(numbers))
    text = f"{first} to {end} of {len(numbers)}" if len(numbers) else "none"
    text += "" if len(numbers) == len(collection) else f" listed, {len(collection)} in all"

    def arrow(to: int, sign: str, title: str) -> str:
        off = " class=gr-off aria-disabled=true" if not 0 <= to <= last or to == page else ""
        return f'<a data-do="page {min(max(to, 0), last)}" title="{title}"{off}>{sign}</a>'

    return (
        '<div class="gr-pages">'
        f"<span>{arrow(0, '«', 'first page')} {arrow(page - 1, '‹', 'page before')}</span><span>{text}</span>"
        f"<span>{arrow(page + 1, '›', 'next page')} {arrow(last, '»', 'last page')}</span></div>"
    )
