"""A run of the benchmark: each method is applied to the same grasps, which are then simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from grasp_refine.validation.hand_model import HandModel
from grasp_refine.validation.protocol import SettingName
from grasp_refine_apps.bench.hold.methods import Method
from grasp_refine_apps.bench.hold.rows import rows
from grasp_refine_apps.bench.hold.runner import Group, GroupJob
from grasp_refine_apps.bench.jobs import run_jobs


@dataclass(frozen=True)
class Study:
    """What is run."""

    methods: tuple[Method, ...]
    """What is compared; the first one is what the others are told from."""
    settings: tuple[SettingName, ...] = ("force-closure", "strict")
    """How grasps are simulated."""
    width: int = 256
    """Most grasps that are refined at once."""
    seed: int = 0
    """Of everything that is drawn."""
    threads: int | None = None
    """CPU threads of the simulation; None: as many as there are. Refinement has one."""


@dataclass(frozen=True)
class Outcome:
    """What came out of a study."""

    rows: list[dict[str, Any]]
    """The entries of the tables."""
    problems: list[str]
    """What went wrong with objects that gave no result."""


def run_study(
    study: Study, model: HandModel, groups: Sequence[Group], progress: Callable[[float, str], None]
) -> Outcome:
    """Apply all methods to all grasps, and simulate what comes out.

    Args:
        study: What is run.
        model: The hand for simulation.
        groups: The grasps.
        progress: Gets the share of the work that is done, and what is.
    """
    todo = [
        GroupJob(group, model, study.methods, study.settings, study.width, study.seed, study.threads)
        for group in groups
    ]
    done, problems = run_jobs(todo, 1, progress)
    return Outcome(rows([part for parts in done for part in parts], study.settings), problems)
