"""The alignment benchmark: variants on tasks of drawn pairs of bodies, their rows, and the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.align import report
from grasp_refine_apps.bench.align.bodies import KINDS, BodyPair, Kind, draw_pairs, mesh_sources
from grasp_refine_apps.bench.align.rows import rows
from grasp_refine_apps.bench.align.runner import alignments
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Report


@dataclass(frozen=True)
class AlignStudy:
    """Settings of a run."""

    variants: tuple[Variant, ...]
    """Variants to compare, at the largest budget."""
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
    budgets: tuple[int, ...] = (2000,)
    """Budgets in iterations that every variant is run at; empty: each variant has its own."""
    seconds: tuple[float, ...] = ()
    """Budgets in CPU seconds instead."""
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

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Draw pairs and tasks, and return a job for each variant on pairs of one kind.

        Raises:
            GraspRefineError: the meshes cannot be used, or no task is accepted.
        """
        drawn = self._drawn(say)
        if not drawn:
            raise GraspRefineError("no pair has an accepted task: something else is always in the way")
        pairs, tasks = zip(*drawn, strict=True)
        found = alignments(
            self.budgeted_variants(),
            pairs,
            tasks,
            seed=self.seed,
            dtype=self.dtype,
            device=self.device,
            threads=self.threads,
        )
        return [Job(f"{one.variant.name}, {one.pairs[0].kind}", one.run, one.work) for one in found]

    def rows(self, done: Sequence[Any]) -> list[Row]:
        """Return, for each variant and kind, the pooled row, then one per class of targets and one per pair."""
        return rows(done, self.targets, self.dtype)

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return error against time, swept settings, and tables pooled, by class of targets, and by pair."""
        return report.report(rows, f"{self.targets} targets a pair, seed {self.seed}")

    def budgeted_variants(self) -> list[Variant]:
        """Return each distinct variant at each of its budgets."""
        budgets: list[tuple[int | None, float | None]] = [(None, s) for s in self.seconds]
        budgets = budgets or [(n, None) for n in self.budgets]
        if not budgets:
            return list(dict.fromkeys(self.variants))
        return list(dict.fromkeys(variant.at(*budget) for variant in self.variants for budget in budgets))

    def _drawn(self, say: Callable[[str], None]) -> list[tuple[BodyPair, Tasks]]:
        """Draw the pairs of each kind and the tasks of each pair; pairs without an accepted one are only reported."""
        sources, found = mesh_sources(self.meshes), []
        for kind in self.kinds:
            for index, pair in enumerate(draw_pairs(sources, kind, self.pairs, self.seed, say=say)):
                tasks = draw_tasks(pair, self.classes, self.targets, (self.seed, KINDS.index(kind), index))
                if tasks.accepted.any():
                    found.append((pair, tasks))
                else:
                    say(f"skipped: {pair.name}, none of its tasks is accepted")
        return found
