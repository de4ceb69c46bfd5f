"""Measures of the grasps of a collection, one column per measure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Int, Shaped

Better = Literal["higher", "lower", ""]
"""Direction in which a measure is better; empty: neither."""


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


def _of(key: str, label: str, hint: str, unit: str = "", *, better: Better = "", format: str = ".2f") -> Column:
    factor = {"mm": 1e3, "mm²": 1e6}.get(unit, 1.0)
    return Column(key, label, hint, np.zeros(0), unit, factor, format, better)


def _before_and_after(key: str, label: str, hint: str, unit: str = "", *, better: Better, format: str) -> list[Column]:
    return [
        _of(f"{key}_after", label, hint, unit, better=better, format=format),
        _of(f"{key}_before", f"{label} before", f"{hint}, before refinement", unit, better=better, format=format),
    ]


NUMBERS = (
    *_before_and_after("quality", "Quality", "how well the contacts can hold, 0 to 1", better="higher", format=".3f"),
    *_before_and_after(
        "contact_error", "Contact error", "worst gap or target miss of a contact", "mm", better="lower", format=".2f"
    ),
    *_before_and_after("penetration", "Penetration", "deepest, of any link", "mm", better="lower", format=".2f"),
    *_before_and_after(
        "self_penetration", "Self-penetration", "of links in each other", "mm", better="lower", format=".2f"
    ),
    *_before_and_after(
        "wrench_residual",
        "Imbalance",
        "wrench that contact forces leave unbalanced, 0 to 1",
        better="lower",
        format=".3f",
    ),
    _of("finger_gap", "Finger gap", "mean over the fingers, 10 mm at most", "mm", better="lower"),
    _of("contact_number", "Contacts", "links within 2 mm of the object", better="higher", format=".0f"),
    _of("limits_violated", "Beyond limits", "joints beyond their limits", better="lower", format=".0f"),
    _of("starts", "Starts", "number of starts of the refinement", format=".0f"),
    _of("iterations", "Iterations", "of all starts together", better="lower", format=".0f"),
    _of("loss", "Loss", "value that refinement minimises", "mm²", better="lower", format=".3g"),
)
"""Numeric columns without values, by their keys in result files and measuring."""

STATUS = _of("status", "Status", "how the refinement ended").with_values(np.zeros(0, dtype=str))
"""The column of how refinements ended."""
HELD = _of("held", "Simulation", "whether the grasp held in MuJoCo").with_values(np.zeros(0, dtype=str))
"""The column of verdicts of the simulation."""
REASON = _of("reason", "Reason", "why it did not hold").with_values(np.zeros(0, dtype=str))
"""The column of why grasps failed."""
HELD_TEXT, FAILED_TEXT = "held", "failed"
"""Values of `HELD`."""
