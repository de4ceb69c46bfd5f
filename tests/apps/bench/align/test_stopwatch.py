"""The stopwatch: every second counts once, and what is measured answers as if it were not."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from shapes_for_tests import cluster_body, convex_body, ring_body

from apps.bench.align import stopwatch as module
from apps.bench.align.bodies import BodyPair
from apps.bench.align.descent import align
from apps.bench.align.levenberg_marquardt import minimised
from apps.bench.align.stopwatch import STAGES, Stopwatch, TimedDerivative, timed_pairs
from apps.bench.align.tasks import draw_tasks
from apps.bench.align.variants import Variant
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.se3 import exp_se3
from grasp_refine.witness.autograd import WitnessLayer


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """CPU time that passes only when it is told to: the entry."""
    now = [5.0]
    monkeypatch.setattr(module.time, "process_time", lambda: now[0])
    return now


def test_an_inner_stage_counts_for_itself_only(clock: list[float]):
    watch = Stopwatch(running=True)
    assert watch.cpu_s == dict.fromkeys(STAGES, 0.0)
    with watch.stage("solver"):
        clock[0] += 1.0
        for _ in range(2):
            with watch.stage("broadphase"):
                clock[0] += 2.0
                with watch.stage("narrowphase"):
                    clock[0] += 4.0
                clock[0] += 8.0
        with watch.stage("derivative"), watch.stage("narrowphase"):
            clock[0] += 16.0
        clock[0] += 32.0
    clock[0] += 64.0
    assert watch.cpu_s == {"solver": 33.0, "broadphase": 20.0, "narrowphase": 24.0, "derivative": 0.0}


def test_a_stage_may_lie_in_itself(clock: list[float]):
    watch = Stopwatch(running=True)
    with watch.stage("narrowphase"):
        clock[0] += 1.0
        with watch.stage("narrowphase"):
            clock[0] += 2.0
    assert watch.cpu_s["narrowphase"] == 3.0


def test_a_stage_that_fails_is_counted_and_closed(clock: list[float]):
    watch = Stopwatch(running=True)
    with watch.stage("solver"):
        with pytest.raises(ValueError, match="broken"), watch.stage("derivative"):
            clock[0] += 1.0
            raise ValueError("broken")
        clock[0] += 2.0
    assert (watch.cpu_s["derivative"], watch.cpu_s["solver"]) == (1.0, 2.0)


def pairs_and_poses() -> tuple[Pairs, np.ndarray, np.ndarray]:
    pairs = Pairs((convex_body(1, 30), ring_body()), (convex_body(2, 30), cluster_body(3, 4)))
    rng = np.random.default_rng(0)
    T_a, T_b = (exp_se3(rng.normal(size=(5, 2, 6)) * ([0.04] * 3 + [1.0] * 3)) for _ in range(2))
    return pairs, T_a, T_b


def assert_same(one: Witness, other: Witness) -> None:
    for field in fields(Witness):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


def test_timed_pairs_answer_as_the_others_do():
    pairs, T_a, T_b = pairs_and_poses()
    watch = Stopwatch(running=True)
    timed = timed_pairs(pairs, watch)
    first, second = query(pairs, T_a, T_b), query(timed, T_a, T_b)
    assert_same(first, second)
    assert watch.asked == first.asked.sum() > 0
    assert watch.cpu_s["narrowphase"] > 0.0
    asked = watch.asked
    assert_same(query(pairs, T_a, T_b, previous=first), query(timed, T_a, T_b, previous=first))
    assert watch.asked > asked
    # The pairs that were given are not changed.
    asked = watch.asked
    query(pairs, T_a, T_b)
    assert watch.asked == asked


@pytest.mark.parametrize("method", ["distance", "finite-difference", "zeroth-order"])
def test_timed_derivatives_are_the_same(method: str):
    pairs, T_a, T_b = pairs_and_poses()
    gradients, watch = [], Stopwatch(running=True)
    derivative = Variant(method).derivative(0)
    for layer in (
        WitnessLayer(pairs, derivative),
        WitnessLayer(timed_pairs(pairs, watch), TimedDerivative(derivative, watch)),
    ):
        poses = [torch.as_tensor(T).requires_grad_() for T in (T_a, T_b)]
        found = layer(*poses, key=3)
        loss = (found.point_a * found.point_b).sum() + found.distance.square().sum()
        gradients.append(torch.autograd.grad(loss, poses))
    for one, other in zip(*gradients, strict=True):
        assert torch.equal(one, other)
    assert watch.cpu_s["derivative"] > 0.0
    # What a method asks of the narrow phase is counted as well.
    assert (watch.asked > 10 * T_a.shape[0] * len(pairs)) == (method != "distance")


@pytest.mark.parametrize("solver", ["descent", "levenberg-marquardt"])
def test_the_stages_of_a_run_sum_to_its_time(solver: str):
    pair = BodyPair("hulls", "convex", convex_body(1, 30), convex_body(2, 30))
    tasks = draw_tasks(pair, ["vertex-vertex"], 4, 0)
    if solver == "descent":
        result = align([pair], [tasks], Variant(budget=30).built(0))
    else:
        result = minimised([pair], [tasks], Variant.least_squares(budget=30).built(0))
    spent = result.watch.cpu_s
    assert set(spent) == set(STAGES) and min(spent.values()) > 0.0
    assert result.cpu_s * 0.98 < sum(spent.values()) < result.cpu_s * 1.02
