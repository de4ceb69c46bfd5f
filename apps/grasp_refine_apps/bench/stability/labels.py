"""Labels and order of rows as people read them, and commands that repeat a row."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.stability.cases import DTYPES, ENGINES, KINDS, METHODS, NEIGHBORHOODS, STATES
from grasp_refine_apps.bench.stability.rows import WRONG

ORDER: Mapping[str, tuple[Any, ...]] = MappingProxyType(
    {
        "kind": KINDS,
        "state": STATES,
        "dtype": DTYPES,
        "engine": ENGINES,
        "method": METHODS,
        "neighborhood": (None, *NEIGHBORHOODS),
    }
)
"""Key of a row -> its values in display order; values of other keys are sorted."""

FAULT_LABELS = MappingProxyType(
    {
        "failed": "no answer",
        "not_finite": "not finite",
        "wrong_distance": "wrong distance",
        "wrong_sign": "wrong sign",
        "wrong_points": "wrong points",
        "derivative_not_finite": "derivative not finite",
        "derivative_unbounded": "derivative unbounded",
        "derivative_wrong_sign": "wrong derivative",
        "derivative_unscaled": "derivative does not scale",
    }
)
"""Each of `WRONG` -> label."""


UNITS = (("km", 1e3, 1e3), ("m", 1.0, 1.0), ("cm", 1e-2, 1e-2), ("mm", 1e-3, 1e-4), ("µm", 1e-6, 0.0))
"""Units of length: name, size in metres, and smallest length in metres for which it is used."""


def length(metres: float) -> str:
    """Format a length for people."""
    if metres == 0:
        return "0"
    unit, size = next((unit, size) for unit, size, least in UNITS if metres >= 0.9999 * least)
    return f"{metres / size:.4g} {unit}"


def words(key: str, value: Any) -> str:
    """Format a value of a key for a table."""
    if value is None:
        return "–"
    if key == "diagonal":
        return length(value)
    if key == "translation":
        return f"{length(value)} away" if value else "at the origin"
    return f"batch {value}" if key == "batch" else str(value)


def ordered(key: str, values: Iterable[Any]) -> list[Any]:
    """Return the distinct values of a key, in display order."""
    found = set(values)
    if key in ORDER:
        return [value for value in ORDER[key] if value in found]
    return sorted(found, key=lambda value: (value is not None, value))


def faults(row: Row) -> str:
    """Describe the faults of a cell; empty: none."""
    return ", ".join(f"{row[name]} {FAULT_LABELS[name]}" for name in WRONG if row[name])


OPTIONS = ("dtype", "batch", "engine", "translation", "method", "neighborhood")
"""Keys of the options of a query; each has an option of its plural."""


def again(row: Row, seed: int) -> str:
    """Return the command line that repeats this cell alone."""
    count = "queries" if row["measure"] == "forward" else "differentiated"
    asked = ["--kinds", row["kind"], "--diagonals", repr(float(row["diagonal"])), "--states", row["state"]]
    asked += ["--measures", row["measure"]]
    for name in OPTIONS:
        if row[name] is not None and not (name == "translation" and row["measure"] == "derivative"):
            value = repr(float(row[name])) if name == "translation" else str(row[name])
            asked += [f"--{PLURALS.get(name, f'{name}s')}", value]
    asked += [f"--{count}", str(row["queries"]), *(["--seed", str(seed)] if seed else [])]
    return shlex.join(["refine-grasp", "bench", "stability", *asked])


PLURALS = MappingProxyType({"batch": "batches"})
"""Irregular plurals."""
