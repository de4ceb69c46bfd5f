"""A run of the benchmark: applies each method to the same grasps and simulates them."""

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
    """Settings of a run."""

    methods: tuple[Method, ...]
    """Methods to compare; the first one is the reference of the others."""
    settings: tuple[SettingName, ...] = ("force-closure", "strict")
    """Names of the simulation settings."""
    width: int = 256
    """Largest number of grasps that are refined at once."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int | None = None
    """CPU threads of the simulation; None: all cores. Refinement has one."""


@dataclass(frozen=True)
class Outcome:
    """Results of a study."""

    rows: list[dict[str, Any]]
    """Entries of the tables."""
    problems: list[str]
    """Errors of objects without a result."""


def run_study(
    study: Study, model: HandModel, groups: Sequence[Group], progress: Callable[[float, str], None]
) -> Outcome:
    """Apply all methods to all grasps, and simulate the results.

    Args:
        study: The settings.
        model: The hand for simulation.
        groups: The grasps.
        progress: Called with the share of the work that is done, and its label.
    """
    todo = [
        GroupJob(group, model, study.methods, study.settings, study.width, study.seed, study.threads)
        for group in groups
    ]
    done, problems = run_jobs(todo, 1, progress)
    return Outcome(rows([part for parts in done for part in parts], study.settings), problems)
