"""What a person reads when a batch ends: a line for each hand and object, totals, and what failed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isnan
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from grasp_refine.report.table import plain_table
from grasp_refine.report.verdict import BAR

from . import words
from .failed import failed_text, left_over
from .statistics import UNUSABLE, Statistics, Tally

ROWS, FAILURES = 20, 20
"""Most hands and objects, and most failed shards, that are listed."""


def batch_table(document: Mapping[str, Any], statistics: Statistics) -> RenderableType:
    """Tables and lines for a terminal of 80 columns or more.

    Args:
        document: What the batch writes as JSON.
        statistics: Of all grasps of complete shards.
    """
    parts: list[RenderableType] = []
    if statistics.all.count:
        parts += [_table(statistics), "", *_verdict(statistics)]
    parts += _failures(document.get("failed", []))
    parts += _account(document.get("totals", {}), document.get("failed", []))
    return Group(*parts)


def _table(statistics: Statistics) -> Table:
    simulated = statistics.held is not None
    pairs, rest = statistics.by_pair(ROWS)
    hands = len({hand for hand, _ in statistics.pairs})
    table = plain_table(
        f"{words.grasps(statistics.all.count)}, most failures first" if len(pairs) > 1 else "", between=0
    )
    # Where there is no room, names go on in a second line, numbers never.
    table.add_column("\nobject" if hands == 1 else "\nhand, object", overflow="fold")
    middle = "held\n%" if simulated else "con-\nverged"
    for head in ("\ngrasps", middle, "should hold\n%", "quality\nmean", "deepest\nmm"):
        table.add_column(head, justify="right", no_wrap=True)
    for (hand, name), tally in pairs:
        table.add_row(escape(name if hands == 1 else f"{hand}, {name}"), *_cells(tally, simulated))
    others = len(statistics.pairs) - len(pairs)
    if rest.count:
        # Those that are counted together only are too many to be told.
        table.add_row(f"{'many' if statistics.rest.count else others} others", *_cells(rest, simulated), style="dim")
    if len(pairs) > 1:
        table.add_section()
        table.add_row("all", *_cells(statistics.all, simulated))
    return table


def _cells(tally: Tally, simulated: bool) -> list[RenderableType]:
    held = _change(tally.held_before, tally.held_after, tally.simulated)
    return [
        words.whole(tally.count),
        held if simulated else words.whole(tally.converged),
        _change(tally.good_before, tally.good_after, tally.count),
        " → ".join("-" if isnan(value) else f"{value:.3f}" for value in tally.mean_quality),
        f"{1e3 * tally.deepest:.2f}",
    ]


def _change(before: int, after: int, of: int) -> Text:
    """Percentages, in green where nearly all hold, and in red where fewer do than before."""
    if not of:
        return Text("-")
    shown = [words.share(part, of).removesuffix(" %") for part in (before, after)]
    color = "red" if after < before else "green" if after >= 0.95 * of else "yellow"
    return Text.assemble(f"{shown[0]:>4} → ", (f"{shown[1]:>4}", color))


def _verdict(statistics: Statistics) -> Iterator[Text]:
    its = statistics.all
    good = Text.assemble(
        (f"{words.whole(its.good_after)} of {words.grasps(its.count)} should hold", _color(its.good_after, its.count)),
        f" (quality {BAR}), {words.whole(its.good_before)} as they came",
    )
    yield good
    if statistics.held is not None:
        before, after = statistics.held
        yield Text.assemble(
            (f"{words.whole(after)} of {words.whole(its.simulated)} hold in simulation", _color(after, its.simulated)),
            f", {words.whole(before)} as they came",
        )
        for name, count in sorted(statistics.reasons.items(), key=lambda entry: (-entry[1], entry[0])):
            yield Text.assemble("  ", (f"{words.whole(count)} {name}", "red"))
    if its.usable < its.count:
        unusable = ((name, statistics.statuses[name]) for name in sorted(statistics.statuses) if name in UNUSABLE)
        said = ", ".join(f"{words.whole(count)} {name}" for name, count in unusable)
        yield Text.assemble((f"{words.whole(its.count - its.usable)} were not refined", "yellow"), f": {said}")


def _color(part: int, of: int) -> str:
    return "green" if part >= 0.95 * of else "yellow"


def _failures(failed: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    if not failed:
        return
    yield ""
    yield Text(f"{failed_text(failed)} failed:", "red")
    for one in failed[:FAILURES]:
        tries = f", {one['tries']} times" if one.get("tries", 1) > 1 else ""
        yield Text.assemble("  ", (str(one["name"]), "bold"), f": {one['reason']}{tries}: {one['message']}")
    if len(failed) > FAILURES:
        yield Text(f"  and {words.whole(len(failed) - FAILURES)} more, in the JSON summary and the report")


def _account(totals: Mapping[str, Any], failed: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """What it took, and what is left."""
    left = left_over(totals, failed)
    if left:
        yield Text(f"{words.whole(left)} of {words.count(totals['shards'], 'shard')} to be done yet", "yellow")
    said = []
    if totals.get("grasps_per_s"):
        said.append(words.rate(totals["grasps_per_s"]))
    if totals.get("cpu_s_per_grasp") is not None:
        said.append(f"{words.duration(totals['cpu_s_per_grasp'])} of CPU time each")
    if totals.get("peak_bytes"):
        said.append(f"at most {words.mebibytes(totals['peak_bytes'])} a process")
    if said:
        yield Text(", ".join(said))
