"""The stopwatch of alignment: its parts sum to the time of a run, and what is measured answers as if it were not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import Pairs
from grasp_refine.core.profiling import STAGES
from grasp_refine.core.se3 import exp_se3
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine_apps.bench.align import stopwatch as module
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.descent import align
from grasp_refine_apps.bench.align.levenberg_marquardt import run_levenberg_marquardt
from grasp_refine_apps.bench.align.stopwatch import PARTS, PASSES, Stopwatch, TimedDerivative
from grasp_refine_apps.bench.align.tasks import draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.timing import cpu_share
from shapes_for_tests import cluster_body, convex_body, ring_body


def pairs_and_poses() -> tuple[Pairs, np.ndarray, np.ndarray]:
    pairs = Pairs((convex_body(1, 30), ring_body()), (convex_body(2, 30), cluster_body(3, 4)))
    rng = np.random.default_rng(0)
    T_a, T_b = (exp_se3(rng.normal(size=(5, 2, 6)) * ([0.04] * 3 + [1.0] * 3)) for _ in range(2))
    return pairs, T_a, T_b


def test_every_stage_is_in_one_part():
    assert list(PARTS) == ["broadphase", "narrowphase", "derivative", "solver"]
    assert sorted(stage for part in PARTS.values() for stage in part) == sorted(STAGES)


def test_laps_count_while_it_runs(monkeypatch: pytest.MonkeyPatch):
    now = [5.0]
    monkeypatch.setattr(module.time, "process_time", lambda: now[0])
    watch = Stopwatch()
    for _ in range(2):
        with watch.lap("forward"):
            now[0] += 100.0
        with watch:
            with watch.lap("backward"):
                now[0] += 1.0
                with watch.lap("sampling"):
                    now[0] += 2.0
            now[0] += 4.0
    assert watch.passes_s == {"forward": 0.0, "backward": 6.0, "sampling": 4.0}
    assert tuple(watch.passes_s) == PASSES


@pytest.mark.parametrize("method", ["distance", "finite-difference", "zeroth-order"])
def test_timed_derivatives_are_the_same(method: str):
    pairs, T_a, T_b = pairs_and_poses()
    gradients, watch = [], Stopwatch()
    derivative = Variant(method).derivative(0)
    for method_used in (derivative, TimedDerivative(derivative, watch)):
        layer = WitnessLayer(pairs, method_used)
        poses = [torch.as_tensor(T).requires_grad_() for T in (T_a, T_b)]
        with watch:
            found = layer(*poses, key=3)
            loss = (found.point_a * found.point_b).sum() + found.distance.square().sum()
            gradients.append(torch.autograd.grad(loss, poses))
    for one, other in zip(*gradients, strict=True):
        assert torch.equal(one, other)
    assert watch.spent["derivative"].cpu_s > 0.0
    assert (watch.passes_s["sampling"] > 0.0) == (method == "distance")
    # What a method asks of the narrow phase is counted as well.
    assert (watch.queries > 20 * T_a.shape[0] * len(pairs)) == (method != "distance")


@pytest.mark.parametrize("solver", ["descent", "levenberg-marquardt"])
def test_the_stages_of_a_run_sum_to_its_time(solver: str):
    pair = BodyPair("hulls", "convex", convex_body(1, 30), convex_body(2, 30))
    tasks = draw_tasks(pair, ["vertex-vertex"], 4, 0)
    if solver == "descent":
        result = align([pair], [tasks], Variant(budget=30))
    else:
        result = run_levenberg_marquardt([pair], [tasks], Variant.least_squares(budget=30))
    spent = cpu_share([result.watch], PARTS)
    assert set(spent) == set(PARTS) and min(spent.values()) > 0.0
    assert sum(spent.values()) == pytest.approx(1.0)
    assert result.watch.cpu_s == pytest.approx(result.cpu_s, rel=0.02)
    assert not result.watch.running
