"""Refinement: the one loop that moves hands until their links touch the object where they should."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from grasp_refine.collision.query import Witness
from grasp_refine.config import Config
from grasp_refine.objective import Objective
from grasp_refine.scene import Scene
from grasp_refine.solvers.status import Status

__all__ = ["Config", "Refinement", "Scene", "refine"]


@dataclass(frozen=True, eq=False)
class Refinement:
    """N refined grasps with the account of how they came about."""

    T_world_root: np.ndarray
    """Poses (N, 4, 4) of the base link: the best iterate of each grasp by true loss."""
    q: np.ndarray
    """Joint values (N, n)."""
    target_link: np.ndarray
    """The targets that were used (N, L, 3), link frames; NaN: none."""
    target_object: np.ndarray
    """The same on the object (N, L, 3)."""
    status: np.ndarray
    """A `Status` for each grasp (N,)."""
    loss: np.ndarray
    """Loss in m^2 before and after (N, 2)."""
    iterations: np.ndarray
    """Iterations of each grasp (N,)."""
    queries: np.ndarray
    """Narrow-phase queries of each grasp (N,)."""
    wall_s: np.ndarray
    """Share of the wall time of each grasp (N,), seconds."""
    cpu_s: np.ndarray
    """Share of the CPU time of each grasp (N,), seconds."""


def refine(
    scene: Scene, config: Config | None = None, progress: Callable[[int, int, float], None] | None = None
) -> Refinement:
    """Refine all grasps of a scene.

    Args:
        scene: Hand, object, initial grasps and, optionally, targets.
        config: All settings; the defaults when None.
        progress: Called after each iteration with the number of finished grasps, the iteration, and the mean loss
            of the grasps still running (m^2).

    Returns:
        The best iterate of each grasp by true loss. Not converging is a status, never an exception.
    """
    config = config or Config()
    objective = Objective(scene, config)
    target_link, target_object, queries = objective.targets()
    run = _Run(objective, target_link, target_object, queries)
    solver = config.solver
    iteration = 0
    while len(run.active) and iteration < solver.iterations:
        mean_loss = run.iterate(iteration)
        iteration += 1
        if progress is not None:
            progress(len(scene.q) - len(run.active), iteration, mean_loss)
    return run.result()


class _Run:
    """The state of the loop: grasps that still run, the best of all grasps, and what they cost."""

    def __init__(
        self, objective: Objective, target_link: np.ndarray, target_object: np.ndarray, queries: np.ndarray
    ) -> None:
        scene = objective.scene
        count = len(scene.q)
        self.objective = objective
        self.targets = target_link, target_object
        self.best_T, self.best_q = scene.T_world_root.copy(), scene.q.copy()
        self.best = np.full(count, np.inf)
        self.first = np.full(count, np.nan)
        self.status = np.full(count, Status.RUNNING)
        self.status[np.isnan(target_link).all(axis=(1, 2))] = Status.NO_TARGET
        finite = np.isfinite(scene.T_world_root).all(axis=(1, 2)) & np.isfinite(scene.q).all(axis=1)
        self.status[~finite] = Status.NOT_FINITE
        self.iterations, self.queries = np.zeros(count, dtype=np.int64), queries.copy()
        self.wall, self.cpu = np.zeros(count), np.zeros(count)
        self.stage, self.since = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.mark = np.full(count, np.inf)
        self.active = np.flatnonzero(self.status == Status.RUNNING)
        self._load(scene.T_world_root[self.active], scene.q[self.active])
        self.previous: Witness | None = None

    def _load(self, T: np.ndarray, q: np.ndarray) -> None:
        tensor = self.objective.tensor
        self.T, self.q = tensor(T), tensor(q)
        self.average = self.q.new_zeros(len(q), 6 + q.shape[1])
        self.target_link, self.target_object = (tensor(target[self.active]) for target in self.targets)

    def iterate(self, iteration: int) -> float:
        """One evaluation and one step of all running grasps; returns their mean loss."""
        solver = self.objective.config.solver
        wall, cpu = time.perf_counter(), time.process_time()
        active = self.active
        loss, gradient, witness = self.objective.evaluate(
            self.T, self.q, self.target_link, self.target_object, iteration, self.previous
        )
        value = loss.double().cpu().numpy()
        ended = self._judge(value, iteration)
        stage = torch.as_tensor(self.stage[active], device=self.T.device)
        T, q, average = solver.step(
            self.T, self.q, gradient, self.average, stage, self.objective.lower, self.objective.upper
        )
        self.iterations[active] += 1
        self.queries[active] += witness.asked.sum(axis=1)
        keep = np.flatnonzero(~ended)
        rows = torch.as_tensor(keep, device=self.T.device)
        self.T, self.q, self.average = T[rows], q[rows], average[rows]
        if len(keep) < len(active):
            self.active = active[keep]
            self.target_link, self.target_object = self.target_link[rows], self.target_object[rows]
            witness = witness.rows(keep)
        self.previous = witness
        share = 1.0 / len(active)
        self.wall[active] += (time.perf_counter() - wall) * share
        self.cpu[active] += (time.process_time() - cpu) * share
        known = value[np.isfinite(value)]
        return float(known.mean()) if len(known) else 0.0

    def _judge(self, value: np.ndarray, iteration: int) -> np.ndarray:
        """Keep the best iterates, advance the schedule, and say which grasps end here (active,)."""
        config, active = self.objective.config, self.active
        solver = config.solver
        if iteration == 0:
            self.first[active] = value
        better = value < self.best[active]
        index = active[better]
        self.best[index] = value[better]
        self.best_T[index] = self.T.double().cpu().numpy()[better]
        self.best_q[index] = self.q.double().cpu().numpy()[better]
        progressed = value < (1.0 - solver.progress) * self.mark[active]
        self.mark[active] = np.where(progressed, value, self.mark[active])
        self.since[active] = np.where(progressed, 0, self.since[active] + 1)
        stuck = self.since[active] >= solver.patience
        last = self.stage[active] == len(solver.factors)
        self.stage[active] = np.maximum(self.stage[active] + (stuck & ~last), solver.first_stage(iteration))
        self.since[active] = np.where(stuck, 0, self.since[active])
        converged, failed = value < config.tolerance, ~np.isfinite(value)
        out_of_budget = np.full(len(active), iteration + 1 >= solver.iterations)
        for mask, status in (
            (out_of_budget, Status.BUDGET),
            (stuck & last, Status.STALLED),
            (converged, Status.CONVERGED),
            (failed, Status.NOT_FINITE),
        ):
            self.status[active[mask]] = status
        return out_of_budget | (stuck & last) | converged | failed

    def result(self) -> Refinement:
        """What came out."""
        hand = self.objective.scene.hand
        finite = np.isfinite(self.best_q).all(axis=1)
        q = np.where(finite[:, None], np.clip(self.best_q, hand.lower, hand.upper), self.best_q)
        return Refinement(
            self.best_T, q, *self.targets, self.status, np.stack([self.first, self.best], axis=1), self.iterations,
            self.queries, self.wall, self.cpu,
        )  # fmt: skip
