"""Simulation results in the documents of `validate --json` and `run --json`, matched to the open grasps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.json_files import SCHEMA
from grasp_refine.grasps.grasp_set import OTHER_STAGES
from grasp_refine.results.margins_table import LIMITS
from grasp_refine.results.result_files import fingerprint
from grasp_refine.scene.protocols.protocol import AXES, Protocol
from grasp_refine.scene.protocols.protocol_file import protocol_of
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.validation.margins.factors import JOINT
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import NUMBERS, Reason
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import STATUS
from grasp_refine_apps.viewer.model.margins import HoldingMargins
from grasp_refine_apps.viewer.model.validated import DirectionResult, TrialResult

COMMANDS = ("run", "validate")
"""Commands whose documents hold simulation results."""

MAX_FILE_BYTES = 2**28
"""Maximum bytes of a document: 256 MiB, or some 40 000 grasps."""

MAX_MAGNITUDE = 1e12
"""Upper bound of the magnitude of numbers in SI units."""

MAX_VALUE_CHARS = 40
"""Maximum characters of a wrong value in a message."""

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
        that it read, and after it of the files that it wrote, each with the grasps of one object.

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
                f"none of its {len(self.entries)} grasps is open"
                if simulated
                else "nothing was simulated: run needs --validate, and validate no --no-simulate"
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


@dataclass(frozen=True)
class _Json:
    """Value in a document, with its place for messages; its methods check the type."""

    path: Path
    value: Any
    where: str = ""

    def error(self, needed: str) -> GraspFileError:
        """Return the error of a wrong value."""
        shown = json.dumps(self.value)
        shown = shown if len(shown) < MAX_VALUE_CHARS else f"{shown[: MAX_VALUE_CHARS - 4]} ..."
        return GraspFileError(f"{self.path}: {self.where or 'the document'} must be {needed}, got {shown}")

    def __getitem__(self, key: str) -> _Json:
        """Return an entry of an object; null where it has none."""
        if not isinstance(self.value, dict):
            raise self.error("an object")
        return _Json(self.path, self.value.get(key), f"{self.where}.{key}" if self.where else key)

    def or_empty(self, empty: Any) -> _Json:
        """Return another value instead of null."""
        return self if self.value is not None else _Json(self.path, empty, self.where)

    def list(self) -> list[_Json]:
        """Return the values of a list."""
        if not isinstance(self.value, list):
            raise self.error("a list")
        return [_Json(self.path, one, f"{self.where}[{i}]") for i, one in enumerate(self.value)]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            raise self.error("a text")
        return self.value

    def choice(self, choices: Iterable[str]) -> str:
        """Return one of some texts."""
        choices = tuple(choices)
        if not isinstance(self.value, str) or self.value not in choices:
            raise self.error(f"among {', '.join(choices)}")
        return self.value

    def number(self) -> float:
        """Return a number; NaN for null."""
        if self.value is None:
            return nan
        known = isinstance(self.value, (int, float)) and not isinstance(self.value, bool)
        if not known or not abs(self.value) < MAX_MAGNITUDE:
            raise self.error(f"a number below {MAX_MAGNITUDE:g}, or null")
        return float(self.value)


def read_validation(path: Path) -> ValidationFile:
    """Read the simulation results of a document.

    Raises:
        GraspFileError: it cannot be read, is damaged, or is none of these documents; the message says where.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise GraspFileError(f"{path}: has more than {MAX_FILE_BYTES // 2**20} MiB")
        document = _Json(path, json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, RecursionError) as error:
        raise GraspFileError(f"{path}: is no JSON document ({' '.join(str(error).split())[:80]})") from None
    command, schema, config = document["command"].value, document["schema"], document["config"]
    if command not in COMMANDS:
        raise GraspFileError(f"{path}: is no document that {' or '.join(COMMANDS)} wrote with --json")
    if schema.value != SCHEMA:
        raise schema.error(f"{SCHEMA}, which this version reads")
    protocol = None if config["protocol"].value is None else _protocol(config["protocol"])
    files = config["files"].or_empty([]).list()
    # `run` does not write the source of the stages that were simulated before refinement.
    closing: dict[When, Mapping[str, str]] = {"after": dict.fromkeys(OTHER_STAGES, "own")}
    if command == "validate":
        closing = {"after": _closing(files[0]["closing"]) if len(files) == 1 else {}}
    return ValidationFile(
        path=path,
        command=command,
        files={file["sha256"].text(): file["path"].text() for file in files},
        entries=tuple(_entry(grasp, protocol, closing) for grasp in document["grasps"].list()),
    )


def _entry(grasp: _Json, protocol: Protocol | None, closing: Mapping[When, Mapping[str, str]]) -> Entry:
    """Read one grasp."""
    row = grasp["row"].value
    if not isinstance(row, int) or isinstance(row, bool) or row < 0:
        raise grasp["row"].error("an integer of at least 0")
    simulation = grasp["simulation"].or_empty({})
    margins = None if grasp["margins"].value is None else _margins(grasp["margins"])
    whens: tuple[When, ...] = get_args(When)
    return Entry(
        file=grasp["file"].or_empty("").text(),
        row=row,
        object=grasp["object"].text(),
        quality=grasp["quality"].or_empty({})["after"].number(),
        trials={
            when: _trial(simulation[when], protocol, closing.get(when, {}), margins if when == "after" else None)
            for when in whens
            if simulation[when].value is not None
        },
    )


def _trial(
    simulation: _Json, protocol: Protocol | None, closing: Mapping[str, str], margins: HoldingMargins | None
) -> TrialResult:
    """Read the simulation result of one grasp."""
    directions, closed = simulation["directions"], simulation["closing"].or_empty({})
    if directions.value == []:
        raise directions.error("a list that is not empty")
    return TrialResult(
        protocol=protocol or PROTOCOLS[simulation["protocol"].choice(PROTOCOLS)],
        results=tuple(map(_direction, directions.list())),
        closing=closing,
        closing_m=closed["displacement_m"].number(),
        closing_rad=closed["angle_rad"].number(),
        penetration_m=closed["pregrasp_penetration_m"].number(),
        label=None if simulation["label"].value is None else simulation["label"].number(),
        margins=margins,
    )


def _margins(entry: _Json) -> HoldingMargins:
    """Read the margins of one grasp."""
    trials = entry["trials"]
    joint, worst = trials[JOINT], entry["worst"].or_empty("").text()
    interval = [bound.number() for bound in joint["interval"].list()]
    if len(interval) != 2:
        raise joint["interval"].error("two numbers")
    limits = {limit.name: entry[limit.name].number() for limit in LIMITS}
    return HoldingMargins(
        count=len(joint["held"].list()),
        probability=joint["probability"].number(),
        interval=(interval[0], interval[1]),
        worst=worst,
        worst_probability=trials[worst]["probability"].number() if worst else nan,
        limits={name: value for name, value in limits.items() if not isnan(value)},
    )


def _direction(result: _Json) -> DirectionResult:
    """Read the result of one direction."""
    reasons = {reason.label: reason for reason in Reason}
    return DirectionResult(
        direction=result["direction"].choice((*AXES, *LIFT)),
        reason=reasons[result["reason"].choice(reasons)],
        links=tuple(link.text() for link in result["contacts"].list()),
        **{name: result[name].number() for name in NUMBERS},
    )


def _protocol(entry: _Json) -> Protocol:
    """Read the protocol of all simulations."""
    if not isinstance(entry.value, dict):
        raise entry.error("an object")
    try:
        return protocol_of(entry.value, where=f"{entry.path}: {entry.where}.")
    except GraspRefineError as error:
        raise GraspFileError(str(error)) from None


def _closing(entry: _Json) -> dict[str, str]:
    """Read the source of the simulated pregrasps and squeezes."""
    if entry.value is None or entry.value == {}:
        return {}
    if not isinstance(entry.value, dict) or set(entry.value) != set(OTHER_STAGES):
        raise entry.error(f"file or own for {' and '.join(OTHER_STAGES)}")
    return {stage: entry[stage].choice(("file", "own")) for stage in OTHER_STAGES}
