"""Ratios of the gate, equal on any machine, and their comparison with the committed baseline and its limits."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args

from grasp_refine.core.errors import GraspRefineError

Group = Literal["queries", "grasps", "forces"]
"""Ratios that are measured together."""


@dataclass(frozen=True)
class Ratio:
    """A number that does not depend on the speed of the machine."""

    name: str
    """Name in the baseline."""
    what: str
    """Explanation for people."""
    group: Group
    higher: bool = False
    """Whether larger values are better."""
    factor: float = 1.0
    """Allowed factor over the baseline: CPU times of a busy machine differ by a quarter."""
    slack: float = 0.0
    """Allowed difference besides: for shares, and for counts that rounding may change."""
    native: bool = False
    """Whether it exists only with the compiled engine."""
    own: bool = False
    """Whether it is relative to our own code, so that it gets worse when that gets better."""
    promised: float | None = None
    """An absolute limit besides, independent of the baseline."""

    def limit(self, value: float) -> float:
        """Return the worst allowed value for the baseline `value`."""
        limit = value / self.factor - self.slack if self.higher else value * self.factor + self.slack
        if self.promised is None:
            return limit
        return max(limit, self.promised) if self.higher else min(limit, self.promised)

    def allowed(self, now: float, limit: float) -> bool:
        """Return True where a measured value is within its limit; a value that is not finite never is."""
        return isfinite(now) and (now >= limit if self.higher else now <= limit)

    def better(self, one: float, other: float) -> float:
        """Return the better of two measurements."""
        return max(one, other) if self.higher else min(one, other)


TIME_FACTOR, COUNT_FACTOR = 1.5, 1.1
"""Factors of ratios of CPU times, and of counts."""

RATIOS = (
    Ratio("convex-query", "query of two convex bodies / coal.distance", "queries", factor=TIME_FACTOR),
    Ratio("concave-query", "query of 16 x 16 pieces / coal.distance on all pairs", "queries", factor=TIME_FACTOR),
    Ratio("concave-asked", "pieces queried of 256 pairs", "queries", factor=COUNT_FACTOR, slack=0.1),
    Ratio("warm-asked", "pieces queried near the last pose / without it", "queries", factor=COUNT_FACTOR, own=True),
    Ratio("warm-query", "query near the last pose / without it", "queries", factor=TIME_FACTOR, own=True),
    Ratio("single-query", "query at batch 1 / at batch 256", "queries", factor=TIME_FACTOR, own=True),
    Ratio("backward", "backward pass of the witness layer / forward", "queries", factor=TIME_FACTOR, own=True),
    Ratio(
        "engines",
        "query in Python / in the compiled engine",
        "queries",
        higher=True,
        factor=TIME_FACTOR,
        native=True,
        own=True,
        promised=3.0,
    ),
    Ratio(
        "bare-loop",
        "query in the compiled engine / its bare loop",
        "queries",
        factor=TIME_FACTOR,
        native=True,
        promised=2.0,
    ),
    Ratio("grasp", "grasp at batch 64 / 100 queries of coal.distance", "grasps", factor=TIME_FACTOR),
    Ratio("single-grasp", "grasp at batch 1 / 100 queries of coal.distance", "grasps", factor=TIME_FACTOR),
    Ratio("pieces", "grasp of an object in 64 pieces / in one", "grasps", factor=TIME_FACTOR, own=True),
    Ratio("descent-step", "step of descent / of Levenberg-Marquardt", "grasps", factor=TIME_FACTOR, own=True),
    Ratio("bookkeeping", "share of CPU time in no query, pose or derivative", "grasps", slack=0.08, own=True),
    Ratio("steps", "steps of a grasp, mean", "grasps", factor=COUNT_FACTOR),
    Ratio("queries", "narrow-phase queries of a grasp, mean", "grasps", factor=COUNT_FACTOR),
    Ratio("solved", "share of grasps within 1 mm of all targets", "grasps", higher=True, slack=0.01),
    Ratio("solved-finely", "share within 0.1 mm", "grasps", higher=True, slack=0.03),
    Ratio("holding", "grasp with forces that balance / by geometry only", "forces", factor=TIME_FACTOR, own=True),
    Ratio("good", "share of grasps that should hold", "forces", higher=True, slack=0.07),
)
"""All ratios, in the order of the table."""

BASELINE = Path(__file__).parents[1] / "baseline.json"
"""The committed ratios."""

SCHEMA = 1

UPDATE = "refine-grasp bench --gate --update FILE writes a new one"

Measure = Callable[[Group], Mapping[str, float]]
"""From a group to its ratios on this machine."""


@dataclass(frozen=True)
class Known:
    """Baseline of a ratio."""

    value: float
    """Baseline value."""
    limit: float
    """Worst allowed value."""


@dataclass(frozen=True)
class Verdict:
    """Comparison of a ratio with its baseline."""

    ratio: Ratio
    now: float | None
    """Measured value; None: not available on this machine."""
    known: Known | None
    """Baseline; None: not available on this machine."""
    again: bool
    """Whether it was measured twice, because the first value was beyond the limit; the better value counts."""

    @property
    def ok(self) -> bool | None:
        """Whether it is within its limit; None: nothing to compare."""
        return None if self.now is None or self.known is None else self.ratio.allowed(self.now, self.known.limit)

    def row(self) -> dict[str, Any]:
        """Return it as an entry of a JSON document."""
        value, limit = (None, None) if self.known is None else (self.known.value, self.known.limit)
        return {
            "name": self.ratio.name,
            "what": self.ratio.what,
            "better": "higher" if self.ratio.higher else "lower",
            "now": self.now,
            "baseline": value,
            "limit": limit,
            "measured_twice": self.again,
            "ok": self.ok,
        }


def load_baseline(path: Path, engine: str) -> dict[str, Known]:
    """Read the baseline of each ratio with a collision engine.

    Raises:
        GraspRefineError: the file cannot be read, or is for other ratios or another engine.
    """
    try:
        engines = _engines(path)
        ratios = {
            name: {key: Known(float(one["value"]), float(one["limit"])) for key, one in entry["ratios"].items()}
            for name, entry in engines.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise GraspRefineError(f"{path}: not a baseline ({type(error).__name__}: {error}); {UPDATE}") from None
    if engine not in ratios:
        raise GraspRefineError(
            f"{path}: a baseline for the collision engine {', '.join(ratios) or '(none)'}, not for the {engine} "
            f"one, which is used here; {UPDATE}"
        )
    found, wanted = ratios[engine], {ratio.name for ratio in _of(engine)}
    if set(found) != wanted:
        missing, more = sorted(wanted - set(found)), sorted(set(found) - wanted)
        parts = (
            f"missing ratios {', '.join(missing)}" if missing else "",
            f"unknown ratios {', '.join(more)}" if more else "",
        )
        raise GraspRefineError(f"{path}: {' and '.join(filter(None, parts))} ({engine} engine); {UPDATE}")
    return found


def updated(path: Path, engine: str, measured: Mapping[str, float], about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document of a new baseline; entries of other engines in the file at `path` are kept.

    Raises:
        GraspRefineError: a ratio is not finite, or the file exists and is not a baseline.
    """
    engines: dict[str, Any] = {}
    if path.is_file():
        try:
            engines = _engines(path)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise GraspRefineError(f"{path}: not a baseline ({type(error).__name__}: {error}), file kept") from None
    wrong = [name for name, value in measured.items() if not isfinite(value)]
    if wrong:
        raise GraspRefineError(f"{', '.join(wrong)}: not finite, so no later run could be compared with it")
    ratios = {
        ratio.name: {"value": _rounded(measured[ratio.name]), "limit": _rounded(ratio.limit(measured[ratio.name]))}
        for ratio in _of(engine)
    }
    return {"schema": SCHEMA, "engines": engines | {engine: {**about, "ratios": ratios}}}


def judged(known: Mapping[str, Known], measure: Measure) -> list[Verdict]:
    """Return verdicts on all ratios; a group with a ratio beyond its limit is measured once more.

    Raises:
        GraspRefineError: a ratio is measured and not in the baseline, or vice versa.
    """
    verdicts: dict[str, Verdict] = {}
    for group in get_args(Group):
        found, ratios = measure(group), [ratio for ratio in RATIOS if ratio.group == group]
        wanted = {one.name for one in ratios} & set(known)
        if set(found) != wanted:
            new, gone = (", ".join(sorted(names)) or "nothing" for names in (set(found) - wanted, wanted - set(found)))
            raise GraspRefineError(
                f"{group}: measured, but not in the baseline: {new}; in the baseline, but not measured: {gone}; "
                f"{UPDATE}"
            )
        verdicts |= {one.name: Verdict(one, found.get(one.name), known.get(one.name), False) for one in ratios}
        worse = [verdicts[one.name] for one in ratios if verdicts[one.name].ok is False]
        if worse:
            second = measure(group)
            for one in worse:
                name = one.ratio.name
                assert one.now is not None  # otherwise `ok` is None
                now = _better(one.ratio, one.now, second[name])
                verdicts[name] = Verdict(one.ratio, now, one.known, True)
    return [verdicts[ratio.name] for ratio in RATIOS]


def _engines(path: Path) -> dict[str, Any]:
    """Read the entries of each engine in a baseline.

    Raises:
        OSError, ValueError, KeyError, TypeError: the file is not a baseline.
    """
    document = json.loads(path.read_text(encoding="utf-8"))
    if document["schema"] != SCHEMA:
        raise ValueError(f"schema is {document['schema']}, not {SCHEMA}")
    return dict(document["engines"])


def _better(ratio: Ratio, one: float, other: float) -> float:
    known = [value for value in (one, other) if isfinite(value)]
    return ratio.better(*known) if len(known) == 2 else (known or [one])[0]


def _of(engine: str) -> Sequence[Ratio]:
    return [ratio for ratio in RATIOS if engine == "native" or not ratio.native]


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
