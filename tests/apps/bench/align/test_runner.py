"""The runner: each variant sees each pair once, and processes change nothing but the time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from alignment_errors import errors_at
from grasp_refine_apps.bench.align import runner as module
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.runner import Alignment, JobResult, alignments
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import cluster_body, convex_body, ring_body

PAIRS = [
    BodyPair("concave 0", "concave", ring_body(), cluster_body(3, 4)),
    BodyPair("convex 0", "convex", convex_body(1, 16), convex_body(2, 16)),
    BodyPair("convex 1", "convex", convex_body(3, 16), convex_body(4, 16)),
    BodyPair("concave 1", "concave", cluster_body(5, 2), cluster_body(6, 2)),
    BodyPair("concave 2", "concave", cluster_body(7, 3), cluster_body(8, 2)),
]
VARIANTS = (Variant(budget=4), Variant("finite-difference", budget=3))


pytestmark = pytest.mark.usefixtures("threads")


@pytest.fixture(scope="module")
def tasks() -> list[Tasks]:
    return [draw_tasks(pair, CLASSES[:3], 9, 0) for pair in PAIRS]


def made(
    tasks: list[Tasks], pairs: list[BodyPair] = PAIRS, variants: tuple[Variant, ...] = VARIANTS
) -> list[Alignment]:
    return alignments(variants, pairs, tasks, seed=0, dtype="float64", device="cpu", threads=1)


def alone(job: Alignment) -> JobResult:
    """The result of a job that nobody watches."""
    return job.run(lambda share: None)


def test_each_variant_sees_each_pair_once(tasks: list[Tasks], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(module.PAIRS_PER_JOB, "concave", 2)
    todo = made(tasks)
    seen = Counter((job.variant, pair.name) for job in todo for pair in job.pairs)
    assert seen == {(variant, pair.name): 1 for variant in VARIANTS for pair in PAIRS}
    for job in todo:
        assert len({pair.kind for pair in job.pairs}) == 1
        assert len(job.pairs) == len(job.tasks) <= module.PAIRS_PER_JOB[job.pairs[0].kind]
        for pair, chosen in zip(job.pairs, job.tasks, strict=True):
            full = tasks[PAIRS.index(pair)]
            expected = full if job.variant.method == "distance" else full.every(8)
            np.testing.assert_array_equal(chosen.T_world_b, expected.T_world_b)
        assert (job.seed, job.dtype, job.device, job.threads) == (0, "float64", "cpu", 1)
    # Pairs of few pieces are not padded to those of many.
    together = [{pair.name for pair in job.pairs} for job in todo if job.pairs[0].kind == "concave"]
    assert together == [{"concave 1", "concave 2"}, {"concave 0"}] * 2


@pytest.mark.parametrize("method", ["distance", "analytical", "rigid", "finite-difference", "zeroth-order"])
def test_reported_queries_were_made(method: str, tasks: list[Tasks]):
    variant = Variant(method, budget=7)
    (job,) = made(tasks[1:2], PAIRS[1:2], (variant,))
    done = alone(job)
    # One narrow-phase query answers a query of two hulls.
    assert done.aligned.watch.queries == variant.queries(np.full(done.aligned.error.shape, 7)).sum()


@pytest.mark.parametrize("witness", ["plain", "patch"])
@pytest.mark.parametrize("make", [Variant, Variant.least_squares])
def test_final_poses_are_judged_by_queries_of_their_own(make: Callable[..., Variant], witness: str, tasks: list[Tasks]):
    variant = make(budget=30, witness=witness, epsilon=1e-4)
    (job,) = made([tasks[1], tasks[2].take(np.arange(4))], PAIRS[1:3], (variant,))
    done = alone(job)
    for p, its in enumerate(job.tasks):
        T_a, T_b = done.aligned.T_world_a[: len(its), p], done.aligned.T_world_b[: len(its), p]
        for errors, patch in ((done.errors(p), None), (done.patch_errors(p), Patch(1e-4))):
            expected = errors_at(job.pairs[p], its, T_a, T_b, variant.margin, patch)
            np.testing.assert_allclose(errors, expected, rtol=1e-6, atol=1e-18)
