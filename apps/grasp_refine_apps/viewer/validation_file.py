"""Reader of simulation results in the documents of `validate --json` and `run --json`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import nan
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.json_files import SCHEMA
from grasp_refine.grasps.grasp_set import OTHER_STAGES
from grasp_refine.validation.protocol import AXES, SETTINGS, Protocol
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.validated import DirectionResult, TrialResult
from grasp_refine_apps.viewer.validations import COMMANDS, Entry, ValidationFile, When

MAX_FILE_BYTES = 2**28
"""Maximum bytes of a document: 256 MiB, or some 40 000 grasps."""

MAX_MAGNITUDE = 1e12
"""Upper bound of the magnitude of numbers in SI units."""

MAX_VALUE_CHARS = 40
"""Maximum characters of a wrong value in a message."""


def read_validation(path: Path) -> ValidationFile:
    """Read the simulation results of a document.

    Raises:
        GraspFileError: it cannot be read, is damaged, or is none of these documents; the message says where.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise GraspFileError(f"{path}: has more than {MAX_FILE_BYTES // 2**20} MiB")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, RecursionError) as error:
        raise GraspFileError(f"{path}: is no JSON document ({' '.join(str(error).split())[:80]})") from None
    return _Reader(path).document(document)


@dataclass(frozen=True)
class _Reader:
    """Reader of the parts of a document, each with its place for messages."""

    path: Path

    def error(self, where: str, needed: str, value: Any) -> GraspFileError:
        """Return the error of a wrong value, with its place."""
        shown = json.dumps(value)
        shown = shown if len(shown) < MAX_VALUE_CHARS else f"{shown[: MAX_VALUE_CHARS - 4]} ..."
        return GraspFileError(f"{self.path}: {where} must be {needed}, got {shown}")

    def document(self, value: Any) -> ValidationFile:
        """Read the whole document."""
        whole = self.mapping(value, "the document")
        if whole.get("command") not in COMMANDS:
            raise GraspFileError(f"{self.path}: is no document that {' or '.join(COMMANDS)} wrote with --json")
        if whole.get("schema") != SCHEMA:
            raise self.error("schema", f"{SCHEMA}, which this version reads", whole.get("schema"))
        config = self.mapping(whole.get("config"), "config")
        protocol = None if config.get("protocol") is None else self.protocol(config["protocol"])
        files = [self.mapping(file, "config.files") for file in self.list(config.get("files", []), "config.files")]
        # `run` does not write the source of the stages that were simulated before refinement.
        closing: dict[When, Mapping[str, str]] = {"after": dict.fromkeys(OTHER_STAGES, "own")}
        if whole["command"] == "validate":
            closing = {"after": self.closing(files[0].get("closing")) if len(files) == 1 else {}}
        grasps = self.list(whole.get("grasps"), "grasps")
        return ValidationFile(
            path=self.path,
            command=whole["command"],
            files={
                self.text(file.get("sha256"), "config.files sha256"): self.text(file.get("path"), "config.files path")
                for file in files
            },
            entries=tuple(self.entry(grasp, f"grasps[{i}]", protocol, closing) for i, grasp in enumerate(grasps)),
        )

    def entry(self, value: Any, where: str, protocol: Protocol | None, closing: Mapping[When, Any]) -> Entry:
        """Read one grasp."""
        grasp = self.mapping(value, where)
        simulation = self.mapping(grasp.get("simulation") or {}, f"{where}.simulation")
        trials: dict[When, TrialResult] = {}
        for when in ("before", "after"):
            if simulation.get(when) is not None:
                at = f"{where}.simulation.{when}"
                trials[when] = self.trial_result(simulation[when], at, protocol, closing.get(when, {}))
        row = grasp.get("row")
        if not isinstance(row, int) or isinstance(row, bool) or row < 0:
            raise self.error(f"{where}.row", "an integer of at least 0", row)
        quality = self.mapping(grasp.get("quality") or {}, f"{where}.quality")
        return Entry(
            file=self.text(grasp.get("file", ""), f"{where}.file"),
            row=row,
            object=self.text(grasp.get("object"), f"{where}.object"),
            quality=self.number(quality.get("after"), f"{where}.quality.after"),
            trials=trials,
        )

    def trial_result(
        self, value: Any, where: str, protocol: Protocol | None, closing: Mapping[str, str]
    ) -> TrialResult:
        """Read the simulation result of one grasp."""
        simulation = self.mapping(value, where)
        setting = simulation.get("setting")
        protocol = protocol or (SETTINGS.get(setting) if isinstance(setting, str) else None)
        if protocol is None:
            raise self.error(f"{where}.setting", f"among {', '.join(SETTINGS)}", setting)
        directions = self.list(simulation.get("directions"), f"{where}.directions")
        if not directions:
            raise self.error(f"{where}.directions", "a list that is not empty", directions)
        closed = self.mapping(simulation.get("closing") or {}, f"{where}.closing")
        return TrialResult(
            protocol=protocol,
            results=tuple(self.direction_result(one, f"{where}.directions[{i}]") for i, one in enumerate(directions)),
            closing=closing,
            closing_m=self.number(closed.get("displacement_m"), f"{where}.closing.displacement_m"),
            closing_rad=self.number(closed.get("angle_rad"), f"{where}.closing.angle_rad"),
            penetration_m=self.number(closed.get("pregrasp_penetration_m"), f"{where}.closing.pregrasp_penetration_m"),
        )

    def direction_result(self, value: Any, where: str) -> DirectionResult:
        """Read the result of one direction."""
        one = self.mapping(value, where)
        names, reasons = (*AXES, *LIFT), {reason.label: reason for reason in Reason}
        if one.get("direction") not in names:
            raise self.error(f"{where}.direction", f"among {', '.join(names)}", one.get("direction"))
        if not isinstance(one.get("reason"), str) or one["reason"] not in reasons:
            raise self.error(f"{where}.reason", f"among {', '.join(reasons)}", one.get("reason"))
        columns = ("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad")
        links = self.list(one.get("contacts"), f"{where}.contacts")
        return DirectionResult(
            direction=one["direction"],
            reason=reasons[one["reason"]],
            links=tuple(self.text(link, f"{where}.contacts") for link in links),
            **{name: self.number(one.get(name), f"{where}.{name}") for name in columns},
        )

    def protocol(self, value: Any) -> Protocol:
        """Read the protocol of all simulations."""
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
        """Read the source of the simulated pregrasps and squeezes."""
        given = {} if value is None else self.mapping(value, "config.files closing")
        if not given:
            return {}
        if set(given) != set(OTHER_STAGES) or not {"file", "own"} >= set(map(str, given.values())):
            raise self.error("config.files closing", f"file or own for {' and '.join(OTHER_STAGES)}", value)
        return dict(given)

    def mapping(self, value: Any, where: str) -> dict[str, Any]:
        """Check a JSON object."""
        if not isinstance(value, dict):
            raise self.error(where, "an object", value)
        return value

    def list(self, value: Any, where: str) -> Sequence[Any]:
        """Check a list."""
        if not isinstance(value, list):
            raise self.error(where, "a list", value)
        return value

    def text(self, value: Any, where: str) -> str:
        """Check a text."""
        if not isinstance(value, str):
            raise self.error(where, "a text", value)
        return value

    def number(self, value: Any, where: str) -> float:
        """Check a number; null becomes NaN."""
        if value is None:
            return nan
        known = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < MAX_MAGNITUDE
        if not known:
            raise self.error(where, f"a number below {MAX_MAGNITUDE:g}, or null", value)
        return float(value)
