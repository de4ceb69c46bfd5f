"""A run of the benchmark: makes tasks of the sets, runs variants on them, and returns rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.config import Config
from grasp_refine_apps.bench.grasp.rows import rows
from grasp_refine_apps.bench.grasp.runner import jobs
from grasp_refine_apps.bench.grasp.sets import GraspSet
from grasp_refine_apps.bench.grasp.tasks import Disturbance, Kind, Tasks, given_nothing, given_targets
from grasp_refine_apps.bench.grasp.variants import Variant
from grasp_refine_apps.bench.jobs import run_jobs

COUNT = 64
"""Default number of tasks with targets of each object and scale."""


@dataclass(frozen=True)
class Study:
    """Settings of a run."""

    variants: tuple[Variant, ...]
    """Variants to compare."""
    kinds: tuple[Kind, ...] = ("targets", "nothing")
    """Tasks with or without targets."""
    count: int | None = None
    """Tasks of each object and scale; None: all real grasps, and `COUNT` with targets."""
    scenes: int | None = None
    """Number of objects and scales of each set, evenly chosen; None: all."""
    singles: int = 32
    """Largest number of tasks of a set that are run one at a time."""
    disturbance: Disturbance = field(default_factory=Disturbance)
    """Disturbance of true grasps."""
    tolerance: float = Config.tolerance
    """Loss in m^2 below which a grasp is solved."""
    seed: int = 0
    """Seed of disturbances and solvers."""
    threads: int = 1
    """Threads of torch in each process."""
    workers: int = 1
    """Processes."""


@dataclass(frozen=True)
class Outcome:
    """Results of a study."""

    rows: list[dict[str, Any]]
    """Entries of the tables."""
    problems: list[str]
    """Errors of jobs without a result."""


def run_study(
    study: Study, sets: Sequence[GraspSet], say: Callable[[str], None], progress: Callable[[float, str], None]
) -> Outcome:
    """Make tasks of the sets, and run all variants on them.

    Args:
        study: The settings.
        sets: Sets of grasps.
        say: Called with lines on omitted objects.
        progress: Called with the share of the work that is done, and its label.

    Raises:
        GraspRefineError: no set has a task.
    """
    tasks = []
    for grasp_set in sets:
        grasp_set = _some(grasp_set, study.scenes)
        for kind in study.kinds:
            progress(0.0, f"{grasp_set.name}, tasks")
            found = _tasks(study, grasp_set, kind)
            if found:
                tasks.append((grasp_set, kind, found))
            if len(found) < len(grasp_set.groups):
                say(
                    f"{grasp_set.name}: {len(grasp_set.groups) - len(found)} of {len(grasp_set.groups)} objects (at "
                    "their scales) left out with targets, no grasp of theirs can be made to touch with every fingertip"
                )
    if not tasks:
        raise GraspRefineError("no grasp can be made to touch with every fingertip: leave out targets from --tasks")
    todo = jobs(
        study.variants,
        tasks,
        singles=study.singles,
        seed=study.seed,
        tolerance=study.tolerance,
        threads=study.threads,
    )
    done, problems = run_jobs(todo, study.workers, progress)
    return Outcome(rows(done), problems)


def _tasks(study: Study, grasp_set: GraspSet, kind: Kind) -> tuple[Tasks, ...]:
    if kind == "nothing":
        return given_nothing(grasp_set, study.count)
    return given_targets(grasp_set, study.count or COUNT, study.disturbance, study.seed)


def _some(grasp_set: GraspSet, count: int | None) -> GraspSet:
    """Return the set with at most `count` of its groups, evenly chosen."""
    groups = grasp_set.groups
    if count is None or count >= len(groups):
        return grasp_set
    chosen = np.linspace(0, len(groups) - 1, count).round().astype(int)
    return replace(grasp_set, groups=tuple(groups[i] for i in chosen))
