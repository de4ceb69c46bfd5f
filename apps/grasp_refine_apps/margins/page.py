"""Page with charts of the margins of grasps: by factor, and the share of grasps that hold by limit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from grasp_refine.core.plurals import count_text
from grasp_refine.results.margins_table import LIMITS
from grasp_refine.validation.margins.factors import JOINT, MEANING
from grasp_refine.validation.margins.intervals import difference_interval
from grasp_refine_apps.margins.charts import Side, color_names, factor_bars, limit_curve
from grasp_refine_apps.report.html_page import rendered


def page(files: Sequence[str], sides: Sequence[Side], *, compared: bool, seed: int) -> str:
    """Format the margins as HTML, a part of a page; the same input gives the same text.

    Args:
        files: Names of the files, one for each side.
        sides: Margins of the grasps of each file.
        compared: Whether two files hold the same grasps before and after.
        seed: Seed of the drawn worlds.
    """
    draws = sides[0].margins.draws
    counts = ", ".join(f"{side.name}: {count_text(len(side.margins), 'grasp')}" for side in sides)
    with_limits = all(side.margins.limits is not None for side in sides)
    return rendered(
        __package__,
        subtitle=f"{counts}; {count_text(draws, 'drawn world')} of seed {seed}, the same for all",
        sides=[(look, side.name, name) for look, side, name in zip(color_names(len(sides)), sides, files, strict=True)],
        bars=factor_bars(sides),
        meanings=[(name, MEANING[name]) for name in _trials(sides)],
        rows=list(_rows(sides)),
        changes=list(_changes(*sides)) if compared else [],
        curves=[
            {"title": f"{limit.title}, {limit.unit}".rstrip(", "), "svg": limit_curve(limit, sides)} for limit in LIMITS
        ]
        if with_limits
        else [],
    )


def _rows(sides: Sequence[Side]) -> list[list[str]]:
    """Return the cells of a table: trial, and for each side the number of grasps that it costs most."""
    counts = [Counter(side.margins.worst.tolist()) for side in sides]
    return [[name, *(str(each[name]) for each in counts)] for name in _trials(sides) if name != JOINT]


def _trials(sides: Sequence[Side]) -> list[str]:
    """Return the names of all trials."""
    return list(dict.fromkeys(name for side in sides for name in side.margins.trials))


def _changes(before: Side, after: Side) -> list[list[str]]:
    """Return the cells of a table: trial, change of the probability and its interval, better and worse grasps."""
    rows = []
    for name in (name for name in after.margins.trials if name in before.margins.trials):
        old, new = before.margins.held[name], after.margins.held[name]
        change, low, high = (100 * value for value in difference_interval(old, new))
        more = new.sum(axis=1) - old.sum(axis=1)
        numbers = f"{change:+.1f}", f"{low:+.1f} to {high:+.1f}", str(int((more > 0).sum())), str(int((more < 0).sum()))
        rows.append([name, *numbers])
    return rows
