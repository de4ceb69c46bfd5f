"""What `validate --json` and `run --json` wrote of simulations, matched to the grasps that are open."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import isfinite, nan
from pathlib import Path
from typing import Any, Literal

import numpy as np

from grasp_refine.errors import GraspFileError
from grasp_refine.grasps import OTHER_STAGES
from grasp_refine.report.results import fingerprint
from grasp_refine.report.writing import SCHEMA
from grasp_refine.validation.protocol import AXES, SETTINGS, Protocol
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import Reason

from .collection import Collection
from .columns import STATUS
from .proved import Proved, Tried

COMMANDS = ("run", "validate")
"""Commands whose documents tell of simulations."""

LARGEST = 2**28
"""How many bytes a document may have: 256 MiB, or some 40 000 grasps."""

SAME = 1e-6
"""Qualities that differ by more than this are not of the same grasp."""

When = Literal["before", "after"]
"""Which of the two grasps of an entry: as it came, or refined."""


@dataclass(frozen=True, eq=False)
class Entry:
    """What a document says of one grasp."""

    row: int
    """Row of the grasp in the file that the command read."""
    object: str
    """Name of the object."""
    quality: float
    """`Quality.value` after refinement, or of the grasp as it was; NaN where unknown."""
    proved: Mapping[When, Proved]
    """What was simulated."""


@dataclass(frozen=True, eq=False)
class Proofs:
    """What a document says of all grasps."""

    path: Path
    """The document."""
    command: str
    """Which of `COMMANDS` wrote it."""
    hashes: tuple[str, ...]
    """sha256 of the files that were validated, as `fingerprint`; empty: not known."""
    entries: tuple[Entry, ...]
    """The grasps, in the order in which they were asked for."""

    def of(self, collection: Collection) -> dict[int, Proved]:
        """Number of a grasp that is open -> what simulation said of it.

        What `validate` wrote is of the file that was validated. What `run` wrote is, before refinement, of the file
        that it read, and after that of the files that it wrote, of which each has the grasps of one object.

        Raises:
            GraspFileError: the document is about other grasps.
        """
        if self.command == "validate" and self.hashes and not collection.problem.sampled:
            opened = fingerprint(collection.problem.files[0])
            if opened["sha256"] not in self.hashes:
                raise self._error(f"is about another file than {opened['path']}, or that was changed since then")
        written = self.command == "run" and STATUS.key in collection.columns
        when: When = "after" if written or self.command == "validate" else "before"
        found = {
            n: entry.proved[when] for n, entry in self._matched(collection, written=written) if when in entry.proved
        }
        if not found:
            simulated = any(entry.proved for entry in self.entries)
            raise self._error(
                f"none of its {len(self.entries)} grasps is among those that are open"
                if simulated
                else "nothing was simulated: `run` needs --validate, and `validate` no --no-simulate"
            )
        return found

    def _matched(self, collection: Collection, *, written: bool) -> list[tuple[int, Entry]]:
        """Numbers of grasps that are open, with their entries."""
        problem = collection.problem
        rows = np.concatenate([group.rows for group in problem.groups])[problem.order]
        places: dict[tuple[str, int], Entry] = {}
        count: dict[str, int] = {}
        for entry in self.entries:
            at = count.get(entry.object, 0) if written else entry.row
            count[entry.object] = at + 1
            # A file that was validated twice says the same twice.
            places.setdefault((entry.object, at), entry)
        quality = collection.columns.get("quality_after")
        pairs = []
        for number, (name, row) in enumerate(zip(collection.objects.tolist(), rows.tolist(), strict=True)):
            entry = places.get((name, row))
            if entry is None:
                continue
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


def with_proofs(collection: Collection, found: Mapping[int, Proved]) -> Collection:
    """The same grasps, with what simulation said of some in their table."""
    success, known = np.zeros((2, len(collection)), dtype=bool)
    reason = np.full(len(collection), "", dtype=object)
    for number, proved in found.items():
        known[number], success[number] = True, proved.held
        reason[number] = next((tried.reason.label for tried in proved.tried if not tried.held), "")
    return collection.with_simulation(success, reason.astype(str), known)


def read_proofs(path: Path) -> Proofs:
    """What a document says.

    Raises:
        GraspFileError: it cannot be read, is damaged, or is none of these documents; says where.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise GraspFileError(f"{path}: has more than {LARGEST // 2**20} MiB")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, RecursionError) as error:
        raise GraspFileError(f"{path}: is no JSON document ({' '.join(str(error).split())[:80]})") from None
    return _Reader(path).document(document)


@dataclass(frozen=True)
class _Reader:
    """Reads the parts of a document, each with a word about where it is."""

    path: Path

    def error(self, where: str, needed: str, value: Any) -> GraspFileError:
        """What is wrong, and where."""
        shown = json.dumps(value)
        return GraspFileError(
            f"{self.path}: {where} must be {needed}, got {shown if len(shown) < 40 else shown[:36] + ' ...'}"
        )

    def document(self, value: Any) -> Proofs:
        """All of it."""
        whole = self.mapping(value, "the document")
        if whole.get("command") not in COMMANDS:
            raise GraspFileError(f"{self.path}: is no document that {' or '.join(COMMANDS)} wrote with --json")
        if whole.get("schema") != SCHEMA:
            raise self.error("schema", f"{SCHEMA}, which this version reads", whole.get("schema"))
        config = self.mapping(whole.get("config"), "config")
        protocol = None if config.get("protocol") is None else self.protocol(config["protocol"])
        files = [self.mapping(file, "config.files") for file in self.list(config.get("files", []), "config.files")]
        closing = self.closing(files[0].get("closing")) if len(files) == 1 else {}
        grasps = self.list(whole.get("grasps"), "grasps")
        return Proofs(
            path=self.path,
            command=whole["command"],
            hashes=tuple(self.text(file.get("sha256"), "config.files sha256") for file in files),
            entries=tuple(self.entry(grasp, f"grasps[{i}]", protocol, closing) for i, grasp in enumerate(grasps)),
        )

    def entry(self, value: Any, where: str, protocol: Protocol | None, closing: Mapping[str, str]) -> Entry:
        """One grasp."""
        grasp = self.mapping(value, where)
        simulation = self.mapping(grasp.get("simulation") or {}, f"{where}.simulation")
        proved: dict[When, Proved] = {}
        for when in ("before", "after"):
            if simulation.get(when) is not None:
                # Refined grasps are simulated with stages of our own; before that, nobody wrote whose they were.
                own = dict.fromkeys(OTHER_STAGES, "own") if "before" in simulation and simulation["before"] else closing
                owners = own if when == "after" else {}
                proved[when] = self.proved(simulation[when], f"{where}.simulation.{when}", protocol, owners)
        row = grasp.get("row")
        if not isinstance(row, int) or isinstance(row, bool) or row < 0:
            raise self.error(f"{where}.row", "a whole number from 0 on", row)
        quality = self.mapping(grasp.get("quality") or {}, f"{where}.quality")
        return Entry(
            row=row,
            object=self.text(grasp.get("object"), f"{where}.object"),
            quality=self.number(quality.get("after"), f"{where}.quality.after"),
            proved=proved,
        )

    def proved(self, value: Any, where: str, protocol: Protocol | None, closing: Mapping[str, str]) -> Proved:
        """What simulation said of one grasp."""
        simulation = self.mapping(value, where)
        setting = simulation.get("setting")
        protocol = protocol or (SETTINGS.get(setting) if isinstance(setting, str) else None)
        if protocol is None:
            raise self.error(f"{where}.setting", f"among {', '.join(SETTINGS)}", setting)
        directions = self.list(simulation.get("directions"), f"{where}.directions")
        if not directions:
            raise self.error(f"{where}.directions", "a list with something in it", directions)
        closed = self.mapping(simulation.get("closing") or {}, f"{where}.closing")
        return Proved(
            protocol=protocol,
            tried=tuple(self.tried(one, f"{where}.directions[{i}]") for i, one in enumerate(directions)),
            closing=closing,
            closing_m=self.number(closed.get("displacement_m"), f"{where}.closing.displacement_m"),
            closing_rad=self.number(closed.get("angle_rad"), f"{where}.closing.angle_rad"),
            penetration_m=self.number(closed.get("pregrasp_penetration_m"), f"{where}.closing.pregrasp_penetration_m"),
        )

    def tried(self, value: Any, where: str) -> Tried:
        """What became of it in one direction."""
        one = self.mapping(value, where)
        names, reasons = (*AXES, *LIFT), {reason.label: reason for reason in Reason}
        if one.get("direction") not in names:
            raise self.error(f"{where}.direction", f"among {', '.join(names)}", one.get("direction"))
        if one.get("reason") not in reasons:
            raise self.error(f"{where}.reason", f"among {', '.join(reasons)}", one.get("reason"))
        columns = ("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad")
        links = self.list(one.get("contacts"), f"{where}.contacts")
        return Tried(
            direction=one["direction"],
            reason=reasons[one["reason"]],
            links=tuple(self.text(link, f"{where}.contacts") for link in links),
            **{name: self.number(one.get(name), f"{where}.{name}") for name in columns},
        )

    def protocol(self, value: Any) -> Protocol:
        """How all were simulated."""
        given = self.mapping(value, "config.protocol")
        found: dict[str, Any] = {}
        for field in fields(Protocol):
            where, one = f"config.protocol.{field.name}", given.get(field.name)
            if field.name == "name":
                found[field.name] = self.text(one, where)
            elif field.name == "directions":
                found[field.name] = tuple(self.list(one, where))
                if not set(map(str, found[field.name])) <= set(AXES):
                    raise self.error(where, f"among {', '.join(AXES)}", one)
            else:
                number = self.number(one, where)
                if not number > 0:
                    raise self.error(where, "a number above 0", one)
                found[field.name] = int(number) if isinstance(field.default, int) else number
        return Protocol(**found)

    def closing(self, value: Any) -> dict[str, str]:
        """Whose pregrasps and squeezes were simulated."""
        given = {} if value is None else self.mapping(value, "config.files closing")
        if not given:
            return {}
        if set(given) != set(OTHER_STAGES) or not {"file", "own"} >= set(map(str, given.values())):
            raise self.error("config.files closing", f"file or own for {' and '.join(OTHER_STAGES)}", value)
        return dict(given)

    def mapping(self, value: Any, where: str) -> dict[str, Any]:
        """An object of JSON."""
        if not isinstance(value, dict):
            raise self.error(where, "an object", value)
        return value

    def list(self, value: Any, where: str) -> Sequence[Any]:
        """A list."""
        if not isinstance(value, list):
            raise self.error(where, "a list", value)
        return value

    def text(self, value: Any, where: str) -> str:
        """A text."""
        if not isinstance(value, str):
            raise self.error(where, "a text", value)
        return value

    def number(self, value: Any, where: str) -> float:
        """A number, NaN where there is null."""
        if value is None:
            return nan
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not isfinite(value):
            raise self.error(where, "a number or null", value)
        return float(value)
