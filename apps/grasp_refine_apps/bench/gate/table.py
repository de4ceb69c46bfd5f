"""The table that the gate prints."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.table import Table

from grasp_refine_apps.bench.gate.baseline import Verdict

WORDS = {True: "[green]ok[/]", False: "[bold red]FAIL[/]", None: "[dim]not available[/]"}


def gate_table(verdicts: Sequence[Verdict]) -> Table:
    """Make a table with a line for each ratio: now, before, the limit, and its meaning."""
    table = Table("ratio", box=box.SIMPLE, padding=(0, 1, 0, 0), show_edge=False)
    for name in ("now", "before", "allowed"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    table.add_column("meaning")
    for one in verdicts:
        notes = " (measured twice)" if one.again else ""
        if one.ok is False and one.ratio.own:
            notes += ", or what it is compared with got faster"
        bound = "" if one.known is None else f"{'≥' if one.ratio.higher else '≤'} {one.known.limit:.3g}"
        table.add_row(
            one.ratio.name,
            "-" if one.now is None else f"{one.now:.3g}",
            "-" if one.known is None else f"{one.known.value:.3g}",
            bound,
            WORDS[one.ok],
            one.ratio.what + notes,
        )
    return table
