"""The descent of alignment tasks: it solves them, keeps the best pose, starts again, and steps as far as it says."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from alignment_errors import errors_at
from grasp_refine.core.se3 import ambient_gradient, exp_se3, inverse, transform_points
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine_apps.bench.align import descent as module
from grasp_refine_apps.bench.align.aligned import AlignmentResult
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.descent import METRES_PER_RADIAN, _step, _unit_twists, align
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, aligned_poses, draw_tasks, exposed_vertices
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import convex_body
from twists import adjoint, log_se3

PAIR = BodyPair("hulls", "convex", normalised(convex_body(1, 24), 0.06), normalised(convex_body(2, 24), 0.09))
OTHER = BodyPair("others", "convex", normalised(convex_body(3, 40), 0.03), normalised(convex_body(4, 16), 0.12))
N = 6


@pytest.fixture(autouse=True)
def one_thread(threads: None):
    """Small matrices are slower with more."""
    torch.set_num_threads(1)


def accepted(pair: BodyPair, count: int = N, seed: int = 0) -> Tasks:
    tasks = draw_tasks(pair, CLASSES[:3], count, seed)
    return tasks.take(np.flatnonzero(tasks.accepted))


def ran(variant: Variant, tasks: Tasks | None = None, pair: BodyPair = PAIR, **options: object) -> AlignmentResult:
    """A run of one pair."""
    return align([pair], [accepted(pair) if tasks is None else tasks], variant, **options)


PROJECTION = np.array([1.0] * 3 + [0.5] * 3)
"""Factors of the derivatives along (v, w) in the paper's projection."""


def twist_gradients(pair: BodyPair, tasks: Tasks, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Central differences (N, 6) of the error along body twists of either body, at the initial poses."""
    h, sides = 1e-7, []
    for side in range(2):
        columns = []
        for step in h * np.eye(6):
            ends = []
            for sign in (1.0, -1.0):
                T = [tasks.T_world_a, tasks.T_world_b]
                T[side] = T[side] @ exp_se3(sign * step)
                ends.append(errors_at(pair, tasks, *T, margin))
            columns.append((ends[0] - ends[1]) / (2 * h))
        sides.append(np.stack(columns, axis=1))
    return sides[0], sides[1]


class Steps:
    """The steps of a run: their sizes, and poses before and after."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rotation: list[np.ndarray] = []
        self.start: list[np.ndarray] = []
        self.twist: list[np.ndarray] = []
        step = module._step

        def recorded(T: torch.Tensor, unit: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
            moved = step(T, unit, rotation)
            self.rotation.append(rotation[:, 0, 0].numpy())
            self.start.append(T[:, 0].numpy())
            self.twist.append(log_se3(inverse(T.numpy()) @ moved.numpy())[:, 0])
            return moved

        monkeypatch.setattr(module, "_step", recorded)


# What comes out


def test_the_error_vanishes_at_the_aligned_pose():
    (t_a, n_a), (t_b, n_b) = exposed_vertices(PAIR.a), exposed_vertices(PAIR.b)
    rng = np.random.default_rng(0)
    i, j = rng.integers(len(t_a), size=N), rng.integers(len(t_b), size=N)
    T_a = exp_se3(rng.normal(size=(N, 6)) * 0.1)
    T_b = aligned_poses(T_a, (t_a[i], n_a[i]), (t_b[j], n_b[j]), rng.uniform(0, 6, N))
    yes = np.ones(N, dtype=bool)
    tasks = Tasks(np.zeros(N, dtype=int), t_a[i], t_b[j], T_a, T_b, yes, yes, np.ones(N))
    result = ran(Variant(margin=0.0, budget=1), tasks)
    assert result.error.max() < 1e-20
    np.testing.assert_allclose(result.T_world_b[:, 0], T_b, atol=1e-15)
    # The margin is the gap that is aimed at.
    result = ran(Variant("rigid", margin=1e-3, budget=1, step_size=0.0), tasks)
    np.testing.assert_allclose(result.error, 1e-6, rtol=1e-6)


@pytest.mark.parametrize("margin", [0.0, 1e-3])
def test_descent_solves_tasks_of_convex_bodies(margin: float):
    tasks = accepted(PAIR, 12)
    before = errors_at(PAIR, tasks, tasks.T_world_a, tasks.T_world_b, margin)
    result = ran(Variant(margin=margin, budget=200), tasks)
    assert (result.iterations == 200).all()
    assert np.median(result.error) < 1e-2 * np.median(before)
    assert (result.error[:, 0] <= before * (1 + 1e-9)).all()
    found = errors_at(PAIR, tasks, result.T_world_a[:, 0], result.T_world_b[:, 0], margin)
    np.testing.assert_allclose(result.error[:, 0], found, rtol=1e-6, atol=1e-20)


def test_a_task_without_witness_points_is_never_solved():
    tasks = accepted(PAIR)
    alone = ran(Variant(budget=5), tasks)
    tasks = replace(tasks, T_world_b=tasks.T_world_b.copy())
    tasks.T_world_b[2, 0, 3] = np.nan
    result = ran(Variant(budget=5), tasks)
    assert result.error[2, 0] == np.inf
    others = np.arange(len(tasks)) != 2
    np.testing.assert_allclose(result.error[others], alone.error[others], rtol=1e-6)


# What moves


@pytest.mark.parametrize("transport", [True, False])
def test_the_first_step_follows_the_gradient(transport: bool, monkeypatch: pytest.MonkeyPatch):
    tasks, steps = accepted(PAIR), Steps(monkeypatch)
    # Its usual step is wide enough to reach the next features.
    monkeypatch.setattr(Variant, "derivative", lambda variant, seed: FiniteDifference(1e-6))
    align([PAIR], [tasks], Variant(transport=transport, budget=1, step_size=1e-3))
    G_a, G_b = (PROJECTION * G for G in twist_gradients(PAIR, tasks, 1e-3))
    scale = np.array([METRES_PER_RADIAN] * 3 + [1.0] * 3)
    if transport:
        relative = inverse(tasks.T_world_b) @ tasks.T_world_a
        G_b = G_b - (adjoint(relative) @ (G_a * scale)[..., None])[..., 0] / scale
    expected = -1e-3 * scale * G_b / np.linalg.norm(G_b, axis=1, keepdims=True)
    np.testing.assert_allclose(steps.twist[0] / scale, expected / scale, atol=2e-6)


# Steps and budgets


def test_a_step_has_the_length_that_is_asked_for():
    rng = np.random.default_rng(0)
    T = torch.as_tensor(exp_se3(rng.normal(size=(5, 2, 6))))
    wrench = torch.as_tensor(rng.normal(size=(5, 2, 6)) * 10.0 ** rng.uniform(-6, 3, size=(5, 2, 1)))
    wrench[0, 0] = 0.0
    for rotation in (0.1, 1.0):
        (unit,) = _unit_twists((T,), (ambient_gradient(T, wrench),))
        moved = _step(T, unit, torch.full((5, 2, 1), rotation))
        twist = log_se3((inverse(T) @ moved).numpy()) / ([METRES_PER_RADIAN * rotation] * 3 + [rotation] * 3)
        length = np.linalg.norm(twist, axis=-1)
        assert length[0, 0] == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(length.reshape(-1)[1:], 1.0, rtol=1e-6)
        # Downhill: the derivative along (v, w) is the wrench at the origin of the body, in its axes.
        force, moment = wrench[..., :3], wrench[..., 3:]
        moment = moment - torch.linalg.cross(T[..., :3, 3], force)
        covector = torch.cat([force, moment], dim=-1).numpy().reshape(5, 2, 2, 3)
        covector = PROJECTION * (covector @ T[..., :3, :3].numpy()).reshape(5, 2, 6)
        size = np.linalg.norm(covector, axis=-1, keepdims=True)
        np.testing.assert_allclose(twist, -covector / np.where(size > 0, size, 1.0), atol=1e-6)


def test_steps_of_a_run_shrink_and_its_last_ones_start_at_its_best_pose(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "FIRST_ITERATIONS", 40)
    monkeypatch.setattr(module, "RUN_ITERATIONS", 40)
    steps, tasks = Steps(monkeypatch), accepted(PAIR, 12)
    result = ran(Variant(budget=120, step_size=3.0), tasks)
    # The second run starts far away, the third one near the best pose.
    rotation = np.array(steps.rotation).reshape(3, 40, -1)
    running = np.isclose(rotation[:, 35], 0.3)
    assert running.any(axis=1).all()
    for run, first in enumerate((3.0, 3.0, 0.3)):
        sizes = rotation[run, :, running[run]].T
        np.testing.assert_allclose(sizes[:36], np.repeat([[first], [0.3]], [4, 32], axis=0) + 0 * sizes[:36])
        np.testing.assert_allclose(sizes[36], 0.03)
        ratio = sizes[37:] / sizes[36:-1]
        assert (np.isclose(ratio, 0.5) | np.isclose(ratio, 1.5)).all()
    errors = np.array([errors_at(PAIR, tasks, tasks.T_world_a, T_b, 1e-3) for T_b in steps.start])
    for run in range(3):
        least = np.minimum.accumulate(errors[40 * run : 40 * run + 40], axis=0)
        np.testing.assert_allclose(errors[40 * run + 36 : 40 * run + 40], least[36:], rtol=1e-6)
    assert (result.error[:, 0] <= errors.min(axis=0) * (1 + 1e-6)).all()


def test_runs_after_the_first_solve_tasks_that_it_leaves_and_lose_none(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "FIRST_ITERATIONS", 60)
    tasks = accepted(PAIR, 16)
    first, more = (ran(Variant(budget=60 * runs), tasks).error[:, 0] for runs in (1, 5))
    assert (more <= first).all()
    left = first > 1e-6
    assert left.any() and (more[left] < 1e-6).mean() > 0.5


def test_a_task_starts_again_with_its_own_random_numbers(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "FIRST_ITERATIONS", 3)
    monkeypatch.setattr(module, "RUN_ITERATIONS", 3)
    tasks, steps = accepted(PAIR, 12), Steps(monkeypatch)
    ran(Variant(budget=7), tasks)
    together, steps.start = steps.start, []
    ran(Variant(budget=7), tasks.take(np.array([7, 2])))
    for k in (3, 6):
        np.testing.assert_allclose(steps.start[k], together[k][[7, 2]], atol=1e-9)
    # The target of body b is put on that of body a.
    reached = transform_points(together[3], tasks.target_b)
    np.testing.assert_allclose(reached, transform_points(tasks.T_world_a, tasks.target_a), atol=1e-12)
    steps.start = []
    ran(Variant(budget=7), tasks, seed=1)
    assert np.abs(steps.start[3] - together[3]).max() > 0.1


def test_a_budget_in_seconds_is_cpu_time_of_each_pair(monkeypatch: pytest.MonkeyPatch):
    """The clock of CPU time goes on by one second whenever it is read here: once in each iteration."""
    seconds = itertools.count(0.0)
    clock = SimpleNamespace(process_time=lambda: next(seconds), perf_counter=time.perf_counter)
    tasks = [accepted(PAIR, 3), accepted(OTHER, 3)]
    monkeypatch.setattr(module, "time", clock)
    for pairs in (1, 2):
        result = align([PAIR, OTHER][:pairs], tasks[:pairs], Variant(budget=None, budget_s=20.0))
        assert (result.iterations == 20 * pairs).all() and result.cpu_s == 20 * pairs + 1
