"""`refine-grasp bench stability`: how many witness queries and derivatives are wrong, by body, size and state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from rich.console import Console
from tyro.conf import DisallowNone, arg

from grasp_refine.collision.engine import chosen, engines
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.stability.cases import DType, Kind, Method, Neighborhood, State
from grasp_refine_apps.bench.stability.cases import Engine as EngineName
from grasp_refine_apps.bench.stability.page import page
from grasp_refine_apps.bench.stability.presets import PRESETS, Part
from grasp_refine_apps.bench.stability.rows import Measure
from grasp_refine_apps.bench.stability.study import Outcome, run_study
from grasp_refine_apps.bench.stability.table import bench_tables
from grasp_refine_apps.bench.stability.task import Task
from grasp_refine_apps.commands.benchmark import check_asked, run_benchmark
from grasp_refine_apps.commands.options import Overwrite, check_numbers

PresetName = Literal["full", "quick", "smoke"]

SOMETHING_WRONG = 1
"""Exit code when an answer is wrong, or a task crashed."""


@dataclass(frozen=True)
class BenchStability:
    """Count wrong answers: distances, witness points and derivatives of bodies of all kinds and sizes, in all states.

    Each distance is compared with one worked out in another way, and is wrong beyond 1e-8 of the diagonal + 1e-12 m +
    1e-15 of the distance from the origin. The preset says what is asked; each of the other options replaces its part
    of it. Exit code 1: something is wrong.
    """

    preset: PresetName = "quick"
    """An experiment: full (more than a million queries, half an hour), quick (more than 20000, in half a minute),
    smoke (in seconds)."""
    kinds: Annotated[DisallowNone[tuple[Kind, ...] | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """Which bodies: ball, box, needle, plate (1e-4 thin), hull1000 (of so many vertices), concave40 (of so many
    pieces), boxes with duplicate or near-duplicate vertices, slivers."""
    diagonals: Annotated[
        DisallowNone[tuple[float, ...] | None], arg(metavar="METRES", help_behavior_hint="(default: the preset's)")
    ] = None
    """Diagonals of the larger body in metres."""
    states: Annotated[DisallowNone[tuple[State, ...] | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """How bodies lie to each other: far (1000 diagonals), near, gap-1e-3 to gap-1e-12 (in diagonals), gap-1um,
    gap-1nm, contact, two features against each other, shallow, deep, total (one in the other), concentric."""
    measures: Annotated[DisallowNone[tuple[Measure, ...] | None], arg(help_behavior_hint="(default: both)")] = None
    """forward: distances and points; derivative: how points move."""
    dtypes: Annotated[DisallowNone[tuple[DType, ...] | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """Number types of poses. Of this and the next two options the first values belong together; each other value is
    asked with the first of the others."""
    batches: Annotated[DisallowNone[tuple[int, ...] | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """Poses in one call."""
    engines: Annotated[DisallowNone[tuple[EngineName, ...] | None], arg(help_behavior_hint="(default: all there)")] = (
        None
    )
    """Who answers."""
    translations: Annotated[
        DisallowNone[tuple[float, ...] | None], arg(metavar="METRES", help_behavior_hint="(default: the preset's)")
    ] = None
    """How far from the origin of the world the bodies are when distances are asked for, in metres."""
    methods: Annotated[DisallowNone[tuple[Method, ...] | None], arg(help_behavior_hint="(default: the preset's)")] = (
        None
    )
    """How witness points are differentiated."""
    neighborhoods: Annotated[
        DisallowNone[tuple[Neighborhood, ...] | None], arg(help_behavior_hint="(default: the preset's)")
    ] = None
    """Which candidates stand for the surface; only three of the methods look at any."""
    queries: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """Queries for each body, state, way of asking and translation."""
    differentiated: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: the preset's)")] = None
    """Derivatives for each body, state and method."""
    workers: int = 1
    """Processes."""
    seed: int = 0
    """Seed of bodies and poses."""
    json: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write all rows to this file, in SI units."""
    html: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write a report with heat maps to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Do it; returns the exit code.

        Raises:
            GraspRefineError: a number out of its range, or an engine that is not there.
        """
        tasks = self.tasks()
        found: list[Outcome] = []

        def run(console: Console, progress: Callable[[float, str], None]) -> Outcome:
            found.append(run_study(tasks, self.workers, progress))
            return found[0]

        code = run_benchmark(
            "bench stability",
            replace(self, json=None, html=None, overwrite=False),
            self,
            run,
            lambda outcome: [
                part for table in bench_tables(outcome.rows, self.seed, len(outcome.problems)) for part in (table, "")
            ],
            lambda document, outcome: page(document),
        )
        return code or (SOMETHING_WRONG if found[0].wrong else 0)

    def tasks(self) -> tuple[Task, ...]:
        """What the options ask for.

        Raises:
            GraspRefineError: a number out of its range, or an engine that is not there.
        """
        check_numbers(self)
        check_asked(self, ())
        if self.diagonals is not None and min(self.diagonals) == 0:
            raise GraspRefineError("--diagonals must be above 0 metres, got 0")
        asked: dict[str, Any] = {
            option.name: tuple(dict.fromkeys(value)) if isinstance(value, tuple) else value
            for option in fields(Part)
            if (value := getattr(self, option.name, None)) is not None
        }
        names = tuple(chosen(name) for name in dict.fromkeys(self.engines or engines()))
        measures = asked.pop("measures", get_args(Measure))
        parts = [
            replace(part, measures=both, **asked)
            for part in PRESETS[self.preset]
            if (both := tuple(measure for measure in part.measures if measure in measures))
        ]
        return tuple(dict.fromkeys(task for part in parts for task in part.tasks(names, self.seed)))
