"""Refinement: the one loop that moves hands until their links touch the object where they should."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.hand import Hand
from grasp_refine.kinematics import Kinematics
from grasp_refine.losses import Weights, contact_targets, joint_limits, penetration
from grasp_refine.objects import Object
from grasp_refine.se3 import body_gradient
from grasp_refine.solvers.descent import Descent
from grasp_refine.solvers.status import Status
from grasp_refine.targets import automatic_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.transport import EquivalentTransport


@dataclass(frozen=True)
class Config:
    """All settings of a refinement."""

    solver: Descent = field(default_factory=Descent)
    """How the hand moves."""
    derivative: ContactKinematics | Distance = field(default_factory=ContactKinematics)
    """How witness points are differentiated."""
    weights: Weights = field(default_factory=Weights)
    """How much each term of the loss counts."""
    margin: float = 0.0
    """Contact margin in metres: the gap that contact links should keep."""
    tolerance: float = 1e-8
    """A grasp has converged when its loss (m^2) is below this; 1e-8 is a tenth of a millimetre."""
    seed: int = 0
    """Seed of everything that is drawn."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = "cpu"
    """Torch device of kinematics and losses."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One hand, one object at the world's origin, and N grasps to refine."""

    hand: Hand
    object: Object
    T_world_root: np.ndarray
    """Initial poses (N, 4, 4) of the hand's base link in the object's frame, metres."""
    q: np.ndarray
    """Initial joint values (N, n) in `hand.joint_names` order."""
    target_link: np.ndarray | None = None
    """Where links should touch (N, L, 3), link frames, one column per link of `links`; NaN: nowhere. None: auto."""
    target_object: np.ndarray | None = None
    """Where the object should be touched (N, L, 3), object frame, metres."""

    @property
    def links(self) -> tuple[str, ...]:
        """Links with collision geometry, the columns of every per-link array; contact links come first."""
        first = [contact.link for contact in self.hand.contacts]
        return (
            *first,
            *(link.name for link in self.hand.links if link.body is not None and link.name not in first),
        )


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


class Objective:
    """The loss of a batch of grasps and its gradient in root pose and joint values."""

    def __init__(self, scene: Scene, config: Config) -> None:
        """Prepare kinematics, pairs and the witness layer of a scene."""
        self.scene, self.config = scene, config
        self.links = scene.links
        hand = scene.hand
        dtype = getattr(torch, config.dtype)
        self.kinematics = Kinematics(hand, self.links, dtype=dtype, device=config.device)
        bodies = hand.links_by_name
        self.pairs = Pairs.against([bodies[name].body for name in self.links], scene.object.body)
        self.layer = WitnessLayer(self.pairs, config.derivative)
        self.lower = torch.as_tensor(hand.lower, dtype=dtype, device=config.device)
        self.upper = torch.as_tensor(hand.upper, dtype=dtype, device=config.device)
        steps = config.solver
        self._transport = (
            EquivalentTransport(steps.step_translation, steps.step_rotation) if steps.transport else None
        )

    def tensor(self, array: np.ndarray) -> Tensor:
        """An array in the number type and on the device of the refinement."""
        return torch.as_tensor(array, dtype=self.lower.dtype, device=self.lower.device)

    def targets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Targets on links and object (N, L, 3), and queries asked for them (N,)."""
        scene = self.scene
        if scene.target_link is not None and scene.target_object is not None:
            return scene.target_link, scene.target_object, np.zeros(len(scene.q), dtype=np.int64)
        with torch.no_grad():
            T = self.kinematics(self.tensor(scene.T_world_root), self.tensor(scene.q)).double().cpu().numpy()
        contacts = len(scene.hand.contacts)
        T_object = np.broadcast_to(np.eye(4), T.shape)
        cutoff = np.where(np.arange(len(self.links)) < contacts, np.inf, -np.inf)
        witness = query(self.pairs, T, T_object, cutoff=cutoff)
        target_link, target_object = automatic_targets(witness, T, T_object)
        return target_link, target_object, witness.asked.sum(axis=1)

    def evaluate(
        self,
        T_world_root: Tensor,
        q: Tensor,
        target_link: Tensor,
        target_object: Tensor,
        key: int,
        previous: Witness | None,
    ) -> tuple[Tensor, Tensor, Tensor, Witness]:
        """Loss (batch,), gradient as a body twist of the root (batch, 6) and in q (batch, n), and the witness points."""
        T_world_root = T_world_root.detach().requires_grad_()
        q = q.detach().requires_grad_()
        T_link = self.kinematics(T_world_root, q)
        T_object = torch.eye(4, dtype=q.dtype, device=q.device).expand(T_link.shape)
        if self._transport is not None:
            T_object = T_object.clone().requires_grad_()
            T_link, T_object = self._transport(T_link, T_object)
        # Links without a target matter only where they penetrate.
        aimed = ~torch.isnan(target_link[..., 0])
        cutoff = np.where(aimed.cpu().numpy(), np.inf, 0.0)
        witness = self.layer(
            T_link, T_object, target_link, target_object, cutoff=cutoff, key=key, previous=previous
        )
        weights = self.config.weights
        contact = contact_targets(witness, T_link, T_object, target_link, target_object, self.config.margin)
        depth = torch.where(aimed, torch.zeros_like(witness.distance), penetration(witness))
        beyond = joint_limits(q, self.lower, self.upper)
        loss = (
            weights.contact * contact.square().sum((1, 2))
            + weights.penetration * depth.square().sum(1)
            + weights.joint_limits * beyond.square().sum(1)
        )
        G, q_gradient = torch.autograd.grad(loss.sum(), (T_world_root, q), allow_unused=True)
        twist = body_gradient(T_world_root.detach(), torch.zeros_like(T_world_root) if G is None else G)
        q_gradient = torch.zeros_like(q) if q_gradient is None else q_gradient
        return loss.detach(), twist, q_gradient, witness.detached()


def refine(
    scene: Scene, config: Config = Config(), progress: Callable[[int, int, float], None] | None = None
) -> Refinement:
    """Refine all grasps of a scene.

    Args:
        scene: Hand, object, initial grasps and, optionally, targets.
        config: All settings.
        progress: Called after each iteration with the number of finished grasps, the iteration, and the mean loss
            of the grasps still running (m^2).

    Returns:
        The best iterate of each grasp by true loss. Not converging is a status, never an exception.
    """
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
        self.target_link, self.target_object = (tensor(target[self.active]) for target in self.targets)

    def iterate(self, iteration: int) -> float:
        """One evaluation and one step of all running grasps; returns their mean loss."""
        solver = self.objective.config.solver
        wall, cpu = time.perf_counter(), time.process_time()
        active = self.active
        loss, twist, q_gradient, witness = self.objective.evaluate(
            self.T, self.q, self.target_link, self.target_object, iteration, self.previous
        )
        value = loss.double().cpu().numpy()
        ended = self._judge(value, iteration)
        stage = torch.as_tensor(self.stage[active], device=self.T.device)
        T, q = solver.step(
            self.T, self.q, twist, q_gradient, stage, self.objective.lower, self.objective.upper
        )
        self.iterations[active] += 1
        self.queries[active] += witness.asked.sum(axis=1)
        keep = np.flatnonzero(~ended)
        rows = torch.as_tensor(keep, device=self.T.device)
        self.T, self.q = T[rows], q[rows]
        if len(keep) < len(active):
            self.active = active[keep]
            self.target_link, self.target_object = self.target_link[rows], self.target_object[rows]
            witness = witness.rows(keep)
        self.previous = witness
        share = 1.0 / len(active)
        self.wall[active] += (time.perf_counter() - wall) * share
        self.cpu[active] += (time.process_time() - cpu) * share
        return float(np.nanmean(value)) if len(value) else 0.0

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
