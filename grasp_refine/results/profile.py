"""Time of a command by stage, as a table and as an entry of its JSON document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table

from grasp_refine.core.profiling import STAGES

Profile = Mapping[str, Sequence[float]]
"""Stage -> [CPU seconds, wall seconds, calls], as `Stopwatch.profile` returns it."""


def profile_table(profile: Profile) -> Table:
    """Return the table of stages that took any time, each with its share of the CPU time of all."""
    cpu_s, wall_s = (sum(spent[part] for spent in profile.values()) for part in (0, 1))
    table = Table("stage", title="where the time went", title_justify="left", box=box.SIMPLE)
    for name in ("CPU s", "%", "wall s", "calls"):
        table.add_column(name, justify="right")
    for name in STAGES:
        cpu, wall, calls = profile[name]
        if calls or name == STAGES[-1]:
            share = 100.0 * cpu / cpu_s if cpu_s > 0 else 0.0
            table.add_row(name, f"{cpu:.2f}", f"{share:.1f}", f"{wall:.2f}", f"{calls:.0f}" if calls else "")
    table.add_section()
    table.add_row("all", f"{cpu_s:.2f}", "100.0", f"{wall_s:.2f}", "")
    return table


def profile_entry(profile: Profile | None) -> dict[str, dict[str, Any]] | None:
    """Return the times of all stages for a JSON document; None without a profile."""
    if profile is None:
        return None
    return {name: dict(zip(("cpu_s", "wall_s", "calls"), profile[name], strict=True)) for name in STAGES}
