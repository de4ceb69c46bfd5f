"""JSON document of a batch, written while the result files are read: it may hold a million grasps."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.json_files import dumps
from grasp_refine.core.npz_files import load_npz
from grasp_refine.forces.squeeze_forces import ContactForces
from grasp_refine.measures.measures import SIDES
from grasp_refine.results.document import measure_entries
from grasp_refine.results.outcome import WORDS
from grasp_refine_apps.batch.shard import Shard

SIMULATED = ("success", "reason", "direction", "displacement_m", "angle_rad")
"""Keys of the simulation of a grasp; the result file has that of the worst direction."""


def save_batch(
    path: Path, document: Mapping[str, Any], complete: Iterable[Shard], totals: Callable[[], Mapping[str, Any]]
) -> None:
    """Write the document with an entry for each grasp, as `run --json` has them; whole or not at all.

    Args:
        path: Output file.
        document: Document without the grasps and the totals.
        complete: Shards with result files.
        totals: Returns the totals, with the time until then; called when all grasps are written.

    Raises:
        GraspRefineError: it cannot be written, or a result file cannot be read.
    """
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(dumps(document, indent=1).removesuffix("\n}") + ',\n "grasps": [')
        between = "\n  "
        for shard in complete:
            for entry in grasp_entries(shard):
                file.write(between + dumps(entry))
                between = ",\n  "
        file.write(f'\n ],\n "totals": {dumps(totals())}\n}}\n')


def grasp_entries(shard: Shard) -> Iterator[dict[str, Any]]:
    """Entry of each grasp of a shard, with the keys of `run --json`.

    Raises:
        GraspFileError: the result file cannot be read.
    """
    entries = load_npz(shard.path).entries
    values = {name: array.tolist() for name, array in entries.items()}
    forces = ContactForces.of_entries(entries)
    provenance = json.loads(values["provenance"])
    protocol = (provenance.get("config", {}).get("protocol") or {}).get("name")
    for i, status in enumerate(values["status"]):
        yield {
            "index": provenance["index"][i],
            "row": provenance["row"][i],
            "job": provenance["batch"]["job"],
            "object": values["object"] if isinstance(values["object"], str) else values["object"][i],
            "status": status,
            **{name: values[name][i] for name in WORDS},
            "advice": provenance["advice"][i],
            "forces": None if forces is None else forces.of_grasp(i),
            **measure_entries(values, i),
            "simulation": {side: _simulated(values, side, i, protocol) for side in SIDES},
        }


def _simulated(values: Mapping[str, Any], when: str, i: int, protocol: str | None) -> dict[str, Any] | None:
    """Simulation result of one grasp; None: it was not simulated."""
    if f"simulation_{when}" not in values:
        return None
    names = {key: f"simulation_{when}" if key == "success" else f"simulation_{key}_{when}" for key in SIMULATED}
    return {"protocol": protocol, **{key: values[name][i] for key, name in names.items()}}
