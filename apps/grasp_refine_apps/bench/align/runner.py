"""Alignments of the benchmark: each takes some pairs through one variant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at, pad_tasks
from grasp_refine_apps.bench.align.bodies import KINDS, BodyPair
from grasp_refine_apps.bench.align.closed_form import run_closed_form
from grasp_refine_apps.bench.align.descent import align
from grasp_refine_apps.bench.align.levenberg_marquardt import run_levenberg_marquardt
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.timing import one_thread

PAIRS_PER_JOB = {"convex": 32, "concave": 4}
"""Kind -> pairs run together: many where small operations dominate the cost."""

EARLY_COST_SHARE = 0.1
"""Approximate share of its budget that Levenberg-Marquardt uses, and of the time of an iteration of descent."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """One variant on some pairs of one kind."""

    variant: Variant
    pairs: tuple[BodyPair, ...]
    tasks: tuple[Tasks, ...]
    seed: int
    dtype: str
    device: str
    threads: int

    @property
    def work(self) -> float:
        """Approximate duration, in arbitrary units."""
        pieces = sum(
            len(pair.a.pieces) * len(pair.b.pieces) * len(t) for pair, t in zip(self.pairs, self.tasks, strict=True)
        )
        items = sum(map(len, self.tasks))
        length = self.variant.budget if self.variant.budget is not None else 1000.0 * (self.variant.budget_s or 0.0)
        early = 1.0 if self.variant.solver == "descent" else EARLY_COST_SHARE
        return early * length * (30.0 * items + pieces) * (13.0 if self.variant.every > 1 else 1.0)

    def run(self, progress: Callable[[float], None]) -> JobResult:
        """Run the variant on the tasks, in this process."""
        torch.set_num_threads(self.threads)
        variant = self.variant
        with one_thread():
            aligned = self._solved(progress)
        if variant.patch is None:
            return JobResult(self, aligned)
        poses = aligned.T_world_a, aligned.T_world_b
        return JobResult(
            self, aligned, errors_at(self.pairs, pad_tasks(self.tasks), *poses, variant.margin, variant.patch)
        )

    def _solved(self, progress: Callable[[float], None]) -> AlignmentResult:
        """Run the solver on the tasks."""
        if self.variant.solver == "closed-form":
            return run_closed_form(self.pairs, self.tasks, self.variant)
        if self.variant.solver != "descent":
            return run_levenberg_marquardt(self.pairs, self.tasks, self.variant, seed=self.seed, progress=progress)
        to = {"dtype": getattr(torch, self.dtype), "device": self.device}
        return align(self.pairs, pad_tasks(self.tasks), self.variant, seed=self.seed, **to, progress=progress)


@dataclass(frozen=True, eq=False)
class JobResult:
    """Results of an alignment; task i of pair p is real where `i < len(job.tasks[p])`."""

    job: Alignment
    aligned: AlignmentResult
    patch_error: np.ndarray | None = None
    """Errors (N, P) at the best poses by the patch witness, in square metres; None: not measured."""

    def errors(self, pair: int) -> np.ndarray:
        """Errors of the tasks of a pair."""
        return self.aligned.error[: len(self.job.tasks[pair]), pair]

    def patch_errors(self, pair: int) -> np.ndarray | None:
        """Errors of the tasks of a pair by the patch witness."""
        return None if self.patch_error is None else self.patch_error[: len(self.job.tasks[pair]), pair]


def alignments(
    variants: Sequence[Variant],
    pairs: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    *,
    seed: int,
    dtype: str,
    device: str,
    threads: int,
) -> list[Alignment]:
    """Group pairs of one kind, and make one alignment of each group for each variant."""
    made = []
    for kind in KINDS:
        # Pairs with similar numbers of pieces run together: they are padded to the largest number.
        index = [i for i, pair in enumerate(pairs) if pair.kind == kind]
        index.sort(key=lambda i: len(pairs[i].a.pieces) * len(pairs[i].b.pieces))
        for variant in variants:
            width = PAIRS_PER_JOB[kind]
            for start in range(0, len(index), width):
                group = index[start : start + width]
                chosen = tuple(tasks[i] if variant.every == 1 else tasks[i].every(variant.every) for i in group)
                made.append(Alignment(variant, tuple(pairs[i] for i in group), chosen, seed, dtype, device, threads))
    return made
