"""Labels and order of rows as people read them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, get_args

import numpy as np

from grasp_refine_apps.bench.align.bodies import KINDS
from grasp_refine_apps.bench.align.variants import MethodName, SolverName
from grasp_refine_apps.bench.chart import Row

METHODS: tuple[str, ...] = (*get_args(MethodName), *get_args(SolverName)[1:])
"""Order of the methods of descent and of the other solvers."""
SETTINGS = (
    "solver", "neighborhood", "coupling", "transport", "optimise", "margin", "step_size", "witness", "epsilon", "dtype",
)  # fmt: skip
"""Settings in which rows of one method may differ, in the order of a label."""
SWEPT = {"margin": "contact margin", "step_size": "step size of rotations at the start"}
"""Settings with a chart of their own when several values were run -> name on the axis."""


def name_of(row: Row) -> str:
    """First word of a row's label: the method of descent, or the other solver."""
    return row["method"] if row["solver"] == "descent" else row["solver"]


def micrometres(epsilon: float) -> str:
    """Format the epsilon of a patch witness for people."""
    return f"{1e6 * epsilon:g} µm"


def epsilons(rows: Iterable[Row]) -> str:
    """List every epsilon of a patch witness among rows; empty without any."""
    return ", ".join(map(micrometres, sorted({row["patch"]["epsilon"] for row in rows if row["patch"]})))


def labels_of(rows: Sequence[Row], without: Iterable[str] = ()) -> list[str]:
    """Return a short label for each row: its method, and those settings that differ among the rows of that method.

    A patch witness is always named, with its epsilon.

    Args:
        rows: All rows that are shown together.
        without: Settings to leave out of the labels.
    """
    keys = [key for key in SETTINGS if key not in {*without, "solver", "witness", "epsilon"}]
    varying = {}
    for name in {name_of(row) for row in rows}:
        same = [row for row in rows if name_of(row) == name]
        varying[name] = [key for key in keys if len({row[key] for row in same}) > 1]

    def label(row: Row) -> str:
        settings = [_words(key, row[key]) for key in varying[name_of(row)]]
        patch = f"patch {micrometres(row['epsilon'])}" if row["witness"] == "patch" else ""
        return " + ".join(filter(None, [name_of(row), *settings, patch]))

    return [label(row) for row in rows]


def _words(key: str, value: Any) -> str:
    """Format a setting as part of a label; empty for defaults."""
    if value is None:
        return ""
    if key == "transport":
        return "EG" if value else ""
    if key == "margin":
        return f"margin {1e3 * value:g} mm"
    if key == "step_size":
        return f"step {value:g}"
    return {"T2": "", "T1T2": "both bodies move"}.get(value, str(value))


def ordered(rows: Iterable[Row]) -> list[Row]:
    """Sort labelled rows by kind, method, settings, pair and target class, then by budget, smallest first."""

    def place(row: Row) -> tuple[Any, ...]:
        return (
            KINDS.index(row["kind"]),
            METHODS.index(name_of(row)),
            *((row[key] is not None, row[key] or 0) for key in SWEPT),
            row["label"],
            row["pair"],
            row["target_class"],
            budget(row),
        )

    return sorted(rows, key=place)


def budget(row: Row) -> tuple[float, float]:
    """Sort key that grows with the budget of a row, for rows of one variant."""
    return row["budget_s"] or 0.0, row["budget"] or 0.0


def at_largest_budget(rows: Sequence[Row]) -> list[Row]:
    """Select the labelled rows with the largest budget of each variant, kind, pair and target class."""
    best: dict[tuple[str, ...], Row] = {}
    for row in rows:
        key = tuple(row[name] for name in ("label", "kind", "pair", "target_class"))
        if key not in best or budget(row) > budget(best[key]):
            best[key] = row
    return list(best.values())


def at_best(rows: Sequence[Row], key: str) -> list[Row]:
    """Select the labelled rows of each variant at the value of `key` with the most hits at its largest budget."""
    names = dict(zip(map(id, rows), labels_of(rows, without=[key]), strict=True))
    hits: dict[str, dict[Any, list[float]]] = {}
    for row in at_largest_budget(rows):
        hits.setdefault(names[id(row)], {}).setdefault(row[key], []).append(row["acc_1e6"] or 0.0)
    best = {name: max(shares, key=lambda value: np.mean(shares[value])) for name, shares in hits.items()}
    return [row for row in rows if row[key] == best[names[id(row)]]]


def pooled(rows: Iterable[Row]) -> list[Row]:
    """Select the rows over all pairs and all target classes."""
    return [row for row in rows if row["pair"] == "all" and row["target_class"] == "all"]


def swept(rows: Sequence[Row]) -> list[str]:
    """Return the settings of `SWEPT` that have several values with one method."""

    def values(key: str, method: str) -> int:
        return len({row[key] for row in rows if name_of(row) == method} - {None})

    return [key for key in SWEPT if any(values(key, method) > 1 for method in {name_of(row) for row in rows})]


def kinds_of(rows: Iterable[Row]) -> list[str]:
    """Return the kinds among rows, convex first."""
    found = {row["kind"] for row in rows}
    return [kind for kind in KINDS if kind in found]
