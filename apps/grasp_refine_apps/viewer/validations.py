"""What was written of simulations, matched to the grasps that are open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.results.result_files import fingerprint
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.columns import STATUS
from grasp_refine_apps.viewer.validated import TrialResult

COMMANDS = ("run", "validate")
"""Commands whose documents tell of simulations."""

SAME = 1e-6
"""Qualities that differ by more than this are not of the same grasp."""

When = Literal["before", "after"]
"""Which of the two grasps of an entry: as it came, or refined."""


@dataclass(frozen=True, eq=False)
class Entry:
    """What a document says of one grasp."""

    file: str
    """Name of the file that was validated; empty where it is not said."""
    row: int
    """Row of the grasp in the file that the command read."""
    object: str
    """Name of the object."""
    quality: float
    """`Quality.value` after refinement, or of the grasp as it was; NaN where unknown."""
    proved: Mapping[When, TrialResult]
    """What was simulated."""


@dataclass(frozen=True, eq=False)
class ValidationFile:
    """What a document says of all grasps."""

    path: Path
    """The document."""
    command: str
    """Which of `COMMANDS` wrote it."""
    files: Mapping[str, str]
    """sha256 of the files that were validated, as `fingerprint` -> their names; empty: not known."""
    entries: tuple[Entry, ...]
    """The grasps, in the order in which they were asked for."""

    def of(self, collection: Collection) -> dict[int, TrialResult]:
        """Number of a grasp that is open -> what simulation said of it.

        What `validate` wrote is of the file that was validated. What `run` wrote is, before refinement, of the file
        that it read, and after that of the files that it wrote, of which each has the grasps of one object.

        Raises:
            GraspFileError: the document is about other grasps.
        """
        file = None
        if self.files and not collection.problem.sampled:
            opened = fingerprint(collection.problem.files[0])
            file = self.files.get(opened["sha256"])
            if file is None:
                raise self._error(f"is about another file than {opened['path']}, or it was changed since then")
        written = self.command == "run" and STATUS.key in collection.columns
        when: When = "after" if written or self.command == "validate" else "before"
        matched = self._matched(collection, file, written=written)
        found = {number: entry.proved[when] for number, entry in matched if when in entry.proved}
        if not found:
            simulated = any(entry.proved for entry in self.entries)
            raise self._error(
                f"none of its {len(self.entries)} grasps is among those that are open"
                if simulated
                else "nothing was simulated: `run` needs --validate, and `validate` no --no-simulate"
            )
        return found

    def _matched(self, collection: Collection, file: str | None, *, written: bool) -> list[tuple[int, Entry]]:
        """Numbers of grasps that are open, with their entries."""
        problem = collection.problem
        rows = np.concatenate([group.rows for group in problem.groups])[problem.order]
        places: dict[tuple[str, int], Entry] = {}
        count: dict[str, int] = {}
        for entry in self.entries:
            if file is not None and entry.file not in ("", file):
                continue
            at = count.get(entry.object, 0) if written else entry.row
            count[entry.object] = at + 1
            places[entry.object, at] = entry
        quality = collection.columns.get("quality_after")
        pairs = []
        for number, (name, row) in enumerate(zip(collection.objects.tolist(), rows.tolist(), strict=True)):
            if (name, row) not in places:
                continue
            entry = places[name, row]
            known = nan if not written or quality is None else float(quality.values[number])
            if abs(known - entry.quality) > SAME:
                raise self._error(
                    f"is of another refinement: it says quality {entry.quality:.6g} of {collection.label(number)}, "
                    f"whose file says {known:.6g}"
                )
            pairs.append((number, entry))
        return pairs

    def _error(self, message: str) -> GraspFileError:
        return GraspFileError(f"{self.path}: {message}")


def with_trials(collection: Collection, found: Mapping[int, TrialResult]) -> Collection:
    """The same grasps, with what simulation said of some in their table."""
    success, known = np.zeros((2, len(collection)), dtype=bool)
    reason = np.full(len(collection), "", dtype=object)
    for number, proved in found.items():
        known[number], success[number] = True, proved.held
        reason[number] = next((tried.reason.label for tried in proved.tried if not tried.held), "")
    return collection.with_simulation(success, reason.astype(str), known)
