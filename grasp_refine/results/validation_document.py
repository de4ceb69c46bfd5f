"""JSON document of validated grasps, and its flat table for CSV and Parquet; SI units."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import SCHEMA, save_bytes, save_text
from grasp_refine.core.machine import machine
from grasp_refine.core.names import to_cell
from grasp_refine.core.versions import versions
from grasp_refine.measures.measures import COUNT, RECORDED, SECOND, Measure
from grasp_refine.results.simulated import engine_entries, simulation_entry
from grasp_refine.results.verdict import should_hold
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engine_agreement import EngineAgreement
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import Validated

QUANTILES = {0.5: "median", 0.9: "90 %", 1.0: "worst"}
"""Reported quantiles of displacements -> name."""

TABLE_SUFFIXES = (".csv", ".parquet")
"""Suffixes of the files of flat tables."""


def validate_document(
    parts: Sequence[Validated],
    files: Sequence[Path],
    *,
    protocol: Protocol | None,
    frictions: Sequence[float],
    config: Mapping[str, Any],
    seed: int,
    times: Mapping[str, float],
) -> dict[str, Any]:
    """Return the document of `validate`: totals, and one entry per grasp.

    Args:
        parts: The grasps of each file.
        files: The files.
        protocol: Protocol of the simulation; None: not simulated.
        frictions: Coefficients of friction beside that of the protocol.
        config: All settings.
        seed: Seed of all random numbers.
        times: Seconds by key: `wall_s` and `cpu_s` of the whole command, and parts of it.
    """
    validated = Validated.join(list(parts))
    simulated = validated.trials is not None
    return {
        "schema": SCHEMA,
        "command": "validate",
        "versions": versions(),
        "machine": machine(),
        "config": config,
        "seed": seed,
        "totals": {
            "n": len(validated),
            "converged": None,
            "good_before": None,
            "good_after": int(should_hold(validated.metrics.quality).sum()),
            "success_before": None,
            "success_after": int(validated.success.sum()) if simulated else None,
            "by_friction": None
            if validated.frictions is None
            else {f"{f:g}": int(n) for f, n in zip(frictions, validated.frictions.sum(axis=0), strict=True)},
            "moved_m": _quantiles(validated, "peak_m"),
            "turned_rad": _quantiles(validated, "peak_rad"),
            "engine_agreement": _engine_agreement(validated),
            "simulation_cpu_s": float(validated.cpu_s.sum()) if simulated else None,
            **times,
        },
        "grasps": [
            {"file": path, **_grasp(part, i, protocol, frictions)}
            for path, part in zip(files, parts, strict=True)
            for i in range(len(part))
        ],
    }


def _grasp(validated: Validated, i: int, protocol: Protocol | None, frictions: Sequence[float]) -> dict[str, Any]:
    """Return an entry as in `run`: measures are under "after", and "before" is null."""

    def after(value: Any) -> dict[str, Any]:
        return {"before": None, "after": value}

    def measured(measure: Measure) -> Any:
        value = validated.metrics.values[measure.name][i]
        value = _integer(value) if measure.unit == COUNT else value
        return after(value) if measure.compared else value

    return {
        "index": validated.index[i],
        "row": validated.row[i],
        "object": validated.object[i],
        "scale": validated.scale[i],
        # Validation refines nothing.
        **dict.fromkeys(refinement_keys()),
        "wall_s": validated.wall_s[i],
        "cpu_s": validated.cpu_s[i],
        **{each.name: measured(each) for each in validated.metrics.measures},
        "simulation": after(_simulation(validated, i, protocol, frictions)),
    }


def _engine_agreement(validated: Validated) -> list[dict[str, Any]]:
    """Return how far each two engines agree."""
    found = []
    for first, second in combinations(validated.engines, 2):
        agreement = EngineAgreement.of(*(validated.engines[name].success for name in (first, second)))
        labels = {"first": first, "second": second}
        found.append({**labels, **asdict(agreement), "share": agreement.share, "kappa": agreement.kappa})
    return found


def _simulation(
    validated: Validated, i: int, protocol: Protocol | None, frictions: Sequence[float]
) -> dict[str, Any] | None:
    """Return the simulation of one grasp; None where there was none."""
    if validated.trials is None or protocol is None:
        return None
    return {
        **simulation_entry(validated.trials, i, protocol),
        "closed_first_m": None if validated.closed_m is None else validated.closed_m[i],
        "mass_kg": None if validated.mass is None else validated.mass[i],
        **engine_entries(validated.engines, i, protocol),
        "flags": {
            "barely": validated.barely(protocol)[i],
            "by_squeeze": validated.by_squeeze[i],
            "by_creep": validated.by_creep[i],
        },
        "creep": {
            "displacement_m": None if validated.creep is None else validated.creep[i, 0],
            "angle_rad": None if validated.creep is None else validated.creep[i, 1],
        },
        "without_squeeze": None if validated.unsqueezed is None else validated.unsqueezed[i],
        "noise_score": None if validated.noise is None else validated.noise[i],
        "by_friction": None
        if validated.frictions is None
        else {f"{f:g}": held for f, held in zip(frictions, validated.frictions[i], strict=True)},
    }


def refinement_keys() -> tuple[str, ...]:
    """Return the keys of the entries of `run` that are null in validations; times are of the simulation."""
    measures = (each for each in RECORDED if not (each.validated or each.unit == SECOND))
    return ("status", "advice", *(each.name for each in measures))


def flat_rows(
    parts: Sequence[Validated], files: Sequence[Path], protocol: Protocol | None, frictions: Sequence[float]
) -> list[dict[str, Any]]:
    """Return one flat row per grasp: the entries of the document, without single directions."""
    rows = []
    entries = (
        (part, i, {"file": str(path), **_grasp(part, i, protocol, frictions)})
        for path, part in zip(files, parts, strict=True)
        for i in range(len(part))
    )
    engines = dict.fromkeys(name for part in parts for name in part.engines)
    for part, i, entry in entries:
        row = {key: value["after"] if isinstance(value, dict) else value for key, value in entry.items()}
        row = {key: value for key, value in row.items() if key not in refinement_keys()}
        simulation = row.pop("simulation") or {}
        for key in ("directions", "engines", "certificate"):
            simulation.pop(key, None)
        for name in engines:
            trials = part.engines.get(name)
            simulation[f"held_{name}"] = None if trials is None else trials.success[i]
            simulation[f"reason_{name}"] = None if trials is None else Reason(trials.outcome[i]).label
        for key, value in simulation.items():
            nested = value if isinstance(value, dict) else {"": value}
            for part_name, each in nested.items():
                row["_".join(filter(None, (key, part_name)))] = " ".join(each) if isinstance(each, list) else each
        rows.append({key: _scalar(value) for key, value in row.items()})
    return rows


def _quantiles(validated: Validated, field: Literal["peak_m", "peak_rad"]) -> dict[str, float] | None:
    """Return quantiles of the largest displacements of the objects of grasps that held."""
    if validated.trials is None or not validated.success.any():
        return None
    most = validated.trials.most(field)[validated.success]
    return {f"{q:g}": float(np.quantile(most, q)) for q in QUANTILES}


def _integer(value: float) -> int | None:
    return int(value) if np.isfinite(value) else None


def _scalar(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def check_table(path: Path) -> None:
    """Refuse a path that no flat table can be written to.

    Raises:
        GraspRefineError: another ending, or Parquet without pyarrow.
    """
    if path.suffix.lower() not in TABLE_SUFFIXES:
        raise GraspRefineError(f"{path}: a table of grasps ends with {' or '.join(TABLE_SUFFIXES)}")
    if path.suffix.lower() == ".parquet":
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError:
            raise GraspRefineError(
                f'{path}: Parquet needs pyarrow; pip install "grasp-refine[parquet]", or write a .csv'
            ) from None


def save_parquet(path: Path, table: Any) -> None:
    """Write a table of pyarrow as Parquet; the file appears whole or not at all.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    import pyarrow.parquet

    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table, buffer)
    save_bytes(path, buffer.getvalue())


def save_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write flat rows as CSV or Parquet, by the suffix; the file appears whole or not at all.

    Text in a CSV is never a formula of a spreadsheet; see `to_cell`.

    Raises:
        GraspRefineError: the file cannot be written.
    """
    check_table(path)
    if path.suffix.lower() == ".parquet":
        import pyarrow

        save_parquet(path, pyarrow.Table.from_pylist(list(rows)))
        return
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: to_cell(value) if isinstance(value, str) else value for key, value in row.items()} for row in rows
    )
    save_text(path, text.getvalue())
