"""Labels and groups of rows as people read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from grasp_refine_apps.bench.grasp.rows import Row
from grasp_refine_apps.bench.grasp.variants import Variant

SHORT = {"levenberg-marquardt": "LM"}
"""Abbreviations of solvers."""

SIZES: Mapping[str, str] = MappingProxyType(
    {"batch": "batch", "contacts": "contacts_mean", "pieces": "pieces_mean", "processes": "processes"}
)
"""Sizes in which variants may differ -> explanation."""


def label(row: Row) -> str:
    """Return the solver, and its derivative if that is not the default."""
    solver: str = row["solver"]
    name = SHORT.get(solver, solver)
    return name if row["derivative"] == Variant.derivative else f"{name}, {row['derivative']}"


def batch(row: Row) -> str:
    """Return the batch size, and the mean number of grasps in a batch if smaller."""
    mean = round(row["batch_mean"])
    return f"{row['batch']}" if mean >= row["batch"] else f"{row['batch']} ({mean})"


def varied(rows: Sequence[Row]) -> list[str]:
    """Return the sizes in which rows differ."""
    return [name for name in SIZES if len({row[name] for row in rows}) > 1]


def pooled(rows: Sequence[Row], task: str) -> list[Row]:
    """Select the rows over all objects, of one kind of task."""
    return [row for row in rows if row["object"] == "all" and row["task"] == task]


def sets_of(rows: Sequence[Row]) -> list[str]:
    """Names of the sets in the order of the rows."""
    return list(dict.fromkeys(row["set"] for row in rows))


def deep(row: Row) -> str:
    """Format the numbers of deep starts and of those that did not escape."""
    return "-" if row["deep_starts"] is None else f"{row['deep_stuck']}/{row['deep_starts']}"
