"""Terminal summary of a batch: a line for each hand and object, totals, and failures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isnan
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from grasp_refine.core.plurals import count_text, whole
from grasp_refine.measures.measures import SIDES
from grasp_refine.results.table import plain_table
from grasp_refine.results.verdict import HOLDS, estimate_line, held_line
from grasp_refine.scene.protocols.protocol_file import protocol_of
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.failed import failed_text, left_over, suspected_text
from grasp_refine_apps.batch.statistics import UNUSABLE, Statistics, Tally

MAX_PAIRS, MAX_FAILURES = 20, 20
"""Maximum numbers of listed pairs of hand and object, and of failed shards."""


def batch_table(document: Mapping[str, Any], statistics: Statistics) -> RenderableType:
    """Format the summary for a terminal of 80 columns or more.

    Args:
        document: JSON document of the batch.
        statistics: Statistics of all grasps of complete shards.
    """
    parts: list[RenderableType] = []
    if statistics.all.count:
        parts += [_table(statistics), "", *verdict_lines(document, statistics)]
        parts += [*statistics.changed.lines(), *_unusable(statistics)]
    parts += _failures(document.get("failed", []))
    parts += _account(document.get("totals", {}), document.get("failed", []))
    return Group(*parts)


def _table(statistics: Statistics) -> Table:
    simulated = statistics.held is not None
    pairs, rest = statistics.by_pair(MAX_PAIRS)
    hands = len({hand for hand, _ in statistics.pairs})
    table = plain_table(
        f"{words.grasps(statistics.all.count)}, most failures first" if len(pairs) > 1 else "", between=0
    )
    # Where space is short, names wrap into a second line, numbers never.
    table.add_column("\nobject" if hands == 1 else "\nhand, object", overflow="fold")
    middle = "held\n%" if simulated else "con-\nverged"
    for head in ("\ngrasps", middle, f"quality ≥\n{HOLDS:.3f}, %", "quality\nmean", "deepest\nmm"):
        table.add_column(head, justify="right", no_wrap=True)
    for (hand, name), tally in pairs:
        table.add_row(escape(name if hands == 1 else f"{hand}, {name}"), *_cells(tally, simulated))
    others = len(statistics.pairs) - len(pairs)
    if rest.count:
        # The number of pairs that are only counted together is not known.
        table.add_row(f"{'many' if statistics.rest.count else others} others", *_cells(rest, simulated), style="dim")
    if len(pairs) > 1:
        table.add_section()
        table.add_row("all", *_cells(statistics.all, simulated))
    return table


def _cells(tally: Tally, simulated: bool) -> list[RenderableType]:
    held = _change(*tally.held, tally.simulated)
    return [
        whole(tally.count),
        held if simulated else whole(tally.converged),
        _change(int(tally.good[0]), int(tally.good[1]), tally.count),
        " → ".join("-" if isnan(value) else f"{value:.3f}" for value in tally.mean_quality),
        f"{1e3 * tally.deepest:.2f}",
    ]


def _change(before: int, after: int, of: int) -> Text:
    """Percentages before and after, green if nearly all hold, red if fewer do than before."""
    if not of:
        return Text("-")
    shown = [words.share(part, of).removesuffix(" %") for part in (before, after)]
    color = "red" if after < before else "green" if after >= 0.95 * of else "yellow"
    return Text.assemble(f"{shown[0]:>4} → ", (f"{shown[1]:>4}", color))


def verdict_lines(document: Mapping[str, Any], statistics: Statistics) -> list[Text]:
    """Lines with the numbers of grasps that held in simulation before and after, or with an estimate by quality."""
    tally = statistics.all
    if not tally.simulated:
        return [estimate_line(int(tally.good[1]), int(tally.good[0]), tally.count)]
    described = (document.get("config") or {}).get("protocol")
    protocol = protocol_of(described).label if described else ""
    return [
        held_line(protocol, tally.held, tally.gained, tally.lost, tally.simulated),
        *(
            Text.assemble("  ", (f"{whole(count)} {name}", "red"))
            for name, count in sorted(statistics.reasons.items(), key=lambda entry: (-entry[1], entry[0]))
        ),
        *(side.line(f"{name}, ") for name, side in zip(SIDES, tally.agreement, strict=True)),
    ]


def _unusable(statistics: Statistics) -> Iterator[Text]:
    """Line with the number of grasps that were not refined, and their statuses."""
    tally = statistics.all
    if tally.usable < tally.count:
        unusable = ((name, statistics.statuses[name]) for name in sorted(statistics.statuses) if name in UNUSABLE)
        counts = ", ".join(f"{whole(count)} {name}" for name, count in unusable)
        left = tally.count - tally.usable
        yield Text.assemble((f"{whole(left)} {'was' if left == 1 else 'were'} not refined", "yellow"), f": {counts}")


def _failures(failed: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    if not failed:
        return
    yield ""
    yield Text(f"{failed_text(failed)} failed{suspected_text(failed)}:", "red")
    for one in failed[:MAX_FAILURES]:
        tries = f", {one['tries']} times" if one.get("tries", 1) > 1 else ""
        yield Text.assemble("  ", (str(one["name"]), "bold"), f": {one['reason']}{tries}: {one['message']}")
    if len(failed) > MAX_FAILURES:
        yield Text(f"  and {whole(len(failed) - MAX_FAILURES)} more, in the JSON summary and the report")


def _account(totals: Mapping[str, Any], failed: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """Lines with the cost, and with the shards left."""
    left = left_over(totals, failed)
    if left:
        yield Text(f"{whole(left)} of {count_text(totals['shards'], 'shard')} to be done yet", "yellow")
    costs = []
    if totals.get("grasps_per_s"):
        costs.append(words.rate(totals["grasps_per_s"]))
    if totals.get("cpu_s_per_grasp") is not None:
        costs.append(f"{words.duration(totals['cpu_s_per_grasp'])} of CPU time each")
    if totals.get("peak_bytes"):
        costs.append(f"at most {words.mebibytes(totals['peak_bytes'])} a process")
    if costs:
        yield Text(", ".join(costs))
