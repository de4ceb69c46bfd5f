"""Written simulation results, matched to the open grasps."""

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
"""Commands whose documents hold simulation results."""

QUALITY_TOLERANCE = 1e-6
"""Largest difference in quality of the same grasp."""

When = Literal["before", "after"]
"""Grasp of an entry: the input grasp, or the refined one."""


@dataclass(frozen=True, eq=False)
class Entry:
    """Entry of a document on one grasp."""

    file: str
    """Name of the file that was validated; empty where it is not specified."""
    row: int
    """Row of the grasp in the file that the command read."""
    object: str
    """Name of the object."""
    quality: float
    """`Quality.value` after refinement, or of the input grasp; NaN where unknown."""
    trials: Mapping[When, TrialResult]
    """Simulation results."""


@dataclass(frozen=True, eq=False)
class ValidationFile:
    """Document on all grasps."""

    path: Path
    """The document."""
    command: str
    """Command that wrote it, one of `COMMANDS`."""
    files: Mapping[str, str]
    """sha256 of the files that were validated, as `fingerprint` -> their names; empty: not known."""
    entries: tuple[Entry, ...]
    """Entries of the grasps, in the requested order."""

    def of(self, collection: Collection) -> dict[int, TrialResult]:
        """Return the simulation results of the open grasps by number.

        Results of `validate` are of the file that was validated. Results of `run` are, before refinement, of the file
        that it read, and after it of the files that it wrote, of which each has the grasps of one object.

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
        found = {number: entry.trials[when] for number, entry in matched if when in entry.trials}
        if not found:
            simulated = any(entry.trials for entry in self.entries)
            raise self._error(
                f"none of its {len(self.entries)} grasps is among those that are open"
                if simulated
                else "nothing was simulated: `run` needs --validate, and `validate` no --no-simulate"
            )
        return found

    def _matched(self, collection: Collection, file: str | None, *, written: bool) -> list[tuple[int, Entry]]:
        """Return the numbers of open grasps, with their entries."""
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
            if abs(known - entry.quality) > QUALITY_TOLERANCE:
                raise self._error(
                    f"is of another refinement: it has quality {entry.quality:.6g} for {collection.label(number)}, "
                    f"whose file has {known:.6g}"
                )
            pairs.append((number, entry))
        return pairs

    def _error(self, message: str) -> GraspFileError:
        return GraspFileError(f"{self.path}: {message}")


def with_trials(collection: Collection, found: Mapping[int, TrialResult]) -> Collection:
    """Return the collection with the simulation results of some grasps in its columns."""
    success, known = np.zeros((2, len(collection)), dtype=bool)
    reason = np.full(len(collection), "", dtype=object)
    for number, trial in found.items():
        known[number], success[number] = True, trial.held
        reason[number] = next((result.reason.label for result in trial.results if not result.held), "")
    return collection.with_simulation(success, reason.astype(str), known)
