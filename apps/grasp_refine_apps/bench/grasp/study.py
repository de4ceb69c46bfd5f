"""A run of the benchmark: tasks are made of the sets, variants are run on them, rows come out."""

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
"""Tasks with targets of each object and scale, where nobody says how many."""


@dataclass(frozen=True)
class Study:
    """What is run."""

    variants: tuple[Variant, ...]
    """What is compared."""
    kinds: tuple[Kind, ...] = ("targets", "nothing")
    """Whether targets are given."""
    count: int | None = None
    """Tasks of each object and scale; None: all real grasps, and `COUNT` with targets."""
    scenes: int | None = None
    """Objects and scales of each set, evenly chosen; None: all."""
    singles: int = 32
    """Most tasks of a set that are run one at a time."""
    disturbance: Disturbance = field(default_factory=Disturbance)
    """How far true grasps are moved."""
    tolerance: float = Config.tolerance
    """Loss in m^2 below which a grasp is done."""
    seed: int = 0
    """Of disturbances and of what solvers draw."""
    threads: int = 1
    """Threads of torch in each process."""
    workers: int = 1
    """Processes."""


@dataclass(frozen=True)
class Outcome:
    """What came out of a study."""

    rows: list[dict[str, Any]]
    """The entries of the tables."""
    problems: list[str]
    """What went wrong with jobs that gave no result."""


def run_study(
    study: Study, sets: Sequence[GraspSet], say: Callable[[str], None], progress: Callable[[float, str], None]
) -> Outcome:
    """Make tasks of the sets, and run all variants on them.

    Args:
        study: What is run.
        sets: Where the grasps come from.
        say: Gets lines on what is left out.
        progress: Gets the share of the work that is done, and what is.

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
    """The set with at most `count` of its groups, evenly chosen."""
    groups = grasp_set.groups
    if count is None or count >= len(groups):
        return grasp_set
    chosen = np.linspace(0, len(groups) - 1, count).round().astype(int)
    return replace(grasp_set, groups=tuple(groups[i] for i in chosen))
