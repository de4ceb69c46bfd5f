"""A run of the benchmark: draws pairs and tasks, runs variants on them, and returns rows and typical failures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.align.bodies import KINDS, BodyPair, Kind, draw_pairs, mesh_sources
from grasp_refine_apps.bench.align.failures import Failure, WitnessPoints, blind_spot
from grasp_refine_apps.bench.align.record import record_task, shown_task
from grasp_refine_apps.bench.align.rows import ERROR_LEVELS_M2, rows
from grasp_refine_apps.bench.align.runner import JobResult, jobs
from grasp_refine_apps.bench.align.saved import AlignmentTask
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.jobs import Job, run_jobs

MAX_SEARCHED = 40
"""Approximate number of missed tasks of a method that are searched for a typical one."""


@dataclass(frozen=True)
class Study:
    """Settings of a run."""

    variants: tuple[Variant, ...]
    """Variants to compare."""
    meshes: Path | None = None
    """Folder of meshes; None: the embedded objects."""
    kinds: tuple[Kind, ...] = ("convex", "concave")
    """Convex hulls of the meshes, or their CoACD pieces."""
    classes: tuple[str, ...] = CLASSES[:3]
    """Features that targets lie on, on body a and on body b."""
    pairs: int = 8
    """Pairs of bodies of each kind."""
    targets: int = 64
    """Accepted targets of each pair."""
    seed: int = 0
    """Seed of pairs, tasks and samples."""
    dtype: str = "float64"
    """Number type of poses and losses."""
    device: str = "cpu"
    """Torch device of poses and losses."""
    threads: int = 1
    """Threads of torch in each process."""
    workers: int = 1
    """Processes."""
    record: bool = False
    """Whether each method runs one task of the first pair again, for the viewer."""


@dataclass(frozen=True)
class Outcome:
    """Results of a study."""

    rows: list[dict[str, Any]]
    """Entries of the tables."""
    failures: list[Failure]
    """Typical failures of each method."""
    problems: list[str]
    """Errors of jobs without a result."""
    recorded: AlignmentTask | None = None
    """One task with the trajectory of each method."""


def run_study(study: Study, say: Callable[[str], None], progress: Callable[[float, str], None]) -> Outcome:
    """Draw pairs and tasks, and run all variants on them.

    Args:
        study: The settings.
        say: Called with lines on loading.
        progress: Called with the share of the work that is done, and its label.

    Raises:
        GraspRefineError: the meshes cannot be used, or no task is accepted.
    """
    sources = mesh_sources(study.meshes)
    pairs = [pair for kind in study.kinds for pair in draw_pairs(sources, kind, study.pairs, study.seed, say=say)]
    tasks = [
        draw_tasks(pair, study.classes, study.targets, (study.seed, KINDS.index(pair.kind), index % study.pairs))
        for index, pair in enumerate(pairs)
    ]
    pairs, tasks = _with_tasks(pairs, tasks, say)
    if not pairs:
        raise GraspRefineError("no pair has an accepted task: something else is always in the way")
    recorded = None
    if study.record:
        machine = {"dtype": study.dtype, "device": study.device}
        task = shown_task(tasks[0])
        recorded = record_task(pairs[0], task, study.variants, seed=study.seed, **machine, progress=progress)
    todo = jobs(
        study.variants,
        pairs,
        tasks,
        seed=study.seed,
        dtype=study.dtype,
        device=study.device,
        threads=study.threads,
    )
    done, problems = run_jobs([Job(one.label, one.do, one.work) for one in todo], study.workers, progress)
    return Outcome(rows(done, study.targets, study.dtype), typical_failures(done), problems, recorded)


def typical_failures(done: Sequence[JobResult]) -> list[Failure]:
    """Return for each method and kind one reachable task that was missed, in its blind spot if possible.

    Candidates are the first variant of each method of descent, and of Levenberg-Marquardt, at the largest budget, but
    no face-face targets, whose witness points are not unique. Of the candidate tasks, the one with the median error is
    shown.
    """
    found: dict[tuple[str, str], list[JobResult]] = {}
    for one in sorted(done, key=lambda one: -(one.job.variant.budget or one.job.variant.budget_s or 0.0)):
        same = found.setdefault((one.job.variant.name, one.job.pairs[0].kind), [])
        if not same or same[0].job.variant == one.job.variant:
            same.append(one)
    typical = []
    for group in found.values():
        missed = [
            (float(one.errors(p)[0][i]), _failure(one, p, i))
            for one in group
            for p, tasks in enumerate(one.job.tasks)
            for i in _missed(tasks, one.errors(p)[0])
        ]
        if missed:
            missed.sort(key=lambda entry: entry[0])
            some = [failure for _, failure in missed[:: max(1, len(missed) // MAX_SEARCHED)]]
            blind = [failure for failure in some if blind_spot(failure)]
            chosen = blind or some
            typical.append(chosen[len(chosen) // 2])
    return typical


def _missed(tasks: Tasks, error: np.ndarray) -> list[int]:
    """Reachable tasks, except face-face ones, that were missed by more than a millimetre."""
    alone = tasks.target_class != CLASSES.index("face-face")
    missed = alone & tasks.reachable & (error >= ERROR_LEVELS_M2["acc_1e6"]) & np.isfinite(error)
    return np.flatnonzero(missed).tolist()


def _failure(done: JobResult, p: int, i: int) -> Failure:
    pair, tasks, witness = done.job.pairs[p], done.job.tasks[p], done.aligned.witness
    return Failure(
        method=done.job.variant.name,
        kind=pair.kind,
        target_class=CLASSES[tasks.target_class[i]],
        body_a=pair.a,
        body_b=pair.b,
        T_world_a=done.aligned.T_world_a[i, p],
        T_world_b=done.aligned.T_world_b[i, p],
        target_a=tasks.target_a[i],
        target_b=tasks.target_b[i],
        margin=done.job.variant.margin,
        witness=WitnessPoints(
            witness.point_a[i, p],
            witness.point_b[i, p],
            witness.normal[i, p],
            float(witness.distance[i, p]),
            _winner(done, p, int(witness.winner[i, p])),
        ),
    )


def _winner(done: JobResult, p: int, winner: int) -> int:
    """Winning pieces of pair p, counted from its own first piece pair."""
    before = sum(len(pair.a.pieces) * len(pair.b.pieces) for pair in done.job.pairs[:p])
    return winner - before


def _with_tasks(
    pairs: list[BodyPair], tasks: list[Tasks], say: Callable[[str], None]
) -> tuple[list[BodyPair], list[Tasks]]:
    """Keep the pairs with at least one accepted task."""
    some = [bool(t.accepted.any()) for t in tasks]
    for pair, any_accepted in zip(pairs, some, strict=True):
        if not any_accepted:
            say(f"skipped: {pair.name}, none of its tasks is accepted")
    return (
        [pair for pair, kept in zip(pairs, some, strict=True) if kept],
        [t for t, kept in zip(tasks, some, strict=True) if kept],
    )
