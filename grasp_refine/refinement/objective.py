"""Loss of a batch of grasps and its gradient: kinematics, witness points and loss terms put together.

For first-order solvers, through autograd and with any derivative method. Levenberg-Marquardt has the same terms in
`grasp_problem`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import body_gradient, transform_points
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.goal import Goal
from grasp_refine.refinement.losses import (
    below_plane,
    contact_direction,
    contact_gap,
    contact_targets,
    joint_limits,
    penetration,
    stay_near,
)
from grasp_refine.refinement.solvers.first_order import limits_within
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.transport import EquivalentTransport


@dataclass(frozen=True, eq=False)
class Found:
    """Results of the last queries, warm starts of the next."""

    witness: Witness
    """Witness points of links and object (batch, L)."""
    self_witness: Witness | None
    """Witness points of pairs of links (batch, S)."""
    num_queries: np.ndarray
    """Narrow-phase queries (batch,)."""


class Objective:
    """Loss of a batch of grasps and its gradient in root pose and joint values."""

    def __init__(self, scene: Scene, goal: Goal, config: Config, prepared: HandObject | None = None) -> None:
        """Set up kinematics and witness layers, with geometry that is `prepared` or built here."""
        prepared = prepared or HandObject.of(scene)
        self.scene, self.goal, self.config = scene, goal, config
        hand, self.links = scene.hand, scene.links
        dtype = getattr(torch, config.dtype)
        self.kinematics = Kinematics(hand, self.links, dtype=dtype, device=config.device)
        self.layer = WitnessLayer(prepared.pairs, config.derivative)
        self_collision_pairs = prepared.self_collision_pairs if config.weights.self_penetration > 0 else None
        self.own_layer = None if self_collision_pairs is None else WitnessLayer(self_collision_pairs, config.derivative)
        self._own = () if self_collision_pairs is None else prepared.self_collision_links
        self.lower, self.upper = limits_within(hand.lower, hand.upper, dtype, config.device)
        steps = config.solver
        assert not isinstance(steps, LevenbergMarquardt)
        self._transport = EquivalentTransport(steps.step_translation, steps.step_rotation) if steps.transport else None

    def tensor(self, array: np.ndarray) -> Tensor:
        """Return an array in the number type and on the device of the refinement."""
        return torch.as_tensor(array, dtype=self.lower.dtype, device=self.lower.device)

    def evaluate(
        self, member: np.ndarray, T_world_root: Tensor, q: Tensor, key: int, previous: Found | None
    ) -> tuple[Tensor, Tensor, Found]:
        """Return loss (batch,), gradient (batch, 6 + n) at the root (as a body twist) and in q, and query results.

        The loss is NaN where a query could not be answered.
        """
        T_world_root = T_world_root.detach().requires_grad_()
        q = q.detach().requires_grad_()
        T_link = self.kinematics(T_world_root, q)
        loss, witness = self._of_contacts(member, T_link, key, None if previous is None else previous.witness)
        own = None
        if self.own_layer is not None:
            first, second = (T_link[:, side] for side in self._own)
            own = self.own_layer(
                first, second, cutoff=0.0, key=key, previous=None if previous is None else previous.self_witness
            )
            loss = loss + self.config.weights.self_penetration * penetration(own).square().sum(1)
        loss = loss + self._of_posture(member, T_world_root, q)
        with stage("derivative"):
            G, q_gradient = torch.autograd.grad(loss.sum(), (T_world_root, q), allow_unused=True)
        twist = body_gradient(T_world_root.detach(), torch.zeros_like(T_world_root) if G is None else G)
        q_gradient = torch.zeros_like(q) if q_gradient is None else q_gradient
        # A pair whose query failed adds nothing above: the loss of the grasp is not known.
        witnesses = [one.detached() for one in (witness, own) if one is not None]
        unknown = np.logical_or.reduce([(one.status > QueryStatus.FAR).any(axis=1) for one in witnesses])
        loss = loss.detach().masked_fill(torch.as_tensor(unknown, device=loss.device), torch.nan)
        queries = sum(one.num_queries.sum(axis=1) for one in witnesses)
        found = Found(witnesses[0], witnesses[1] if own is not None else None, queries)
        return loss, torch.cat([twist, q_gradient], dim=1), found

    def _of_contacts(
        self, member: np.ndarray, T_link: Tensor, key: int, previous: Witness | None
    ) -> tuple[Tensor, Witness]:
        """Return the terms of links and object (batch,), and the witness points."""
        goal, config, weights = self.goal, self.config, self.config.weights
        T_object = torch.eye(4, dtype=T_link.dtype, device=T_link.device).expand(T_link.shape)
        if self._transport is not None:
            T_object = T_object.clone().requires_grad_()
            T_link, T_object = self._transport(T_link, T_object)
        touching, aimed = goal.touching[member], goal.aimed[member]
        target_link, target_object = (self.tensor(t[member]) for t in (goal.target_link, goal.target_object))
        # Links that should not touch matter only where they penetrate.
        witness = self.layer(
            T_link, T_object, target_link, target_object,
            cutoff=np.where(touching, np.inf, 0.0), key=key, previous=previous,
        )  # fmt: skip
        contact = contact_targets(witness, T_link, T_object, target_link, target_object, config.margin)
        gap = contact_gap(witness, torch.as_tensor(touching & ~aimed, device=T_link.device), config.margin)
        loss = weights.contact * (contact.square().sum((1, 2)) + gap.square().sum(1))
        loss = loss + weights.penetration * penetration(witness).square().sum(1)
        table = self.scene.table
        if table is not None:
            lowest = table.lowest(self.layer.pairs.a, T_link.detach().double().cpu().numpy())
            points = transform_points(T_link, self.tensor(lowest))
            depth = below_plane(points, self.tensor(np.asarray(table.normal)), table.offset)
            loss = loss + weights.table * depth.square().sum(1)
        if goal.direction is not None:
            turned = contact_direction(witness, self.tensor(goal.direction[member]))
            loss = loss + weights.direction * turned.square().sum((1, 2))
        return loss, witness

    def _of_posture(self, member: np.ndarray, T_world_root: Tensor, q: Tensor) -> Tensor:
        """Return the terms of root pose and joint values alone (batch,)."""
        scene, weights = self.scene, self.config.weights
        loss = weights.joint_limits * joint_limits(q, self.lower, self.upper).square().sum(1)
        if weights.stay_near > 0:
            first = self.tensor(scene.T_world_root[member]), self.tensor(scene.q[member])
            away = stay_near(T_world_root, q, *first, self.config.scales)
            loss = loss + weights.stay_near * away.square().sum(1)
        return loss
