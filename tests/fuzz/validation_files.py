"""Documents that `run` and `validate` wrote, as the viewer opens them."""

from __future__ import annotations

import json
from collections.abc import Hashable
from dataclasses import asdict
from pathlib import Path
from random import Random

from fuzz.mutations import changed_value
from fuzz.reader import Reader
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.files.validation_file import read_validation

DIRECTION = {"direction": "+x", "reason": Reason.HELD.label, "contacts": ["tip"], "time_s": 1.0}
DIRECTION |= {"displacement_m": 0.01, "angle_rad": 0.1, "peak_m": 0.02, "peak_rad": 0.2}
SIMULATION = {
    "protocol": "dexgraspbench",
    "directions": [DIRECTION],
    "closing": {"displacement_m": 0.1, "angle_rad": 1},
}
DOCUMENT = {
    "schema": 1,
    "command": "validate",
    "config": {
        "protocol": json.loads(json.dumps(asdict(Protocol()))),
        "files": [{"sha256": "0" * 64, "path": "a.npz", "closing": {"pregrasp": "file", "squeeze": "own"}}],
    },
    "grasps": [{"file": "a.npz", "row": 0, "object": "mug", "simulation": {"after": SIMULATION}}],
}
WORDS = (b"null", b"true", b"NaN", b"-Infinity", b"1e999", b"\\ud800", b"[", b"{")


def seeds() -> list[tuple[str, bytes]]:
    """One of each command."""
    run = DOCUMENT | {"command": "run", "config": {}}
    return [("validate.json", json.dumps(DOCUMENT).encode()), ("run.json", json.dumps(run).encode())]


def change(random: Random, name: str, content: bytes) -> bytes:
    """Another value somewhere."""
    if random.random() < 0.02:
        return b"[" * 30000
    try:
        return json.dumps(changed_value(random, json.loads(content))).encode()
    except (ValueError, RecursionError):
        return content


def read(path: Path) -> Hashable:
    """What the document says."""
    found = read_validation(path)
    return found.command, len(found.entries), tuple(sorted({len(entry.trials) for entry in found.entries}))


READER = Reader("proofs", seeds, read, change, WORDS)
