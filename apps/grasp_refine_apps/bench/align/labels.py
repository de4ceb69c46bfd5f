"""Rows as people read them: what tells them apart, and in which order they come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, get_args

from grasp_refine_apps.bench.align.bodies import KINDS
from grasp_refine_apps.bench.align.variants import MethodName, SolverName

Row = dict[str, Any]

METHODS: tuple[str, ...] = (*get_args(MethodName), *get_args(SolverName)[1:])
"""Order of the methods of descent and of the other solvers; each has the colour and the marker of the same place."""
SETTINGS = (
    "solver", "neighborhood", "coupling", "transport", "optimise", "margin", "step_size", "witness", "epsilon", "dtype",
)  # fmt: skip
"""What a row may differ in from another one of the same method, in the order of a label."""
SWEPT = {"margin": "contact margin", "step_size": "step size of rotations at the start"}
"""Settings that get a chart of their own when several values were tried, and what they are."""


def name_of(row: Row) -> str:
    """What a row is called first: the method of descent, or the other solver."""
    return row["method"] if row.get("solver") in (None, "descent") else row["solver"]


def micrometres(epsilon: float) -> str:
    """The epsilon of a patch witness as a person reads it."""
    return f"{1e6 * epsilon:g} µm"


def epsilons(rows: Iterable[Row]) -> str:
    """Every epsilon of a patch witness among rows, in words; empty where there is none."""
    found = sorted({row["patch"]["epsilon"] for row in rows if row.get("patch")})
    return ", ".join(map(micrometres, found))


def labels_of(rows: Sequence[Row], without: Iterable[str] = ()) -> list[str]:
    """A short label for each row: its method, and those settings that differ among the rows of that method.

    A patch witness is always told, with its epsilon.

    Args:
        rows: All rows that are shown together.
        without: Settings that no label shall mention.
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
    """A setting as part of a label; empty where there is nothing to say."""
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
    """Rows by kind, method, settings, pair and target class, then from the smallest to the largest budget."""

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
    """A number that grows with the budget of a row, to be compared among rows of one variant."""
    return row.get("budget_s") or 0.0, row.get("budget") or 0.0, row.get("cpu_s_per_pair") or 0.0


def at_largest_budget(rows: Sequence[Row], labels: Sequence[str]) -> list[Row]:
    """The rows with the largest budget of each variant, kind, pair and target class, in the order given."""
    best: dict[tuple, Row] = {}
    for row, label in zip(rows, labels, strict=True):
        key = label, row["kind"], row["pair"], row["target_class"]
        if key not in best or budget(row) > budget(best[key]):
            best[key] = row
    return list(best.values())


def pooled(rows: Iterable[Row]) -> list[Row]:
    """The rows over all pairs and all target classes."""
    return [row for row in rows if row["pair"] == "all" and row["target_class"] == "all"]


def swept(rows: Sequence[Row]) -> list[str]:
    """The settings of `SWEPT` that have several values with one method."""
    methods = {name_of(row) for row in rows}

    def values(key: str, method: str) -> int:
        return len({row.get(key) for row in rows if name_of(row) == method} - {None})

    return [key for key in SWEPT if any(values(key, method) > 1 for method in methods)]


def kinds_of(rows: Iterable[Row]) -> list[str]:
    """The kinds among rows, convex first."""
    found = {row["kind"] for row in rows}
    return [kind for kind in KINDS if kind in found] + sorted(found - set(KINDS))
