"""Labels and order of rows as people read them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, get_args

from grasp_refine_apps.bench.align.bodies import KINDS
from grasp_refine_apps.bench.align.variants import MethodName, SolverName

Row = dict[str, Any]

METHODS: tuple[str, ...] = (*get_args(MethodName), *get_args(SolverName)[1:])
"""Order of the methods of descent and of the other solvers; each has the colour and the marker of that position."""
SETTINGS = (
    "solver", "neighborhood", "coupling", "transport", "optimise", "margin", "step_size", "witness", "epsilon", "dtype",
)  # fmt: skip
"""Settings in which rows of one method may differ, in the order of a label."""
SWEPT = {"margin": "contact margin", "step_size": "step size of rotations at the start"}
"""Settings with a chart of their own when several values were run -> name on the axis."""


def name_of(row: Row) -> str:
    """First word of a row's label: the method of descent, or the other solver."""
    return row["method"] if row.get("solver") in (None, "descent") else row["solver"]


def micrometres(epsilon: float) -> str:
    """Format the epsilon of a patch witness for people."""
    return f"{1e6 * epsilon:g} µm"


def epsilons(rows: Iterable[Row]) -> str:
    """List every epsilon of a patch witness among rows; empty without any."""
    found = sorted({row["patch"]["epsilon"] for row in rows if row.get("patch")})
    return ", ".join(map(micrometres, found))


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
        varying[name] = [key for key in keys if len({row.get(key) for row in same}) > 1]

    def label(row: Row) -> str:
        settings = [_words(key, row.get(key)) for key in varying[name_of(row)]]
        patch = f"patch {micrometres(row['epsilon'])}" if row.get("witness") == "patch" else ""
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


def ordered(rows: Iterable[Row], label: Callable[[Row], str]) -> list[Row]:
    """Sort rows by kind, method, settings, pair and target class, then from the smallest to the largest budget."""

    def place(row: Row) -> tuple:
        kind, method = row["kind"], name_of(row)
        return (
            KINDS.index(kind) if kind in KINDS else len(KINDS),
            METHODS.index(method) if method in METHODS else len(METHODS),
            *((row.get(key) is not None, row.get(key) or 0) for key in ("margin", "step_size")),
            label(row),
            row["pair"],
            row["target_class"],
            budget(row),
        )

    return sorted(rows, key=place)


def budget(row: Row) -> tuple[float, float, float]:
    """Sort key that grows with the budget of a row, for rows of one variant."""
    return row.get("budget_s") or 0.0, row.get("budget") or 0.0, row.get("cpu_s_per_pair") or 0.0


def at_largest_budget(rows: Sequence[Row], labels: Sequence[str]) -> list[Row]:
    """Select the rows with the largest budget of each variant, kind, pair and target class, in the given order."""
    best: dict[tuple, Row] = {}
    for row, label in zip(rows, labels, strict=True):
        key = label, row["kind"], row["pair"], row["target_class"]
        if key not in best or budget(row) > budget(best[key]):
            best[key] = row
    return list(best.values())


def pooled(rows: Iterable[Row]) -> list[Row]:
    """Select the rows over all pairs and all target classes."""
    return [row for row in rows if row["pair"] == "all" and row["target_class"] == "all"]


def swept(rows: Sequence[Row]) -> list[str]:
    """Return the settings of `SWEPT` that have several values with one method."""
    methods = {name_of(row) for row in rows}

    def values(key: str, method: str) -> int:
        return len({row.get(key) for row in rows if name_of(row) == method} - {None})

    return [key for key in SWEPT if any(values(key, method) > 1 for method in methods)]


def kinds_of(rows: Iterable[Row]) -> list[str]:
    """Return the kinds among rows, convex first."""
    found = {row["kind"] for row in rows}
    return [kind for kind in KINDS if kind in found] + sorted(found - set(KINDS))
