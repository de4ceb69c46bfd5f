"""Quality of grasps: an estimate of whether they hold, from contact points and normals alone, without simulation."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from grasp_refine.collision.query import Witness
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.equilibrium import PUSH_SHARE, Equilibrium
from grasp_refine.forces.squeeze import contacts
from grasp_refine.forces.wrench import center_of_mass, contact_forces, contact_forces_under, turn_loads
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object

LOW_FRICTION = 0.1
"""Friction with which the forces should still balance: less than the planning friction."""

DEEP = 0.01
"""Penetration, or gaps of contacts, in metres that count as much as forces that do not balance at all."""

PUSHES = PUSH_SHARE * np.concatenate([np.eye(3, 6), -np.eye(3, 6)])
"""Outer forces (6, 6) that the contacts should balance too, as loads of `contact_forces` in the axes of the hand."""


@dataclass(frozen=True, eq=False)
class Quality:
    """Shortcomings of each of N grasps, all without unit and 0 at best; NaN where a grasp has no forces."""

    slippery: Float[np.ndarray, " N"]
    """Wrench residual (N,) with friction `LOW_FRICTION`."""
    pushed: Float[np.ndarray, " N"]
    """Mean wrench residual (N,) under `PUSHES`, with `PLANNING_FRICTION`; joints that share an actuator make torques in
    its ratio, as nearly as balance allows."""
    deep: Float[np.ndarray, " N"]
    """Deepest penetration of hand and object (N,), over `DEEP`."""
    open: Float[np.ndarray, " N"]
    """Mean gap of the contacts (N,), each counted by its pressure, over `DEEP`."""

    __repr__ = brief

    @property
    def score(self) -> Float[np.ndarray, " N"]:
        """Sum of all (N,); infinite where a grasp has no forces."""
        total = np.sum([getattr(self, field.name) for field in fields(self)], axis=0)
        return np.where(np.isnan(total), np.inf, total)

    @property
    def value(self) -> Float[np.ndarray, " N"]:
        """The quality 1 / (1 + score) (N,), in (0, 1]: higher is better, NaN where a grasp has no forces."""
        return np.where(np.isfinite(self.score), 1.0 / (1.0 + self.score), np.nan)


def quality(hand: Hand, obj: Object, chain: Chain, frames: Frames, witness: Witness) -> Quality:
    """Quality of N grasps, an estimate from contact points and normals of how well they will hold; 1 at best.

    Args:
        hand: The hand.
        obj: The object, at the origin of the frame in which the witness points are.
        chain: Kinematics of the L links; of a link listed several times the first counts.
        frames: Poses of the links.
        witness: Witness points (N, L) of links and object, at least of those that are near enough to be contacts.
    """
    check_kind("hand", hand, Hand)
    check_kind("obj", obj, Object)
    check_kind("chain", chain, Chain)
    check_kind("frames", frames, Frames)
    check_kind("witness", witness, Witness)
    point, normal = contacts(hand, chain.links, witness)
    center = center_of_mass(obj)
    forms = Equilibrium.of(hand, chain, center).torque_forms(np.nan_to_num(point), frames)
    axes = frames.T_world_root[:, :3, :3]
    pushed = contact_forces_under(turn_loads(PUSHES, axes), point, normal, center, forms=forms, axes=axes)
    slippery = contact_forces(point, normal, center, friction=LOW_FRICTION, axes=axes)
    distance = np.where(witness.valid, witness.distance, 0.0)
    return Quality(
        slippery=slippery.residual,
        pushed=pushed.residual.mean(axis=1),
        deep=np.maximum(-distance, 0.0).max(axis=1, initial=0.0) / DEEP,
        open=(slippery.pressure * np.maximum(distance, 0.0)).sum(axis=1) / DEEP,
    )
