"""Runs variants on tasks, in processes that each take some pairs through one variant at a time."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from traceback import format_exception

import numpy as np
import torch

from .aligned import Aligned, errors_at, padded
from .bodies import KINDS, BodyPair
from .descent import AlignDescent, align
from .levenberg_marquardt import minimised
from .tasks import Tasks
from .variants import Variant

WIDTH = {"descent": {"convex": 32, "concave": 2}, "levenberg-marquardt": {"convex": 32, "concave": 4}}
"""Solver -> kind -> pairs that go through it together: many where the cost is that of small operations."""

SOLVED_EARLY = 0.1
"""About the share of its budget that Levenberg-Marquardt uses, and of the time of an iteration of descent."""


@dataclass(frozen=True, eq=False)
class Job:
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
        """About how long it takes, in arbitrary units."""
        pieces = sum(
            len(pair.a.pieces) * len(pair.b.pieces) * len(t) for pair, t in zip(self.pairs, self.tasks, strict=True)
        )
        items = sum(map(len, self.tasks))
        length = self.variant.budget if self.variant.budget is not None else 1000.0 * self.variant.budget_s
        early = SOLVED_EARLY if self.variant.solver == "levenberg-marquardt" else 1.0
        return early * length * (30.0 * items + pieces) * (13.0 if self.variant.every > 1 else 1.0)


@dataclass(frozen=True, eq=False)
class Done:
    """What came out of a job; task i of pair p is real where `i < len(job.tasks[p])`."""

    job: Job
    aligned: Aligned
    patch_error: np.ndarray | None = None
    """Errors (N, P) at the best poses by the patch witness, in square metres; None: not judged so."""

    def errors(self, pair: int) -> tuple[np.ndarray, np.ndarray]:
        """Best and last errors of the tasks of a pair."""
        count = len(self.job.tasks[pair])
        return self.aligned.error[:count, pair], self.aligned.last_error[:count, pair]

    def patch_errors(self, pair: int) -> np.ndarray | None:
        """Errors of the tasks of a pair by the patch witness."""
        return None if self.patch_error is None else self.patch_error[: len(self.job.tasks[pair]), pair]


def jobs(
    variants: Sequence[Variant],
    pairs: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    *,
    seed: int,
    dtype: str,
    device: str,
    threads: int,
) -> list[Job]:
    """One job for each variant and each group of pairs of one kind."""
    made = []
    for kind in KINDS:
        # Pairs with about as many pieces go together: they are padded to the largest number.
        index = [i for i, pair in enumerate(pairs) if pair.kind == kind]
        index.sort(key=lambda i: len(pairs[i].a.pieces) * len(pairs[i].b.pieces))
        for variant in variants:
            width = WIDTH[variant.solver][kind]
            for start in range(0, len(index), width):
                group = index[start : start + width]
                chosen = tuple(tasks[i] if variant.every == 1 else tasks[i].every(variant.every) for i in group)
                made.append(Job(variant, tuple(pairs[i] for i in group), chosen, seed, dtype, device, threads))
    return made


def run(todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]) -> tuple[list[Done], list[str]]:
    """The results of the jobs, in their order, and what went wrong with those that gave none.

    A job that fails does not end the others; an interruption ends those that are left, and what is done is kept.

    Args:
        todo: Jobs.
        workers: Processes; with 1, everything is done in this one.
        progress: Gets the share of the work that is done, and what is.
    """
    results: dict[int, Done] = {}
    problems: list[str] = []
    try:
        for index, outcome in _in_turn(todo, progress) if workers == 1 else _side_by_side(todo, workers, progress):
            if isinstance(outcome, Done):
                results[index] = outcome
            else:
                problems.append(f"{label(todo[index])}: {''.join(format_exception(outcome)).strip()}")
    except KeyboardInterrupt:
        problems.append(f"interrupted: {len(results)} of {len(todo)} jobs were done")
    return [results[index] for index in sorted(results)], problems


def _in_turn(todo: Sequence[Job], progress: Callable[[float, str], None]) -> Iterator[tuple[int, Done | Exception]]:
    """Each job with what came of it, in this process."""
    total, finished = sum(job.work for job in todo), 0.0
    for index, job in enumerate(todo):

        def within(share: float, before: float = finished, job: Job = job) -> None:
            progress((before + share * job.work) / total, label(job))

        try:
            yield index, do(job, within)
        except Exception as error:
            yield index, error
        finished += job.work


def _side_by_side(
    todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]
) -> Iterator[tuple[int, Done | Exception]]:
    """Each job with what came of it, in several processes, as they end."""
    total, finished = sum(job.work for job in todo), 0.0
    # A forked child of a process that has used torch may hang.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(todo)), mp_context=context) as pool:
        try:
            # The longest first, so that no process is left alone with one at the end.
            order = sorted(range(len(todo)), key=lambda index: -todo[index].work)
            futures = {pool.submit(do, todo[index]): index for index in order}
            for future in as_completed(futures):
                index = futures[future]
                error = future.exception()
                yield index, future.result() if error is None else error
                finished += todo[index].work
                progress(finished / total, label(todo[index]))
        except BaseException:
            for process in pool._processes.values():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def do(job: Job, progress: Callable[[float], None] = lambda share: None) -> Done:
    """Run a job in this process."""
    torch.set_num_threads(job.threads)
    variant, tasks = job.variant, padded(job.tasks)
    solver = variant.built(job.seed)
    if isinstance(solver, AlignDescent):
        dtype = getattr(torch, job.dtype)
        aligned = align(job.pairs, tasks, solver, dtype=dtype, device=job.device, progress=progress)
    else:
        aligned = minimised(job.pairs, job.tasks, solver, progress=progress)
    if variant.patch is None:
        return Done(job, aligned)
    poses = aligned.T_world_a, aligned.T_world_b
    return Done(job, aligned, errors_at(job.pairs, tasks, *poses, variant.margin, variant.patch)[0])


def label(job: Job) -> str:
    """What a job is, for a progress bar."""
    return f"{job.variant.name}, {job.pairs[0].kind}"
