"""A run of the benchmark: measures cases, undoes skips, and returns rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from grasp_refine.collision.engine import Engine
from grasp_refine.objects.object import Object
from grasp_refine_apps.bench.jobs import Job, run_jobs
from grasp_refine_apps.bench.queries.cases import Case
from grasp_refine_apps.bench.queries.peers import PEERS, PeerName
from grasp_refine_apps.bench.queries.rows import rows
from grasp_refine_apps.bench.queries.runner import CaseJob, CaseResult, MethodName
from grasp_refine_apps.bench.queries.skip import Example, Skip
from grasp_refine_apps.bench.queries.skips_querying import query_skips
from grasp_refine_apps.bench.queries.skips_solving import frame_skip, solving_skips
from grasp_refine_apps.bench.queries.skips_starting import decomposition_skip, import_skips, self_collision_skips
from grasp_refine_apps.bench.timing import one_thread


@dataclass(frozen=True)
class Study:
    """Settings of a run."""

    cases: tuple[Case, ...]
    """Cases to measure."""
    engines: tuple[Engine, ...]
    """Our engines; ratios are to the first."""
    methods: tuple[MethodName, ...] = ("contact-kinematics", "distance")
    """Derivative methods of the witness points."""
    peers: tuple[PeerName, ...] = tuple(peer.name for peer in PEERS)
    """Peers to compare with."""
    rounds: int = 7
    """Number of measurements of each time."""
    least_s: float = 0.004
    """Minimum CPU seconds of a measurement of a query."""
    skip_rounds: int = 1
    """Number of measurements of each refinement."""
    commands: tuple[str, ...] = ()
    """Command lines whose imports are counted."""
    seed: int = 0
    """Seed of bodies, poses and solvers."""


@dataclass(frozen=True)
class Outcome:
    """Results of a study."""

    rows: list[dict[str, Any]]
    """Entries of the tables."""
    problems: list[str]
    """Errors of jobs without a result."""


@dataclass(frozen=True)
class SkipJob:
    """Some skips to be undone."""

    label: str
    work: float
    run: Callable[[], Iterable[Skip]]

    def do(self, progress: Callable[[float], None]) -> tuple[Skip, ...]:
        """Measure their savings."""
        with one_thread():
            return tuple(self.run())


def run_study(study: Study, examples: Sequence[Example], progress: Callable[[float, str], None]) -> Outcome:
    """Measure all cases, and undo all skips.

    Args:
        study: The settings.
        examples: Grasps on which skips are shown; empty: no skips but those of imports.
        progress: Called with the share of the work that is done, and its label.
    """
    todo: list[Job] = [
        CaseJob(case, study.engines, study.methods, study.peers, study.rounds, study.least_s, study.seed)
        for case in study.cases
    ]
    todo += skip_jobs(study, examples)
    done, problems = run_jobs(todo, 1, progress)
    found = rows([one for one in done if isinstance(one, CaseResult)])
    found += [skip.row() for one in done if not isinstance(one, CaseResult) for skip in one]
    return Outcome(found, problems)


def skip_jobs(study: Study, examples: Sequence[Example]) -> Iterator[SkipJob]:
    """Make the jobs of the skips: in refinements, then at the start of hands, objects and commands."""
    rounds = study.skip_rounds
    for one in examples:
        yield SkipJob(f"{one.name}, queries", 8.0 * rounds, partial(query_skips, one, rounds))
        yield SkipJob(f"{one.name}, solver", 4.0 * rounds, partial(solving_skips, one, rounds))
    for hand, one in {one.hand: one for one in examples}.items():
        yield SkipJob(hand, 1.0, partial(_of_hand, one, study.seed, rounds))
    for obj in {one.object: one.scene.object for one in examples if one.scene.object.convex}.values():
        yield SkipJob(obj.name, 1.0, partial(_of_object, obj))
    for command in study.commands:
        yield SkipJob(f"imports of {command}", 5.0, partial(import_skips, [command]))


def _of_object(obj: Object) -> Iterator[Skip]:
    yield decomposition_skip(obj)


def _of_hand(example: Example, seed: int, rounds: int) -> Iterator[Skip]:
    yield frame_skip(example, rounds)
    yield from self_collision_skips(example.scene.hand, seed, rounds)
