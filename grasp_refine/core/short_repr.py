"""Short descriptions of dataclasses that hold arrays, for people who print them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np

MAX_TEXT_CHARACTERS, MAX_REPR_CHARACTERS = 40, 300
"""Most characters of one text, and about the most of all fields together."""


def brief(record: Any) -> str:
    """Short `repr` of a dataclass, a few lines at most: arrays by type and shape, long tuples by their length.

    A class uses it by `__repr__ = brief`. Fields at their default None or () are left out.
    """
    parts: list[str] = []
    for field in fields(record):
        value = getattr(record, field.name)
        if field.default is not MISSING and (value is None or (isinstance(value, tuple) and not value)):
            continue
        if sum(map(len, parts)) > MAX_REPR_CHARACTERS:
            parts.append("...")
            break
        parts.append(f"{field.name}={_short_value(value)}")
    return f"{type(record).__name__}({', '.join(parts)})"


def tallied(labels: Iterable[str]) -> str:
    """Count of each label, the most frequent first: "3 converged, 1 stalled"."""
    names, counts = np.unique(list(labels), return_counts=True)
    return ", ".join(f"{counts[i]} {names[i]}" for i in np.argsort(-counts, kind="stable"))


def labels(kind: Callable[[int], Any], codes: np.ndarray) -> np.ndarray:
    """The labels of codes, an array of the same shape: "converged" for 1 where the kind is `Status`."""
    codes = np.asarray(codes)
    return np.array([kind(int(code)).label for code in codes.reshape(-1)], dtype=str).reshape(codes.shape)


def spread(values: np.ndarray, digits: int = 3) -> str:
    """Smallest and largest of the finite numbers: "0.912 to 0.985"; "unknown" if there is none."""
    known = np.asarray(values)[np.isfinite(values)]
    if not known.size:
        return "unknown"
    low, high = (f"{value:.{digits}g}" for value in (known.min(), known.max()))
    return low if low == high else f"{low} to {high}"


def _short_value(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        kind = "str" if str(value.dtype).startswith("<U") else str(value.dtype).removeprefix("torch.")
        return f"{kind}{list(value.shape)}"
    if is_dataclass(value) and not isinstance(value, type):
        text = repr(value)
        return text if len(text) <= 2 * MAX_TEXT_CHARACTERS else f"{type(value).__name__}(...)"
    if isinstance(value, tuple | list | Mapping) and len(value) > 3:
        return f"({len(value)} of them)"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_short_value, value))}{',' if len(value) == 1 else ''})"
    text = repr(value)
    return text if len(text) <= MAX_TEXT_CHARACTERS else f"{text[: MAX_TEXT_CHARACTERS - 3]}..."
