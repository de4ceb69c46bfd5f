"""Certificate of grasps: the verdict of each engine, with its version, under one protocol, task and closing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.json_files import dumps
from grasp_refine.core.npz_files import NpzFile, load_npz, save_npz
from grasp_refine.core.short_repr import labels
from grasp_refine.results.document import settings
from grasp_refine.results.result_numbers import held_entry, reason_entry
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import task_entry
from grasp_refine.validation.engine_table import ENGINES, EngineName
from grasp_refine.validation.robustness import SEED
from grasp_refine.validation.trials import Reason, Trials

CERTIFICATE = "certificate"
"""Entry of result files: JSON of `conditions_of`, with the version and seed of each engine under "engines"."""

GRASPS = ("hand_pose", "q", "pregrasp_pose", "pregrasp_q", "squeeze_pose", "squeeze_q")
"""Entries that verdicts are on."""


def conditions_of(
    protocol: Protocol, task: Task, closing: Mapping[str, str], grasps: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Return what verdicts must share to stand side by side: protocol, task, closing, and the hash of the grasps.

    Args:
        protocol: Protocol of the simulation.
        task: Its surroundings.
        closing: Stage -> "file" or "own", as of `Problem.closing`.
        grasps: Entries of the grasp file.
    """
    digest = hashlib.sha256()
    for name in GRASPS:
        if name in grasps:
            digest.update(np.ascontiguousarray(grasps[name], dtype=float).tobytes())
    found = {
        "protocol": settings(protocol),
        "task": {key: value for key, value in task_entry(task).items() if key != "protocol"},
        "closing": dict(closing),
        "grasps": digest.hexdigest(),
    }
    return json.loads(dumps(found))


def certificate_entries(
    conditions: Mapping[str, Any], sides: Mapping[str, Mapping[EngineName, Trials]]
) -> dict[str, np.ndarray]:
    """Return the entries of a result file for the verdicts of each engine, by side, on all of its grasps."""
    entries: dict[str, np.ndarray] = {}
    used = {name: _used(name) for engines in sides.values() for name in engines}
    for side, engines in sides.items():
        for name, trials in engines.items():
            entries[held_entry(name, side)] = trials.success.astype(float)
            entries[reason_entry(name, side)] = labels(Reason, trials.outcome)
    return {**entries, CERTIFICATE: np.array(dumps({**conditions, "engines": used}))}


def _used(name: EngineName) -> dict[str, Any]:
    """Return version and seed of an engine, as they are now."""
    return {"version": ENGINES[name].version, "seed": SEED}


def record_verdicts(
    path: Path,
    rows: np.ndarray,
    engines: Mapping[EngineName, Trials],
    protocol: Protocol,
    task: Task,
    closing: Mapping[str, str],
) -> str:
    """Add verdicts on grasps of a file to it, beside those of other engines, and return a line on what happened.

    Verdicts in the file under other conditions, or on other grasps, are replaced, `simulation_...` included.

    Args:
        path: Grasp file of our format.
        rows: Rows (n,) of the grasps in the file.
        engines: Name of each engine -> trials of these grasps.
        protocol: Protocol of the simulation.
        task: Its surroundings.
        closing: As of `conditions_of`.

    Raises:
        GraspFileError: it is damaged, or cannot be written.
    """
    file = load_npz(path)
    entries = dict(file.entries)
    count = len(entries["hand_pose"])
    conditions = conditions_of(protocol, task, closing, entries)
    before = read_certificate(file)
    known = before.pop("engines", {})
    line = f"{path}: verdict of {', '.join(ENGINES[name].title for name in engines)} recorded"
    if before != conditions:
        if before:
            changed = ", ".join(key for key in conditions if before.get(key) != conditions[key])
            line += f"; it replaces those of {', '.join(known)}, which had other {changed}"
        stale = ("simulation_", *(f"{word}_{name}_" for name in known for word in ("held", "reason")))
        entries = {key: value for key, value in entries.items() if not key.startswith(stale)}
        known = {}
    elif others := [name for name in known if name not in engines]:
        line += f", beside {', '.join(others)}"
    for name, trials in engines.items():
        same = known.get(name) == _used(name)
        held, reason = held_entry(name, "after"), reason_entry(name, "after")
        verdict = entries[held].astype(float) if same and held in entries else np.full(count, np.nan)
        why = entries[reason].astype(object) if same and reason in entries else np.full(count, "", dtype=object)
        verdict[rows], why[rows] = trials.success, labels(Reason, trials.outcome)
        entries |= {held: verdict, reason: why.astype(str)}
        known[name] = _used(name)
    first = next(iter(known))
    decides = entries[held_entry(first, "after")]
    entries["simulation_after"] = decides if np.isnan(decides).any() else decides.astype(bool)
    entries["simulation_reason_after"] = entries[reason_entry(first, "after")]
    save_npz(path, {**entries, CERTIFICATE: np.array(dumps({**conditions, "engines": known}))})
    return line


def read_certificate(file: NpzFile) -> dict[str, Any]:
    """Return the certificate of a grasp file; empty where it has none.

    Raises:
        GraspFileError: it is damaged.
    """
    if CERTIFICATE not in file.entries:
        return {}
    try:
        found = json.loads(file.name(CERTIFICATE))
    except (ValueError, RecursionError) as error:
        raise file.error(f"{CERTIFICATE} is no JSON ({error})") from None
    if not isinstance(found, dict) or not isinstance(found.get("engines", {}), dict):
        raise file.error(f"{CERTIFICATE} must be a JSON object")
    return found
