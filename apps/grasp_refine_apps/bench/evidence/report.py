"""Report of the evidence: one table for each way to group grasps, reasons, and pictures of failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from grasp_refine.validation.trials import Reason
from grasp_refine_apps.batch.page import case_entry
from grasp_refine_apps.batch.pictures import Picture
from grasp_refine_apps.batch.worst import Case, case_of
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.evidence.cases import SAMPLED, SIZES
from grasp_refine_apps.bench.evidence.results import NOT_SIMULATED, Block, agreement, summaries, summary
from grasp_refine_apps.bench.evidence.trials import METHODS, REFINED
from grasp_refine_apps.bench.report import MISSING, SCALES, Column, Figures, Note, Report, Table

ARROW = " → "
"""Between the values of the methods in a cell."""
NUMBERS = (
    ("penetration_m", "penetration, mm", "mm", ".2f", "deepest of any link, mean"),
    ("moved_palm_m", "palm moved, mm", "mm", ".1f", "median"),
    ("moved_palm_rad", "turned, °", "°", ".1f", "median"),
    ("cpu_s", "CPU, s", "s", ".3f", "of refining a grasp, mean"),
)
"""Key of a row, heading, unit, format and hint of the columns beside the verdicts, on a page."""

PICTURES_PER_REASON = 4
"""Number of failures shown for each reason, of different hands and objects where there are enough."""

PICTURES = "As given (left) and refined (right). Commands are for the folder of this page."

INTRO = (
    "Grasps as they were given, refined by geometry only, and refined so that forces balance: each cell has the values "
    "of the three, from left to right. No simulation takes part in refinement. A grasp that was refined holds with our "
    "own pregrasp and squeeze; as given, with those of its generator where it has them."
)

AGREEMENT = (
    "Grasps as given, by geometry only, and refined, that have the same verdict in both; kappa is the agreement beyond "
    "chance, and unknown where all grasps have one verdict."
)


def tables(
    blocks: Sequence[Block],
    failed: Sequence[Row],
    protocols: Sequence[str],
    pairs: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> list[Table]:
    """Return all tables; the rows of the first are of all grasps.

    Args:
        blocks: The grasps.
        failed: Jobs without all results: job, missing (grasps) and reason.
        protocols: Names of the protocols: labels of `Trial`.
        pairs: Name of a protocol -> its labels in MuJoCo and in Drake, where grasps were tried in both.
    """
    columns = [Column("label", "grasps of"), Column("grasps", "number", form="d"), *_columns(protocols)]
    found = [Table("All grasps", columns, [summary("all", blocks, protocols)])]
    ways = (
        ("By hand", lambda case: case.hand.name, ()),
        ("By generator", lambda case: case.generator, (SAMPLED,)),
        ("By shape of the object", lambda case: case.object.shape, ("convex", "concave")),
        ("By size of the object", lambda case: case.object.size, SIZES),
    )
    found += [Table(title, columns, summaries(key, blocks, protocols, first=first)) for title, key, first in ways]
    if pairs:
        rows = [agreement(name, blocks, labels) for name, labels in pairs.items()]
        found.append(Table("Agreement of MuJoCo and Drake", _agreement_columns(), rows, note=AGREEMENT))
    by_object = summaries(lambda case: case.object.name, blocks, protocols)
    found.append(Table("By object", columns, by_object, only="page", folded=True))
    found.append(Table("Why grasps do not hold", *_reasons(blocks, protocols), note="Numbers of grasps."))
    if failed:
        heads = [Column("job", "job"), Column("missing", "grasps", form="d"), Column("reason", "failed")]
        found.append(Table("Jobs that failed", heads, failed))
    return found


def report(found: Sequence[Table], pictures: Mapping[str, Sequence[Picture]]) -> Report:
    """Return the report.

    Args:
        found: The `tables`.
        pictures: Reason and protocol in words -> failures of refined grasps.
    """
    figures = [
        Figures(f"Refined grasps that do not hold: {what}", PICTURES, [case_entry(picture) for picture in some])
        for what, some in pictures.items()
    ]
    return Report("Evidence at scale", [Note(INTRO), *found, *figures])


def failures(blocks: Sequence[Block], protocols: Sequence[str]) -> dict[str, list[Case]]:
    """Return some refined grasps that did not hold, by protocol and reason; those of most frequent reasons first."""
    found: dict[str, list[Case]] = {}
    for protocol in protocols:
        places: dict[str, list[tuple[Block, int]]] = {}
        for block in blocks:
            for i, reason in enumerate(block.reasons[protocol][REFINED].tolist()):
                if reason not in (Reason.HELD.label, NOT_SIMULATED):
                    places.setdefault(reason, []).append((block, i))
        for reason, at in sorted(places.items(), key=lambda entry: (-len(entry[1]), entry[0])):
            title = f"{reason}, {protocol} ({len(at)} grasps)"
            found[title] = [_case(block, i, reason) for block, i in _varied(at)]
    return found


def _varied(at: Sequence[tuple[Block, int]]) -> list[tuple[Block, int]]:
    """Choose grasps of hands and objects that were not chosen before, as far as there are."""
    seen: Counter[str | tuple[str, str]] = Counter()
    ranked = []
    for number, (block, _) in enumerate(at):
        names = block.case.hand.name, block.case.object.name
        ranked.append((seen[names], sum(seen[name] for name in names), number))
        seen.update((names, *names))
    return [at[number] for *_, number in sorted(ranked)[:PICTURES_PER_REASON]]


def _case(block: Block, i: int, reason: str) -> Case:
    hand, thing = block.case.hand.name, block.case.object.name
    return replace(case_of(block.rows[REFINED], i), held=False, reason=reason, hand=hand, object=thing)


def markdown(found: Sequence[Table], about: Sequence[str]) -> str:
    """Return the tables as Markdown, for the documentation.

    Args:
        found: The tables.
        about: Paragraphs on how they were made.
    """
    parts = [INTRO, *about]
    for table in found:
        if not table.folded:
            parts += [f"### {table.title}", *([table.note] if table.note else []), table.markdown()]
    return "\n\n".join(parts) + "\n"


def _columns(protocols: Sequence[str]) -> list[Column]:
    return [
        *(Column(f"held_{name}", f"held, {name}", "", _listed("%", ".1f"), only="page") for name in protocols),
        *(Column(f"held_{name}", name, "", _listed("%", ".0f", "→"), only="terminal") for name in protocols),
        *(
            Column(key, head, "", _listed(unit, form), hint=hint, only="page")
            for key, head, unit, form, hint in NUMBERS
        ),
    ]


def _agreement_columns() -> list[Column]:
    return [
        Column("label", "protocol"),
        Column("grasps", "number", form="d"),
        Column("share", "same verdict", "", _listed("%", ".1f"), hint="share of the grasps"),
        Column("kappa", "kappa", "", _kappas, hint="1: equal, 0: as by chance"),
        Column("mujoco_only", "held in MuJoCo only", "", _listed("", ".0f"), hint="number of grasps"),
        Column("drake_only", "held in Drake only", "", _listed("", ".0f"), hint="number of grasps"),
    ]


def _kappas(values: Sequence[float | None]) -> str:
    """Format kappas, each of which may be unknown."""
    return ARROW.join(MISSING if value is None else f"{value:z.2f}" for value in values)


def _listed(unit: str, form: str, between: str = ARROW) -> Any:
    """Format of the values of all methods that have one."""
    scale = SCALES.get(unit, 1.0)

    def text(values: Sequence[float | None]) -> str:
        shown = [f"{scale * value:{form}}" for value in values if value is not None]
        return between.join(shown) + (" %" if unit == "%" else "") if shown else MISSING

    return text


def _reasons(blocks: Sequence[Block], protocols: Sequence[str]) -> tuple[list[Column], list[Row]]:
    """Columns and rows of the numbers of grasps by reason, with those that held, and all."""
    numbers: dict[str, dict[str, list[int]]] = {}
    for protocol in protocols:
        for at, method in enumerate(METHODS):
            for block in blocks:
                for reason, count in zip(*np.unique(block.reasons[protocol][method], return_counts=True), strict=True):
                    counts = numbers.setdefault(str(reason), {}).setdefault(protocol, [0] * len(METHODS))
                    counts[at] += int(count)
    held = numbers.pop(Reason.HELD.label, {})
    order = sorted(numbers, key=lambda reason: -sum(map(sum, numbers[reason].values())))
    listed = {"held": held, **{reason: numbers[reason] for reason in order}}
    nothing = [0] * len(METHODS)
    rows: list[Row] = [
        {"label": label, **{protocol: counts.get(protocol, nothing) for protocol in protocols}}
        for label, counts in listed.items()
    ]
    columns = [Column(name, name, "", lambda counts: ARROW.join(map(str, counts))) for name in protocols]
    return [Column("label", "grasps that"), *columns], rows
