"""Recorded runs: what is kept is what the benchmark itself finds, and nothing of it changes a run."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import transform_points
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.record import MAX_ITERATES, largest_budgets, record_task, shown_task, thin
from grasp_refine_apps.bench.align.runner import Job
from grasp_refine_apps.bench.align.saved import AlignmentTask
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import cluster_body, convex_body, ring_body

PAIR = BodyPair("hulls", "convex", normalised(convex_body(1, 24), 0.06), normalised(convex_body(2, 24), 0.09))
CONCAVE = BodyPair("ring and cluster", "concave", normalised(ring_body(), 0.12), normalised(cluster_body(3, 4), 0.1))
VARIANTS = (
    Variant(budget=40),
    Variant("rigid", budget=10, optimise="T1T2", margin=0.0),
    Variant.least_squares(budget=60),
    Variant.least_squares(budget=60, witness="patch", epsilon=1e-4),
)


def one_task(pair: BodyPair) -> Tasks:
    return shown_task(draw_tasks(pair, CLASSES[:3], 6, 0))


@pytest.fixture(scope="module", params=[PAIR, CONCAVE], ids=["convex", "concave"])
def recorded(request: pytest.FixtureRequest) -> tuple[BodyPair, Tasks, AlignmentTask]:
    pair = request.param
    return pair, one_task(pair), record_task(pair, one_task(pair), VARIANTS, seed=0)


def test_it_ends_where_the_benchmark_ends(recorded: tuple[BodyPair, Tasks, AlignmentTask]):
    pair, task, found = recorded
    for variant, run in zip(VARIANTS, found.trajectories, strict=True):
        done = Job(variant, (pair,), (task,), 0, "float64", "cpu", threads=1).do(lambda share: None)
        assert run.error[run.result] == pytest.approx(done.errors(0)[0][0], rel=1e-6, abs=1e-24)
        np.testing.assert_allclose(run.poses[run.result, 0], done.aligned.T_world_a[0, 0], atol=1e-12)
        np.testing.assert_allclose(run.poses[run.result, 1], done.aligned.T_world_b[0, 0], atol=1e-12)
        if variant.solver == "descent":
            assert run.error[-1] == pytest.approx(done.errors(0)[1][0], rel=1e-6)
            assert len(run) == variant.budget + 1
        elif variant.witness == "plain":
            # It ends with the iterate that solves the task, or with its budget.
            assert len(run) == done.aligned.iterations[0, 0] <= 60


def test_it_begins_where_the_task_begins(recorded: tuple[BodyPair, Tasks, AlignmentTask]):
    pair, task, found = recorded
    np.testing.assert_array_equal(found.start, [task.T_world_a[0], task.T_world_b[0]])
    np.testing.assert_array_equal(found.targets, [task.target_a[0], task.target_b[0]])
    assert (found.kind, found.target_class) == (pair.kind, CLASSES[task.target_class[0]])
    assert [body.pieces for body in found.bodies] == [pair.a.pieces, pair.b.pieces]
    for run in found.trajectories:
        np.testing.assert_array_equal(run.poses[0], found.start)
        assert run.iteration[0] == 0 and (np.diff(run.iteration) == 1).all()
        assert run.cpu_s[0] == 0.0 and (np.diff(run.cpu_s) >= 0).all() and run.cpu_s[-1] > 0
    moved = [np.abs(np.diff(run.poses[:, 0], axis=0)).max() for run in found.trajectories]
    assert moved[1] > 0 and moved[0] == moved[2] == moved[3] == 0.0


def test_witness_points_and_errors_are_those_of_the_poses(recorded: tuple[BodyPair, Tasks, AlignmentTask]):
    pair, _, found = recorded
    for variant, run in zip(VARIANTS, found.trajectories, strict=True):
        w = query(Pairs((pair.a,), (pair.b,)), run.poses[:, None, 0], run.poses[:, None, 1])
        np.testing.assert_allclose(run.distance, w.distance[:, 0], atol=1e-9)
        np.testing.assert_allclose(
            run.distance, ((run.witness[:, 1] - run.witness[:, 0]) * w.normal[:, 0]).sum(1), atol=1e-9
        )
        goals = transform_points(run.poses, np.broadcast_to(found.targets, (len(run), 2, 3)))
        expected = ((run.witness - goals) ** 2).sum(axis=(1, 2)) + (run.distance - variant.margin) ** 2
        np.testing.assert_allclose(run.error, expected, rtol=1e-9, atol=1e-20)


def test_without_witness_points_nothing_is_claimed():
    task = one_task(PAIR)
    task.T_world_b[0, 0, 3] = np.nan
    (run,) = record_task(PAIR, task, [Variant("rigid", budget=3)], seed=0).trajectories
    assert np.isnan(run.error).all() and np.isnan(run.distance).all() and np.isnan(run.witness).all()


def test_methods_are_named_by_what_tells_them_apart():
    variants = (Variant(budget=2), Variant(budget=2, margin=0.0), Variant("rigid", budget=2))
    told: list[tuple[float, str]] = []
    found = record_task(PAIR, one_task(PAIR), variants, seed=0, progress=lambda *said: told.append(said))
    assert [run.label for run in found.trajectories] == ["distance + margin 1 mm", "distance + margin 0 mm", "rigid"]
    assert [run.margin for run in found.trajectories] == [1e-3, 0.0, 1e-3]
    assert [share for share, _ in told] == pytest.approx([0.0, 1 / 3, 2 / 3])
    assert told[-1][1] == "recording rigid"


def test_of_several_budgets_the_largest_is_run():
    variants = [Variant(budget=20), Variant(budget=50), Variant("rigid", budget=5), Variant(budget=30)]
    assert largest_budgets(variants) == [Variant(budget=50), Variant("rigid", budget=5)]


def test_the_task_that_is_shown_can_be_solved():
    tasks = draw_tasks(CONCAVE, CLASSES[:3], 9, 0)
    shown = shown_task(tasks)
    first = np.flatnonzero(tasks.reachable & tasks.accepted)[0]
    assert len(shown) == 1 and shown.reachable[0]
    np.testing.assert_array_equal(shown.T_world_b[0], tasks.T_world_b[first])
    tasks.reachable[:] = False
    np.testing.assert_array_equal(shown_task(tasks).T_world_b[0], tasks.T_world_b[tasks.accepted][0])


@pytest.mark.parametrize("keep", [0, 1, 3333, 9998, 9999])
def test_long_runs_are_thinned_evenly(keep: int):
    kept = thin(10_000, keep)
    assert len(kept) <= MAX_ITERATES and kept[0] == 0 and kept[-1] == 9999 and keep in kept
    assert np.diff(kept).max() <= 6 and np.diff(kept).min() >= 1
    np.testing.assert_array_equal(thin(MAX_ITERATES, keep), np.arange(MAX_ITERATES))
