"""Rows: the contract of their keys, numbers that can be counted by hand, and who is pooled with whom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from grasp_refine_apps.bench.align.aligned import AlignmentResult
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.rows import ERROR_LEVELS_M2, rows, summary
from grasp_refine_apps.bench.align.runner import Alignment, JobResult
from grasp_refine_apps.bench.align.stopwatch import PARTS, Stopwatch
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import convex_body

SUMMARY = {"targets", "acc_1e6", "acc_1e8", "d5", "d9"}
PAPER = Variant()
A, B = convex_body(1, 12), convex_body(2, 12)


def tasks_of(classes: list[int], accepted: list[bool], reachable: list[bool], weight: list[float]) -> Tasks:
    n, T = len(classes), np.broadcast_to(np.eye(4), (len(classes), 4, 4))
    zero = np.zeros((n, 3))
    return Tasks(np.array(classes), zero, zero, T, T, np.array(accepted), np.array(reachable), np.array(weight))


def plain(count: int, target_class: int = 0) -> Tasks:
    return tasks_of([target_class] * count, [True] * count, [True] * count, [1.0] * count)


def done(
    tasks: list[Tasks],
    error: np.ndarray,
    *,
    variant: Variant = PAPER,
    kind: str = "convex",
    iterations: int = 100,
    forward_s: float = 0.2,
    backward_s: float = 0.3,
    cpu_s: float = 1.0,
    asked: int = 1000,
    patch_error: np.ndarray | None = None,
) -> JobResult:
    """A result with these errors (N, P); the last ones are ten times as large."""
    pairs = tuple(BodyPair(f"pair {p}", kind, A, B) for p in range(len(tasks)))
    shares = (0.1, 0.2, 0.3, 0.4)
    passes = {"forward": forward_s, "backward": backward_s, "sampling": 0.5 * backward_s}
    watch = Stopwatch(queries=asked, passes_s=passes)
    for (stage, *_), share in zip(PARTS.values(), shares, strict=True):
        watch.spent[stage].cpu_s = share * cpu_s
    T = np.broadcast_to(np.eye(4), (*error.shape, 4, 4))
    aligned = AlignmentResult(error, T, T, np.full(error.shape, iterations), watch, cpu_s, 2 * cpu_s)
    return JobResult(Alignment(variant, pairs, tuple(tasks), 0, "float64", "cpu", 1), aligned, patch_error)


def by(found: list[dict[str, Any]], **values: Any) -> dict[str, Any]:
    """The one row with these values."""
    (row,) = [row for row in found if all(row[key] == value for key, value in values.items())]
    return row


# Summaries


@pytest.mark.parametrize("seed", range(5))
def test_a_weighted_summary_is_that_of_the_tasks_it_stands_for(seed: int):
    rng = np.random.default_rng(seed)
    errors = 10.0 ** rng.uniform(-10, -3, size=int(rng.integers(1, 40)))
    weights = rng.integers(1, 9, size=len(errors))
    expanded = np.sort(np.repeat(errors, weights))
    found = summary(errors, weights.astype(float))
    assert set(found) == SUMMARY and found["targets"] == len(errors)
    for name, level in ERROR_LEVELS_M2.items():
        assert found[name] == pytest.approx((expanded < level).mean())
    for name, tenths in (("d5", 5), ("d9", 9)):
        assert found[name] == expanded[-(-len(expanded) * tenths // 10) - 1]
    # Without weights each task stands for itself.
    assert summary(errors) == summary(errors, np.full(len(errors), 1.0))
    assert summary(errors, 2.5 * weights)["d9"] == found["d9"]


# Rows


def test_the_patch_judges_the_same_tasks_beside_the_plain_witness():
    face = CLASSES.index("face-face")
    tasks = tasks_of([0, 0, face, face], [True, False, True, True], [True] * 4, [1.0] * 4)
    patch_error = np.array([[1e-9], [1e-9], [1e-9], [1e-7]])
    variant = Variant(witness="patch", epsilon=2e-5)
    found = rows([done([tasks], np.ones((4, 1)), variant=variant, patch_error=patch_error)], 4, "float64")
    pooled, apart = by(found, pair="all", target_class="all"), by(found, target_class="face-face")
    assert (pooled["witness"], pooled["epsilon"], pooled["acc_1e6"], apart["acc_1e6"]) == ("patch", 2e-5, 0.0, 0.0)
    assert pooled["patch"] == {"epsilon": 2e-5, "targets": 1, "acc_1e6": 1.0, "acc_1e8": 1.0, "d5": 1e-9, "d9": 1e-9}
    assert apart["patch"] == {"epsilon": 2e-5, "targets": 2, "acc_1e6": 1.0, "acc_1e8": 0.5, "d5": 1e-9, "d9": 1e-7}
    # A plain variant may be judged by it as well.
    judged = Variant(epsilon=2e-5)
    row = rows([done([tasks], np.ones((4, 1)), variant=judged, patch_error=patch_error)], 4, "float64")[0]
    assert row["witness"] == "plain" and row["patch"] == pooled["patch"]


def test_accepted_reachable_and_unfiltered_tasks_by_hand():
    tasks = tasks_of(
        [0, 0, 0, 0, 0], [True, True, True, False, False], [True, False, True, False, False], [1, 1, 1, 4, 4]
    )
    row = rows([done([tasks], np.array([[1e-9], [1e-7], [1.0], [1e-7], [2.0]]))], 3, "float64")[0]
    assert row["targets"] == 3 and row["reachable"]["targets"] == 2 and row["unfiltered"]["targets"] == 5
    assert row["acc_1e6"] == pytest.approx(2 / 3) and row["acc_1e8"] == pytest.approx(1 / 3)
    assert row["reachable"]["acc_1e6"] == 0.5 and row["reachable"]["d5"] == 1e-9 and row["reachable"]["d9"] == 1.0
    assert row["unfiltered"]["acc_1e6"] == pytest.approx(6 / 11) and row["unfiltered"]["d9"] == 2.0
    assert row["d5"] == 1e-7


def test_face_face_targets_are_counted_apart():
    face = CLASSES.index("face-face")
    tasks = tasks_of([0, 1, face, face], [True] * 4, [True] * 4, [1.0] * 4)
    found = rows([done([tasks], np.array([[1e-9], [1e-9], [1.0], [1.0]]))], 4, "float64")
    pooled = by(found, pair="all", target_class="all")
    assert (pooled["targets"], pooled["acc_1e8"]) == (2, 1.0)
    assert by(found, pair="pair 0")["targets"] == 2
    apart = by(found, target_class="face-face")
    assert (apart["targets"], apart["acc_1e8"]) == (2, 0.0)
    # Where there are no others, they are what is pooled.
    alone = rows([done([plain(3, face)], np.ones((3, 1)))], 3, "float64")
    assert by(alone, pair="all", target_class="all")["targets"] == 3


def test_times_are_as_in_all_jobs_together():
    group = [
        done([plain(2), plain(2)], np.ones((2, 2)), iterations=100, cpu_s=1.0, asked=800),
        done([plain(4)], np.ones((4, 1)), iterations=200, cpu_s=2.0, forward_s=0.4, backward_s=0.9, asked=1600),
    ]
    row = rows(group, 16, "float64")[0]
    assert row["iterations_mean"] == row["queries_mean"] == 150.0
    assert row["narrow_queries_mean"] == 300.0
    assert row["forward_us"] == pytest.approx(0.6e6 / 1200) and row["backward_us"] == pytest.approx(1.2e6 / 1200)
    # Three seconds for 8 tasks; a pair was to have 16.
    assert (row["cpu_s_per_pair"], row["wall_s_per_pair"]) == (pytest.approx(6.0), pytest.approx(12.0))
    assert row["cpu_share"] == pytest.approx(dict(zip(PARTS, (0.1, 0.2, 0.3, 0.4), strict=True)))
    assert sum(row["cpu_share"].values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("method", "factor"), [("finite-difference", 13), ("zeroth-order", 17), ("distance", 1), ("analytical", 1)]
)
def test_queries_include_the_method_s(method: str, factor: int):
    found = rows([done([plain(2)], np.ones((2, 1)), variant=Variant(method), iterations=70)], 2, "float64")[0]
    assert found["queries_mean"] == factor * found["iterations_mean"] == factor * 70
