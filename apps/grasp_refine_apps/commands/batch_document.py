"""JSON document of a batch, written while the result files are read: it may hold a million grasps."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.json_files import dumps
from grasp_refine.core.npz_files import load_npz
from grasp_refine_apps.batch.shard import Shard

BEFORE_AFTER = ("before", "after")

MEASURES = {
    "quality": "quality",
    "penetration_m": "penetration",
    "self_penetration_m": "self_penetration",
    "wrench_residual": "wrench_residual",
}
"""Key of a grasp in the document -> prefix of the arrays in a result file."""

SIMULATED = ("success", "reason", "direction", "displacement_m", "angle_rad")
"""Keys of the simulation of a grasp; the result file has that of the worst direction."""


def save_batch(path: Path, document: Mapping[str, Any], complete: Iterable[Shard]) -> None:
    """Write the document with an entry for each grasp, as `run --json` has them; whole or not at all.

    Args:
        path: Output file.
        document: Document without the grasps.
        complete: Shards with result files.

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
        file.write("\n ]\n}\n")


def grasp_entries(shard: Shard) -> Iterator[dict[str, Any]]:
    """Entry of each grasp of a shard, with the keys of `run --json`.

    Raises:
        GraspFileError: the result file cannot be read.
    """
    values = {name: array.tolist() for name, array in load_npz(shard.path).entries.items()}
    provenance = json.loads(values["provenance"])
    setting = (provenance.get("config", {}).get("protocol") or {}).get("name")
    for i, status in enumerate(values["status"]):

        def at(name: str, i: int = i) -> Any:
            return values[name][i]

        def measured(name: str) -> dict[str, Any]:
            return {when: at(f"{name}_{when}") for when in BEFORE_AFTER}  # noqa: B023

        yield {
            "index": provenance["index"][i],
            "row": provenance["row"][i],
            "job": provenance["batch"]["job"],
            "object": values["object"] if isinstance(values["object"], str) else at("object"),
            "status": status,
            "advice": provenance["advice"][i],
            **{name: at(name) for name in ("starts", "iterations", "queries", "wall_s", "cpu_s")},
            "contact_error_m": {
                when: {"max": at(f"contact_error_{when}"), "mean": at(f"contact_error_mean_{when}")}
                for when in BEFORE_AFTER
            },
            **{key: measured(name) for key, name in MEASURES.items()},
            "limits_violated": at("limits_violated"),
            "moved": {name: at(f"moved_{name}") for name in ("palm_m", "palm_rad", "joints_rad")},
            "simulation": {when: _simulated(values, when, i, setting) for when in BEFORE_AFTER},
        }


def _simulated(values: Mapping[str, Any], when: str, i: int, setting: str | None) -> dict[str, Any] | None:
    """Simulation result of one grasp; None: it was not simulated."""
    if f"simulation_{when}" not in values:
        return None
    names = {key: f"simulation_{when}" if key == "success" else f"simulation_{key}_{when}" for key in SIMULATED}
    return {"setting": setting, **{key: values[name][i] for key, name in names.items()}}
