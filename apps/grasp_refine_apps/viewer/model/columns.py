"""Measures of the grasps of a collection, one column per measure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_types import Bool, Int, Shaped
from grasp_refine.measures.measures import MEASURES, VALIDATED, Better, Measure
from grasp_refine.results.result_numbers import held_entry
from grasp_refine.validation.engine_table import ENGINES


@dataclass(frozen=True, eq=False)
class Column:
    """One measure of N grasps."""

    key: str
    """Name of the measure in files."""
    label: str
    """Header in tables."""
    hint: str
    """Explanation for users."""
    values: Shaped[np.ndarray, " N"]
    """Numbers in SI units (N,), NaN where unknown; or texts, empty where unknown."""
    unit: str = ""
    """Displayed unit."""
    factor: float = 1.0
    """Factor from SI to the displayed unit."""
    format: str = ".2f"
    """Format specification of displayed numbers."""
    better: Better = ""
    """Direction in which the measure is better."""

    @property
    def is_text(self) -> bool:
        """Whether the values are texts."""
        return self.values.dtype.kind == "U"

    @property
    def known(self) -> Bool[np.ndarray, " N"]:
        """True where there is a value (N,)."""
        return self.values != "" if self.is_text else ~np.isnan(self.values)

    @property
    def title(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def text(self, number: int) -> str:
        """Displayed value of a grasp, without its unit; empty where it is unknown."""
        if not self.known[number]:
            return ""
        value = self.values[number]
        return str(value) if self.is_text else format(value * self.factor, self.format)

    def with_values(self, values: Shaped[np.ndarray, " N"]) -> Column:
        """Return the column with other values."""
        return replace(self, values=values)

    def order(self, *, descending: bool = False) -> Int[np.ndarray, " N"]:
        """Numbers of the grasps (N,) sorted by this column; equal ones stay in order, unknown ones come last."""
        known = np.flatnonzero(self.known)
        _, rank = np.unique(self.values[known], return_inverse=True)
        found = known[np.argsort(-rank if descending else rank, kind="stable")]
        return np.concatenate([found, np.flatnonzero(~self.known)])


def _columns(measure: Measure) -> Iterator[Column]:
    """Yield the columns of a measure without values, that after refinement first."""
    label = measure.title[:1].upper() + measure.title[1:]
    unit = measure.unit
    for side, entry in reversed(measure.entries.items()):
        before = side == "before"
        yield Column(
            key=entry,
            label=f"{label} before" if before else label,
            hint=f"{measure.hint}, before refinement" if before else measure.hint,
            values=np.zeros(0),
            unit=unit.symbol,
            factor=unit.factor,
            format=unit.format,
            better=measure.better,
        )


def numeric_columns() -> tuple[Column, ...]:
    """Return the columns of all measures without values; refinement's come last.

    Their keys are as in result files and in measuring.
    """
    measures = sorted((one for one in MEASURES if one.shown), key=lambda one: not one.of_grasps)
    return tuple(column for measure in measures for column in _columns(measure))


def measured_columns() -> dict[str, str]:
    """Return key of a column -> the measure of `Metrics` that it is filled from."""
    return {measure.entries["after"]: measure.name for measure in VALIDATED if measure.shown}


STATUS = Column("status", "Status", "how the refinement ended", np.zeros(0, dtype=str))
"""The column of how refinements ended."""
CHANGE = Column("change", "Change", "what the refinement changed", np.zeros(0, dtype=str))
"""The column of changes by refinement, a `Change` each."""
FIDELITY = Column("fidelity", "Fidelity", "likeness to the grasp of another hand", np.zeros(0, dtype=str))
OF_REFINEMENT = (STATUS, CHANGE, FIDELITY)
"""The columns of texts that result files have."""
HELD = Column("held", "Simulation", "whether the grasp held in MuJoCo", np.zeros(0, dtype=str))
"""The column of verdicts of the simulation."""
REASON = Column("reason", "Reason", "why it did not hold", np.zeros(0, dtype=str))
"""The column of why grasps failed."""
HERE = Column("here", "Done", "work on it since it was opened: refined, edited, tested", np.zeros(0, dtype=str))
"""The column of work done on the grasps in the viewer."""
HELD_TEXT, FAILED_TEXT = "held", "failed"
"""Values of `HELD` and `VERDICTS`."""
VERDICTS = tuple(
    Column(held_entry(name, "after"), entry.title, f"whether the grasp held in {entry.title}", np.zeros(0, dtype=str))
    for name, entry in ENGINES.items()
)
"""The columns of the verdicts of each engine that result files have."""
VERDICT_CHOICES = {
    f"{text} in {column.label}": (column.key, text) for column in VERDICTS for text in (HELD_TEXT, FAILED_TEXT)
}
"""Choice of a filter -> key of the column of an engine, and its verdict."""
