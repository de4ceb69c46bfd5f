"""Loss of a batch of grasps and its gradient through autograd, with any derivative method of witness points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.culling import nothing_near
from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import body_gradient
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.solvers.first_order import FirstOrder
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.terms.term import Setup, State
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Nearby
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.transport import EquivalentTransport


@dataclass(frozen=True, eq=False)
class Slope:
    """Losses of M grasps with their gradients, and query results, warm starts of the next."""

    loss: np.ndarray
    """Losses (M,) in m^2; NaN where a query could not be answered."""
    gradient: np.ndarray
    """Gradients (M, 6 + n) at the root, as a body twist (v, w), and in the joint values; 0 where these are frozen."""
    num_queries: np.ndarray
    """Narrow-phase queries (M,)."""
    number: np.ndarray
    """Number (M,) of the evaluation, which methods that draw samples have as their key."""
    witness: Witness
    """Witness points of links and object (M, L)."""
    self_witness: Witness
    """Witness points of pairs of links (M, S)."""
    nearby: Nearby | None
    """Nearby bodies of the environment; None: none can be near."""


class Objective:
    """Loss of a batch of grasps and its gradient in root pose and joint values."""

    restarts = False

    def __init__(self, scene: Scene, goal: Goal, config: Config, prepared: HandObject | None = None) -> None:
        """Set up kinematics and witness layers, with geometry that is `prepared` or built here."""
        prepared = prepared or HandObject.of(scene)
        self.goal, self.width = goal, max(len(scene.q), 1)
        hand, dtype = scene.hand, getattr(torch, config.dtype)
        self.kinematics = Kinematics(hand, scene.links, dtype=dtype, device=config.device)
        clearance, around = clearances(config, prepared.hand, prepared.chain), prepared.surroundings(scene)
        setup = Setup(scene, goal, prepared, config.margin, config.scales, clearance, around)
        self.setup = setup
        self.reach = np.broadcast_to(setup.reach, goal.touching.shape)
        self.terms = sorted(config.terms_of(setup), key=lambda weighted: weighted[1].cost)
        self.layer = WitnessLayer(prepared.pairs, config.derivative)
        self_pairs, self.self_links = prepared.self_collision_pairs, prepared.self_collision_links
        self.self_layer = None if self_pairs is None else WitnessLayer(self_pairs, config.derivative)
        self.lower, self.upper = limits_within(hand.lower, hand.upper, dtype, config.device)
        self.frozen = Frozen.of(hand, config.freeze)
        self.per_radian = self.tensor(hand.per_radian)
        solver = config.solver
        self._transport = None
        if isinstance(solver, FirstOrder) and solver.transport:
            self._transport = EquivalentTransport(solver.step_translation, solver.step_rotation)

    def tensor(self, array: np.ndarray) -> Tensor:
        """Return an array in the number type and on the device of the refinement."""
        return torch.as_tensor(array, dtype=self.lower.dtype, device=self.lower.device)

    def evaluate(self, member: np.ndarray, point: Point, previous: Slope | None) -> Slope:
        """Return losses, gradients and query results."""
        key = 0 if previous is None else int(previous.number.max()) + 1
        T, q = (self.tensor(part).detach().requires_grad_() for part in (point.T, point.q))
        T_link = T_moving = self.kinematics(T, q)
        T_object = torch.eye(4, dtype=T_link.dtype, device=T_link.device).expand(T_link.shape)
        if self._transport is not None:
            T_moving, T_object = self._transport(T_link, T_object.clone().requires_grad_())
        targets = (self.tensor(target[member]) for target in (self.goal.target_link, self.goal.target_object))
        # Links that should not touch matter only where they penetrate.
        witness = self.layer(
            T_moving, T_object, *targets,
            cutoff=np.where(self.goal.touching[member], np.inf, self.reach[member]), key=key,
            previous=None if previous is None else previous.witness,
        )  # fmt: skip

        def self_witness(rejected: np.ndarray) -> Witness:
            """Return the witness points of the pairs of links; no grasp is rejected."""
            assert self.self_layer is not None
            first, second = (T_link[:, side] for side in self.self_links)
            before = None if previous is None else previous.self_witness
            return self.self_layer(first, second, cutoff=0.0, key=key, previous=before)

        count = len(member)
        none, loss = np.zeros(count, dtype=np.int64), T[:, 0, 0] * 0.0
        no_pairs = nothing_near(np.zeros((count, 0)))
        nearby = None if previous is None else previous.nearby
        patches = None
        if self.setup.flat.any():
            patches = self.setup.patches(member, T_link.detach().double().cpu().numpy(), witness.detached())
        state = State(
            none, none, member, T, q, T_moving, None, witness, no_pairs,
            patches=patches, T_object=T_object, nearby=nearby,
        )  # fmt: skip
        for weight, term in self.terms:
            state = term.complete(state, none.astype(bool), self_witness)
            loss = loss + weight * term.loss(state)
        with stage("derivative"):
            G, q_gradient = torch.autograd.grad(loss.sum(), (T, q), allow_unused=True)
        twist = body_gradient(T.detach(), G)
        q_gradient = torch.zeros_like(q) if q_gradient is None else q_gradient
        gradient = torch.cat([twist, q_gradient], dim=1)
        # A pair whose query failed adds nothing above: the loss of the grasp is not known.
        pairs = [state.witness.detached(), state.self_witness.detached()]
        unknown = np.logical_or(*((found.status > QueryStatus.FAR).any(axis=1) for found in pairs))
        value, slope = (found.detach().double().cpu().numpy() for found in (loss, gradient))
        slope = np.where(self.frozen.unknowns, 0.0, slope)
        num_queries = sum(found.num_queries.sum(axis=1) for found in pairs)
        if state.nearby is not None:
            unknown, num_queries = unknown | state.nearby.failed, num_queries + state.nearby.num_queries
        return Slope(np.where(unknown, np.nan, value), slope, num_queries, none + key, pairs[0], pairs[1], state.nearby)


def limits_within(lower: np.ndarray, upper: np.ndarray, dtype: torch.dtype, device: str) -> tuple[Tensor, Tensor]:
    """Return joint limits (n,) as tensors, rounded inwards, so that they imply the given ones.

    Where single precision has no number between the two, they are the nearest one.
    """
    low, high = (torch.as_tensor(limit, dtype=dtype, device=device) for limit in (lower, upper))
    beyond = low.double().cpu().numpy() < lower, high.double().cpu().numpy() > upper
    outside = [torch.as_tensor(mask, device=device) for mask in beyond]
    inner_low = torch.where(outside[0], torch.nextafter(low, low.new_tensor(torch.inf)), low)
    inner_high = torch.where(outside[1], torch.nextafter(high, high.new_tensor(-torch.inf)), high)
    ordered = inner_low <= inner_high
    return torch.where(ordered, inner_low, low), torch.where(ordered, inner_high, high)
