"""Labels and groups of rows as people read them."""

from __future__ import annotations

from collections.abc import Sequence

from grasp_refine_apps.bench.queries.peers import PEERS
from grasp_refine_apps.bench.queries.rows import Row

PEER_LABELS = {peer.name: peer.what for peer in PEERS}
"""Peer -> its explanation."""


def queries(rows: Sequence[Row]) -> list[Row]:
    """Select the rows on queries."""
    return [row for row in rows if row["table"] == "queries"]


def skips(rows: Sequence[Row]) -> list[Row]:
    """Select the rows on skips."""
    return [row for row in rows if row["table"] == "skips"]


def case_of(row: Row) -> tuple[str, int, int, str, int]:
    """Return the case of a row."""
    return tuple(row[name] for name in ("kind", "pieces", "vertices", "state", "batch"))


def cases(rows: Sequence[Row]) -> list[list[Row]]:
    """Group the rows on queries by case: ours first."""
    found: dict[tuple[str, int, int, str, int], list[Row]] = {}
    for row in queries(rows):
        found.setdefault(case_of(row), []).append(row)
    return list(found.values())


def bodies(row: Row) -> str:
    """Format the two bodies: pieces by vertices of each."""
    return f"{row['kind']} {row['pieces']}x{row['vertices']}"


def label(row: Row) -> str:
    """Name of the engine or peer."""
    return f"{row['by']}, warm" if row["warm"] else row["by"]


def methods(rows: Sequence[Row]) -> list[str]:
    """Keys of the times of backward passes."""
    return [name for name in queries(rows)[0] if name.startswith("backward_")] if queries(rows) else []


def method(key: str) -> str:
    """Name of the derivative method in such a key."""
    return key.removeprefix("backward_").removesuffix("_us").replace("_", " ")
