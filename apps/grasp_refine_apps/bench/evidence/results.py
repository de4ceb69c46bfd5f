"""Results of the evidence: the files of each case, and what they say of groups of grasps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from grasp_refine.core.npz_files import load_npz
from grasp_refine.validation.engine_agreement import EngineAgreement
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.batch.rows import Rows, read_rows
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.bench.chart import Row, of_finite
from grasp_refine_apps.bench.evidence.cases import EvidenceCase
from grasp_refine_apps.bench.evidence.trials import (
    GEOMETRY,
    GIVEN,
    METHODS,
    REFINED,
    Trial,
    key_of,
    refined_in_both,
)

NOT_SIMULATED = "not simulated"
"""Reason of grasps whose trials failed as a whole."""

MEASURES: Mapping[str, tuple[str | None, str, Callable[..., float]]] = {
    "penetration_m": ("penetration_m_before", "penetration_m_after", np.mean),
    "moved_palm_m": (None, "moved_palm_m", np.median),
    "moved_palm_rad": (None, "moved_palm_rad", np.median),
    "cpu_s": (None, "cpu_s", np.mean),
}
"""Measure of a group -> columns of an index as given (None: there is none) and after refinement, and its statistic."""


@dataclass(frozen=True, eq=False)
class Block:
    """N grasps of one case, from one result file of each batch."""

    case: EvidenceCase
    shard: Shard
    """Shard of the refined grasps."""
    rows: Mapping[str, Rows]
    """Rows (N) of the index of the two refinements, by method."""
    reasons: Mapping[str, Mapping[str, np.ndarray]]
    """Label of a `Trial` -> method -> reason (N,) in words, "held" where the grasp did."""
    simulation_cpu_s: float
    """CPU time of all trials, seconds."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.rows[REFINED])


def read_blocks(
    cases: Sequence[EvidenceCase],
    refined: Mapping[str, Sequence[Shard]],
    simulated: Iterable[Shard],
    trials: Sequence[Trial],
    out: Path,
) -> list[Block]:
    """Read the files of all grasps that were refined in both ways.

    Args:
        cases: All cases.
        refined: Method -> complete shards of its batch.
        simulated: Complete shards of trials.
        trials: Ways in which they were tried.
        out: Folder of the evidence.

    Raises:
        GraspFileError: a file is damaged, or was replaced meanwhile.
    """
    of_job = {case.job: case for case in cases}
    there = {shard.path for shard in simulated}
    blocks = []
    for place, shards in refined_in_both(refined, out).items():
        rows = {method: read_rows(shard, out) for method, shard in shards.items()}
        reasons, cpu_s = {}, 0.0
        for trial in trials:
            path = out / trial.folder / place
            if path in there:
                file = load_npz(path)
                reasons[trial.label] = {
                    method: np.array(file.names(f"{key_of(method)}_reason"), dtype=str) for method in METHODS
                }
                cpu_s += float(sum(file.numbers(f"{key_of(method)}_cpu_s").sum() for method in METHODS))
            else:
                reasons[trial.label] = dict.fromkeys(METHODS, np.full(len(rows[REFINED]), NOT_SIMULATED))
        blocks.append(Block(of_job[shards[REFINED].task.job], shards[REFINED], rows, reasons, cpu_s))
    return blocks


def summary(label: str, blocks: Sequence[Block], protocols: Sequence[str]) -> Row:
    """Return the row of a group of grasps: entries are lists with a value for each of `METHODS`, SI units.

    The measures are those of `MEASURES`, `held_<protocol>` a share, and `reasons_<protocol>` the number of grasps that
    did not hold by reason.
    """
    row: dict[str, object] = {"label": label, "grasps": sum(map(len, blocks))}
    for protocol in protocols:
        reasons = [np.concatenate([block.reasons[protocol][method] for block in blocks]) for method in METHODS]
        row[f"held_{protocol}"] = [float((each == Reason.HELD.label).mean()) for each in reasons]
        row[f"reasons_{protocol}"] = [
            dict(Counter(each[each != Reason.HELD.label].tolist()).most_common()) for each in reasons
        ]
    for measure, (before, after, statistic) in MEASURES.items():
        row[measure] = [_of(blocks, method, before, after, statistic) for method in METHODS]
    return row


def agreement(label: str, blocks: Sequence[Block], labels: tuple[str, str]) -> Row:
    """Return the row of the agreement of MuJoCo and Drake on grasps tried in both: a value for each of `METHODS`.

    Args:
        label: Name of the row.
        blocks: The grasps.
        labels: Labels of the trials in MuJoCo and in Drake.
    """
    found = []
    for method in METHODS:
        mujoco, drake = (np.concatenate([block.reasons[name][method] for block in blocks]) for name in labels)
        both = (mujoco != NOT_SIMULATED) & (drake != NOT_SIMULATED)
        found.append(EngineAgreement.of(*(reasons[both] == Reason.HELD.label for reasons in (mujoco, drake))))
    return {
        "label": label,
        "grasps": found[0].count,
        **{name: [_known(getattr(each, name)) for each in found] for name in ("share", "kappa")},
        **{name: [getattr(each, name) for each in found] for name in ("mujoco_only", "drake_only")},
    }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def summaries(
    key: Callable[[EvidenceCase], str], blocks: Sequence[Block], protocols: Sequence[str], *, first: Sequence[str] = ()
) -> list[Row]:
    """Return the row of each group of grasps, by the key of their cases; the labels `first` lead, in that order."""
    groups: dict[str, list[Block]] = {}
    for block in blocks:
        groups.setdefault(key(block.case), []).append(block)
    order = sorted(groups, key=lambda label: (first.index(label) if label in first else len(first), label))
    return [summary(label, groups[label], protocols) for label in order]


def _of(
    blocks: Sequence[Block], method: str, before: str | None, after: str, statistic: Callable[..., float]
) -> float | None:
    """Statistic of the known values of a column by one method; None without any."""
    if method == GIVEN:
        parts = [] if before is None else [block.rows[REFINED][before] for block in blocks]
    else:
        parts = [block.rows[method][after] for block in blocks]
    return of_finite(statistic, np.concatenate([np.zeros(0), *parts]))


def refinement_cpu_s(blocks: Sequence[Block]) -> float:
    """CPU time of all refinements, seconds."""
    return float(sum(np.nansum(block.rows[method]["cpu_s"]) for block in blocks for method in (GEOMETRY, REFINED)))
