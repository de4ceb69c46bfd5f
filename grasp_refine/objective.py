"""The loss of a batch of grasps and its gradient: kinematics, witness points and loss terms put together."""

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.config import Config
from grasp_refine.kinematics import Kinematics
from grasp_refine.losses import contact_targets, joint_limits, penetration
from grasp_refine.scene import Scene
from grasp_refine.se3 import body_gradient
from grasp_refine.targets import automatic_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.transport import EquivalentTransport


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
        self._transport = EquivalentTransport(steps.step_translation, steps.step_rotation) if steps.transport else None

    def tensor(self, array: np.ndarray) -> Tensor:
        """An array in the number type and on the device of the refinement."""
        return torch.as_tensor(array, dtype=self.lower.dtype, device=self.lower.device)

    def targets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Targets on links and object (N, L, 3), and queries asked for them (N,)."""
        scene = self.scene
        if scene.target_link is not None and scene.target_object is not None:
            given = scene.target_link, scene.target_object
            # A point on one side only is no target.
            missing = np.logical_or(*(np.isnan(target).any(axis=-1, keepdims=True) for target in given))
            target_link, target_object = (np.where(missing, np.nan, target) for target in given)
            return target_link, target_object, np.zeros(len(scene.q), dtype=np.int64)
        with torch.no_grad():
            T = self.kinematics(self.tensor(scene.T_world_root), self.tensor(scene.q)).double().cpu().numpy()
        contacts = len(scene.hand.contacts)
        T_object = np.broadcast_to(np.eye(4), T.shape)
        cutoff = np.where(np.arange(len(self.links)) < contacts, np.inf, -np.inf)
        witness = query(self.pairs, T, T_object, cutoff=cutoff)
        target_link, target_object = automatic_targets(witness, T, T_object, self.config.reach)
        return target_link, target_object, witness.asked.sum(axis=1)

    def evaluate(
        self,
        T_world_root: Tensor,
        q: Tensor,
        target_link: Tensor,
        target_object: Tensor,
        key: int,
        previous: Witness | None,
    ) -> tuple[Tensor, Tensor, Witness]:
        """Loss (batch,), its gradient (batch, 6 + n) at the root (as a body twist) and in q, and the witness points.

        The loss is NaN where a query could not be answered.
        """
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
        witness = self.layer(T_link, T_object, target_link, target_object, cutoff=cutoff, key=key, previous=previous)
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
        # A pair that no query could answer counts nothing above: what the grasp is worth is not known.
        unknown = torch.as_tensor((witness.status > QueryStatus.FAR).any(axis=1), device=loss.device)
        loss = loss.detach().masked_fill(unknown, torch.nan)
        return loss, torch.cat([twist, q_gradient], dim=1), witness.detached()
