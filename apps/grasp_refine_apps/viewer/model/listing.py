"""List of the grasps of a collection: filters, sorting, and steps through the list."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_types import Int
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import CHANGE, HELD, STATUS, VERDICT_CHOICES, Column

NUMBER, MARK, NO_MARK = "number", "mark", "no mark"
"""Keys of number and mark, which need no measure, and label of the filter for grasps without a mark."""
WORST_KEYS = ("quality_after", "wrench_residual_after", "penetration_m_after", "contact_error_m_after")
"""Keys of the columns that rank the worst grasps; the first one that is known counts."""


@dataclass(frozen=True)
class Listing:
    """Filters and sorting of a collection; empty texts mean all."""

    key: str = NUMBER
    """Key of the sort column; `NUMBER`: as in the file."""
    descending: bool = False
    """Whether large values come first."""
    object: str = ""
    """Name of an object."""
    status: str = ""
    """Status of the refinement."""
    change: str = ""
    """Change by the refinement."""
    held: str = ""
    """Verdict of the simulation, or one of `VERDICT_CHOICES`."""
    mark: str = ""
    """Mark of the grasps; `NO_MARK`: none."""
    ranges: tuple[tuple[str, float, float], ...] = ()
    """Measures with lowest and highest value, SI units; grasps with an unknown one are not listed."""

    def numbers(self, collection: Collection) -> Int[np.ndarray, " M"]:
        """Numbers of the M grasps that are listed, in order; unknown values come last."""
        column = column_of(collection, self.key)
        if column is None:
            every = np.arange(len(collection))
            order = every[::-1] if self.descending and self.key == NUMBER else every
        else:
            order = column.order(descending=self.descending)
        keep = np.ones(len(collection), dtype=bool)
        if self.object:
            keep &= collection.objects == self.object
        verdict = VERDICT_CHOICES.get(self.held, (HELD.key, self.held))
        for key, wanted in ((STATUS.key, self.status), (CHANGE.key, self.change), verdict):
            if wanted:
                found = collection.columns.get(key)
                keep &= np.zeros(len(collection), dtype=bool) if found is None else found.values == wanted
        if self.mark:
            keep &= marks_of(collection) == ("" if self.mark == NO_MARK else self.mark)
        for key, low, high in self.ranges:
            found = collection.columns.get(key)
            if found is not None:
                keep &= (found.values >= low) & (found.values <= high)
        return order[keep[order]]

    def range_of(self, key: str) -> tuple[float, float] | None:
        """Return the range of a measure; None: it has none."""
        return next(((low, high) for name, low, high in self.ranges if name == key), None)

    def with_range(self, key: str, range_: tuple[float, float] | None) -> Listing:
        """Return the listing with another range of a measure; None: none."""
        others = tuple(each for each in self.ranges if each[0] != key)
        return replace(self, ranges=others if range_ is None else (*others, (key, *range_)))


def column_of(collection: Collection, key: str) -> Column | None:
    """Return the column of a key, marks included; None for `NUMBER` and for unknown measures."""
    if key == MARK:
        return Column(MARK, "Mark", "your mark", marks_of(collection))
    return collection.columns.get(key)


def marks_of(collection: Collection) -> np.ndarray:
    """The mark of each grasp (N,), empty where it has none."""
    return np.array([collection.mark(number) for number in range(len(collection))], dtype=str)


def first_descending(collection: Collection, key: str) -> bool:
    """Return whether to sort by a column in descending order at first, so that the best grasps come first."""
    column = column_of(collection, key)
    return column is not None and column.better == "higher"


def step(numbers: Int[np.ndarray, " M"], number: int, by: int) -> int | None:
    """Return the grasp `by` places after another one in a cyclic list; None: the list is empty.

    From a grasp that is not listed, a step leads to the first, or backwards to the last.
    """
    if not len(numbers):
        return None
    at = np.flatnonzero(numbers == number)
    if not len(at):
        return int(numbers[0 if by > 0 else -1])
    return int(numbers[(at[0] + by) % len(numbers)])


def random_other(numbers: Int[np.ndarray, " M"], number: int, random: np.random.Generator) -> int | None:
    """Draw a random grasp of a list, other than `number` if there is one; None: the list is empty."""
    others = numbers[numbers != number]
    if len(others):
        return int(random.choice(others))
    return int(numbers[0]) if len(numbers) else None


def worst(collection: Collection, numbers: Int[np.ndarray, " M"] | None = None, key: str = "") -> int | None:
    """Return the worst grasp of a list (default: of all), by a column; None where no value is known.

    Args:
        collection: Grasps.
        numbers: Numbers of the grasps that count.
        key: Key of the column; by default the first of `WORST_KEYS` that is known.
    """
    numbers = np.arange(len(collection)) if numbers is None else numbers
    for name in (key,) if key else WORST_KEYS:
        column = column_of(collection, name)
        if column is None or column.is_text or not column.known[numbers].any():
            continue
        values = column.values[numbers]
        bad = np.nan_to_num(values if column.better == "lower" else -values, nan=-np.inf)
        return int(numbers[bad.argmax()])
    return None
