"""Rows of results: one flat entry for each variant, kind, pair and class of targets (DESIGN, section 6)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from grasp_refine_apps.bench.align.runner import JobResult
from grasp_refine_apps.bench.align.stopwatch import PARTS, PASSES
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.timing import cpu_share

ERROR_LEVELS_M2 = {"acc_1e6": 1e-6, "acc_1e8": 1e-8}
"""Errors (m^2) below which a task counts as solved."""


def rows(done: Sequence[JobResult], targets: int, dtype: str) -> list[dict[str, Any]]:
    """Return all rows of a run: for each variant and kind the pooled one, then one per class, then one per pair.

    Args:
        done: Results of all jobs.
        targets: Requested number of accepted targets of a pair; times are scaled to it.
        dtype: Number type of the run.
    """
    groups: dict[tuple[str, Variant], list[JobResult]] = {}
    for one in done:
        groups.setdefault((one.job.pairs[0].kind, one.job.variant), []).append(one)
    return [row for (kind, variant), group in groups.items() for row in _of_group(kind, variant, group, targets, dtype)]


def summary(errors: np.ndarray, weights: np.ndarray | None = None) -> dict[str, Any]:
    """Return shares of solved tasks, and the fifth and ninth decile of their errors (m^2), optionally weighted."""
    if not len(errors):
        return {"targets": 0, **dict.fromkeys(ERROR_LEVELS_M2), "d5": None, "d9": None}
    weights = np.ones(len(errors)) if weights is None else weights
    solved = {name: float(np.average(errors < level, weights=weights)) for name, level in ERROR_LEVELS_M2.items()}
    d5, d9 = np.quantile(errors, (0.5, 0.9), weights=weights, method="inverted_cdf").tolist()
    return {"targets": len(errors), **solved, "d5": d5, "d9": d9}


def _of_group(
    kind: str, variant: Variant, group: Sequence[JobResult], targets: int, dtype: str
) -> Iterator[dict[str, Any]]:
    names = [pair.name for one in group for pair in one.job.pairs]
    tasks = [tasks for one in group for tasks in one.job.tasks]
    found = [(one, p) for one in group for p in range(len(one.job.pairs))]
    errors = [one.errors(p) for one, p in found]
    patch = [by_patch for one, p in found if (by_patch := one.patch_errors(p)) is not None]
    # Face-face targets are listed separately: where two planes touch, the witness is not unique.
    plain = [t.target_class != CLASSES.index("face-face") for t in tasks]
    alone = not any(mask.any() for mask in plain)
    times = _times(variant, group, targets)
    # Levenberg-Marquardt supports double precision only.
    base = {"kind": kind, **variant.columns(), "dtype": dtype if variant.solver == "descent" else "float64"}

    def row(masks: Sequence[np.ndarray], pair: str, target_class: str, pairs: int) -> dict[str, Any]:
        return {
            **base,
            "pair": pair,
            "target_class": target_class,
            "pairs": pairs,
            **_statistics(tasks, errors, masks),
            "patch": None if variant.epsilon is None else _patch(variant.epsilon, tasks, patch, masks),
            **(times if pair == "all" and target_class == "all" else dict.fromkeys(times)),
        }

    everything = [np.ones(len(t), dtype=bool) for t in tasks] if alone else plain
    yield row(everything, "all", "all", len(names))
    for index, name in enumerate(CLASSES):
        masks = [t.target_class == index for t in tasks]
        if any(mask.any() for mask in masks):
            yield row(masks, "all", name, len(names))
    for k, name in enumerate(names):
        masks = [mask if j == k else np.zeros_like(mask) for j, mask in enumerate(everything)]
        yield row(masks, name, "all", 1)


def _statistics(tasks: Sequence[Tasks], found: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> dict[str, Any]:
    """Summaries of accepted tasks, of certainly reachable tasks, and of all drawn tasks."""
    errors = _picked(found, masks)
    accepted, reachable = (_picked([getattr(t, name) for t in tasks], masks) for name in ("accepted", "reachable"))
    return {
        **summary(errors[accepted]),
        "reachable": summary(errors[reachable]),
        "unfiltered": summary(errors, _picked([t.weight for t in tasks], masks)),
    }


def _patch(
    epsilon: float, tasks: Sequence[Tasks], errors: Sequence[np.ndarray], masks: Sequence[np.ndarray]
) -> dict[str, Any]:
    """Summary of accepted tasks at the same poses, by the patch witness."""
    accepted = _picked([t.accepted for t in tasks], masks)
    return {"epsilon": epsilon, **summary(_picked(errors, masks)[accepted])}


def _picked(arrays: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> np.ndarray:
    """Select the masked entries of all pairs."""
    return np.concatenate([array[mask] for array, mask in zip(arrays, masks, strict=True)])


def _times(variant: Variant, group: Sequence[JobResult], targets: int) -> dict[str, Any]:
    """Costs of a variant; the costs of a pair are scaled to its requested number of targets."""
    results = [one.aligned for one in group]
    iterations = np.concatenate([result.iterations[result.iterations > 0] for result in results])
    count, queries = len(iterations), int(iterations.sum())

    cpu_s, wall_s = (sum(getattr(result, name) for result in results) for name in ("cpu_s", "wall_s"))
    return {
        **{f"{name}_us": 1e6 * sum(r.watch.passes_s[name] for r in results) / queries for name in PASSES},
        "queries_mean": float(variant.queries(iterations).mean()),
        "narrow_queries_mean": sum(result.watch.queries for result in results) / count,
        "iterations_mean": queries / count,
        "cpu_s_per_pair": cpu_s / count * targets,
        "wall_s_per_pair": wall_s / count * targets,
        "cpu_share": cpu_share([result.watch for result in results], PARTS),
    }
