"""HTML page of `run` and `validate`: the largest change, the verdicts, and a card for each grasp with its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from grasp_refine.core.plurals import count_text
from grasp_refine.core.versions import versions
from grasp_refine_apps.batch.page import case_entry
from grasp_refine_apps.grasp_page.sheet import Sheet
from grasp_refine_apps.report.html_page import rendered


def page(sheets: Sequence[tuple[Sheet, tuple[str, ...]]], path: Path, *, invocation: str, margins: str = "") -> str:
    """Format the page as HTML.

    Args:
        sheets: The grasps, of each file or of all, with options of `refine-grasp view` to show them.
        path: Path of the page, from whose folder links begin.
        invocation: The command.
        margins: HTML of the margins of the grasps; empty: they are not known.
    """
    entries = []
    for sheet, look in sheets:
        cases = [case_entry(picture) for picture in sheet.pictures(path.parent, look)]
        unlisted = len(sheet) - len(cases)
        entries.append(
            {
                "title": sheet.title,
                "tiles": sheet.tiles(),
                "lines": sheet.lines,
                "simulated": sheet.held is not None,
                "cases": cases,
                "unlisted": count_text(unlisted, "other") if unlisted else "",
            }
        )
    hands = dict.fromkeys(sheet.problem.hand.name for sheet, _ in sheets)
    objects = dict.fromkeys(name for sheet, _ in sheets for name in sheet.problem.names)
    return rendered(
        __package__,
        title=f"{count_text(sum(len(sheet) for sheet, _ in sheets), 'grasp')} of {', '.join(hands)}",
        subtitle=f"on {', '.join(objects) if len(objects) <= 8 else count_text(len(objects), 'object')}",
        single=len(sheets[0][0].sides) == 1,
        sheets=entries,
        margins=Markup(margins),
        invocation=invocation,
        versions=versions(),
    )
