"""Margins of grasps in the JSON document of a validation and in its flat rows; SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from grasp_refine.results.margins_table import LIMITS
from grasp_refine.validation.margins.draws import Draws
from grasp_refine.validation.margins.factors import JOINT, PUSH, Factors
from grasp_refine.validation.margins.intervals import difference_interval
from grasp_refine.validation.margins.margins import NO_FACTOR, Margins


def margins_totals(parts: Sequence[Margins], factors: Factors, draws: Draws) -> dict[str, Any]:
    """Return the entry of all grasps: ranges, draws, mean probabilities by file, and changes between two files.

    Args:
        parts: Margins of the grasps of each file.
        factors: Ranges of the factors.
        draws: The draws.
    """
    entry: dict[str, Any] = {
        "ranges": asdict(factors),
        "draws": {name: getattr(draws, name).tolist() for name in Draws.__dataclass_fields__},
        "files": [_means(part) for part in parts],
        "cpu_s": float(sum(part.cpu_s.sum() for part in parts)),
    }
    if len(parts) == 2 and len(parts[0]) == len(parts[1]):
        before, after = parts
        entry["change"] = {
            name: _estimate(*difference_interval(before.held[name], after.held[name]), key="change")
            for name in after.trials
            if name in before.trials
        }
    return entry


def margins_entry(margins: Margins, i: int) -> dict[str, Any]:
    """Return the entry of one grasp: probability under all factors and under each, the worst one, and the limits."""
    interval = margins.interval[i]
    return {
        "trials": {
            name: {
                **_estimate(margins.probability[i, f], *interval[f]),
                "held": margins.held[name][i].tolist(),
            }
            for f, name in enumerate(margins.trials)
        },
        "worst": _worst(margins, i),
        **_limits(margins, i),
        "cpu_s": float(margins.cpu_s[i]),
    }


def margins_row(margins: Margins, i: int) -> dict[str, Any]:
    """Return the flat columns of one grasp."""
    row: dict[str, Any] = {}
    for f, name in enumerate(margins.trials):
        row[f"margins_{name}"] = float(margins.probability[i, f])
        row[f"margins_{name}_low"], row[f"margins_{name}_high"] = map(float, margins.interval[i, f])
    row["margins_worst"] = _worst(margins, i)
    row |= {f"margins_{name}": value for name, value in _limits(margins, i).items()}
    row["margins_cpu_s"] = float(margins.cpu_s[i])
    return row


def _means(margins: Margins) -> dict[str, Any]:
    worst = margins.worst
    entry = {}
    for name in margins.trials:
        entry[name] = {**_estimate(*margins.mean(name)), "worst_of": int((worst == name).sum())}
        if name not in (JOINT, PUSH) and PUSH in margins.trials:
            cost = difference_interval(margins.held[name], margins.held[PUSH])
            entry[name]["cost"] = _estimate(*cost, key="probability")
    return entry


def _estimate(value: float, low: float, high: float, key: str = "probability") -> dict[str, Any]:
    return {key: float(value), "interval": [float(low), float(high)]}


def _worst(margins: Margins, i: int) -> str | None:
    name = str(margins.worst[i])
    return None if name == NO_FACTOR else name


def _limits(margins: Margins, i: int) -> dict[str, float | None]:
    """Return the limits of one grasp; null where they were not searched, or a grasp holds at no friction."""
    if margins.limits is None:
        return {limit.name: None for limit in LIMITS}
    values = {limit.name: limit.of(margins.limits)[i] for limit in LIMITS}
    return {name: float(value) if np.isfinite(value) else None for name, value in values.items()}
