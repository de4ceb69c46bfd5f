"""Trials of hands: read the files, close the fingers, sample grasps, refine and simulate them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.hand import Hand
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.report import Column, Table

COLUMNS = (
    Column("hand", "hand"),
    Column("file", "file", only="page"),
    Column("reads", "reads"),
    Column("closes", "closes", only="page"),
    Column("samples", "samples", form=lambda share: "{} of {}".format(*share)),
    Column("error_before", "contact error before", "mm", ".1f"),
    Column("error_after", "after", "mm", ".2f"),
    Column("penetration_before", "penetration before", "mm", ".2f"),
    Column("penetration_after", "after", "mm", ".2f"),
    Column("held_before", "holds before", "%", ".0f"),
    Column("held_after", "after", "%", ".0f"),
    Column("trouble", "trouble", only="page"),
)
"""Columns of the table: medians of the contact error, means of the penetration, shares of the sampled grasps."""


def try_hand(
    load: Callable[[], Hand], name: str, objects: Sequence[str], count: int, protocol: str, seed: int
) -> dict[str, Any]:
    """Return the row of a hand: the result of each step; None from the first step that fails.

    Args:
        load: Reads the hand.
        name: Name of the hand in the table.
        objects: Objects on which grasps are sampled, as for `load_object`.
        count: Number of grasps sampled on each.
        protocol: Name of the protocol of the simulation.
        seed: Seed of the sampling.
    """
    row: dict[str, Any] = dict.fromkeys(column.key for column in COLUMNS) | {"hand": name, "trouble": ""}
    try:
        hand = load()
        coupled = sum(len(group.joints) - 1 for group in hand.coupled)
        row |= {
            "file": f"{hand.urdf.name} ({'MJCF' if hand.mjcf == hand.urdf else 'URDF'})",
            "reads": ", ".join(
                (
                    count_text(len(hand.joint_names), "joint"),
                    *((f"{coupled} coupled",) if coupled else ()),
                    count_text(len(hand.fingers), "finger"),
                )
            ),
        }
        closure = closure_frame(hand)
        jaws = jaw_frame(hand, closure)
        width = closure.opening if jaws is None else jaws.width[0]
        closing = count_text(int(np.count_nonzero(closure.closing)), "joint")
        row["closes"] = f"{closing}, {width * 1e3:.0f} mm wide"
        row |= _grasped(hand, objects, count, protocol, seed, row)
    except GraspRefineError as error:
        row["trouble"] = str(error)
    return row


def table_of(rows: Sequence[Row], count: int, objects: Sequence[str], protocol: str) -> Table:
    """Return the table of the rows of several hands; without the last column where every step works."""
    columns = [column for column in COLUMNS if column.key != "trouble" or any(row["trouble"] for row in rows)]
    return Table(
        f"{count_text(count, 'sampled grasp')} on each of {', '.join(objects)}; protocol {protocol}", columns, rows
    )


def name_of(source: str) -> str:
    """Return the name of a hand in the table: of a path, its last folder and file."""
    path = Path(source)
    return source if not path.suffix else f"{path.absolute().parent.name}/{path.stem}"


def _grasped(
    hand: Hand, objects: Sequence[str], count: int, protocol: str, seed: int, row: dict[str, Any]
) -> dict[str, Any]:
    """Return the numbers of grasps that were sampled, refined and simulated."""
    measures: dict[str, list[np.ndarray]] = {"contact_error_m": [], "penetration_m": [], "held": []}
    found, asked, trouble, missed = 0, 0, [], {}
    for source in objects:
        obj = gr.load_object(source)
        asked += count
        try:
            grasps = gr.sample_grasps(hand, obj, count, seed=seed)
        except GraspRefineError as error:
            missed[obj.name] = str(error)
            continue
        found += len(grasps)
        row["samples"] = [found, asked]
        refined = gr.refine(hand, obj, grasps)
        simulated = gr.simulate(refined, protocol)
        measures["held"].append(simulated.held)
        for key in ("contact_error_m", "penetration_m"):
            measures[key].append(refined.outcome[key])
        failed = np.count_nonzero(~refined.outcome.usable)
        trouble += [f"{failed} not refined on {obj.name}"] if failed else []
    if missed:
        trouble.append(f"nothing sampled on {', '.join(missed)}: {next(iter(missed.values()))}")
    if not found:
        return {"samples": [found, asked], "trouble": "; ".join(trouble)}
    errors, penetration, held = (np.concatenate(measures[key]) for key in ("contact_error_m", "penetration_m", "held"))
    before, after = np.nanmedian(errors, axis=0).tolist()
    depth = np.nanmean(penetration, axis=0).tolist()
    share = held.mean(axis=0).tolist()
    return {
        "samples": [found, asked],
        "error_before": before,
        "error_after": after,
        "penetration_before": depth[0],
        "penetration_after": depth[1],
        "held_before": share[0],
        "held_after": share[1],
        "trouble": "; ".join(trouble),
    }
