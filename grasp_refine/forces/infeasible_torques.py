"""Torques that actuators and linkages of a hand cannot make, as linear forms of contact forces.

Joints that share an actuator (`Hand.coupled`) have torques in its ratio, and only springs hold linkages in the modes in
which they yield (`Hand.modes`): deviations from the ratio, and torques in these modes, should be 0. A limit of a joint
may hold a mode as well, but gives way itself: a finger of a few grams rests on a soft one in simulations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import cross, matvec
from grasp_refine.forces.torques import MIN_LIMIT
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand

LEVER_M = 0.06
"""Lever in metres: a torque that cannot be made counts like the force making it there."""


@dataclass(frozen=True, eq=False)
class InfeasibleTorques:
    """Torques that a hand cannot make, over `LEVER_M`: first of coupled joints, then in modes."""

    hand: Hand
    chain: Chain
    """Kinematics of the links whose contacts count."""
    shared: Float[np.ndarray, "S m"]
    """Combinations of the torques of the chain's joints that the actuators cannot make."""

    @staticmethod
    def of(hand: Hand, chain: Chain) -> InfeasibleTorques:
        """Return the infeasible torques of a hand."""
        rows = [np.zeros((0, len(hand.joint_names)))]
        for group in hand.coupled:
            # An orthonormal basis perpendicular to the ratio.
            _, _, basis = np.linalg.svd(np.array(group.ratio, dtype=np.float64)[None])
            row = np.zeros((len(group.joints) - 1, len(hand.joint_names)))
            row[:, [hand.joint_names.index(name) for name in group.joints]] = basis[1:]
            rows.append(row)
        return InfeasibleTorques(hand, chain, np.concatenate(rows) @ chain.joint_gains.T / LEVER_M)

    def __len__(self) -> int:
        """Return the number E of torques."""
        return len(self.shared) + len(self.hand.modes)

    def forms(
        self, frames: Frames, p: Float[np.ndarray, "M K 3"], link: np.ndarray | None = None
    ) -> Float[np.ndarray, "M E K 3"] | None:
        """Return the torques as linear forms of forces at points of links; None where there are none.

        Args:
            frames: Poses of the links.
            p: Points (M, K, 3), world frame.
            link: Links of the points, (K,) or (M, K); None: one of each.
        """
        if not len(self):
            return None
        return velocities(self.twists(frames, np.arange(p.shape[1]) if link is None else link), p)

    def twists(self, frames: Frames, links: np.ndarray) -> Float[np.ndarray, "M E C 6"]:
        """Return the twists of links (C,) or (M, C) whose products with wrenches on them are the torques."""
        if links.ndim > 1:
            every = self.twists(frames, np.arange(len(self.chain.links)))
            return np.take_along_axis(every, links[:, None, :, None], axis=2)
        axes = frames.axes[..., 6:].mT
        weight = self.shared[:, None] * self.chain.joint_mask(links)[:, 6:]
        S, C, m = weight.shape
        shared = (weight.reshape(S * C, m) @ axes).reshape(len(axes), S, C, 6)
        if not self.hand.modes:
            return shared
        modes = mode_twists(self.hand, self.chain, frames)[:, :, links]
        return np.concatenate([shared, modes / LEVER_M], axis=1)

    def changes(
        self, frames: Frames, links: np.ndarray, p: Float[np.ndarray, "M C 3"], f: Float[np.ndarray, "M P C 3"]
    ) -> Float[np.ndarray, "M P E d"]:
        """Return the derivative (M, P, E, 6 + n) of the torques as the links move, while forces and points rest.

        Args:
            frames: Poses of the links.
            links: Links of the points, (C,) or (M, C).
            p: Points, world frame.
            f: Forces on the object.
        """
        parts = []
        if len(self.shared):
            parts.append(self._shared_changes(frames, links, p, f))
        if self.hand.modes:
            parts.append(self._mode_changes(frames, links, p, f))
        return np.concatenate(parts, axis=2)

    def _shared_changes(self, frames: Frames, links: np.ndarray, p: np.ndarray, f: np.ndarray) -> np.ndarray:
        """Derivatives for coupled joints (M, P, S, 6 + n), as the axes of the joints move."""
        (M, P), chain = f.shape[:2], self.chain
        used = np.flatnonzero(self.shared.any(axis=0))
        follows = chain.joint_mask(links)[..., 6 + used]
        linear, angular = np.split(frames.axes[..., 6 + used].mT[:, None], 2, axis=-1)
        W = np.concatenate([f, cross(p[:, None] + np.zeros_like(f), f)], axis=-1)
        # Added contact by contact: zeros of contacts that only other grasps have change no bit.
        W = (np.broadcast_to(follows, (M, *follows.shape[-2:]))[:, None, ..., None] * W[..., None, :]).sum(axis=2)
        moved = _carried(linear, angular, W).reshape(M, P * len(used), 6)
        moved = chain.to_joint_space(frames, moved, np.tile(len(chain.links) + used, P))
        return self.shared[:, used] @ moved.reshape(M, P, len(used), -1)

    def _mode_changes(self, frames: Frames, links: np.ndarray, p: np.ndarray, f: np.ndarray) -> np.ndarray:
        """Derivatives in modes (M, P, E - S, 6 + n), as the links carry their twists and the linkages move."""
        (M, P, C), E = f.shape[:3], len(self.hand.modes)
        link = np.broadcast_to(links, (M, C))
        at = link[:, None, :, None]
        twist, slope = (
            np.take_along_axis(mode_twists(self.hand, self.chain, frames, slope=slope), at, axis=2)[:, None] / LEVER_M
            for slope in (False, True)
        )
        W = np.concatenate([f, cross(p[:, None] + np.zeros_like(f), f)], axis=-1)[:, :, None]
        linear, angular = np.split(twist, 2, axis=-1)
        moved = _carried(linear, angular, W).reshape(M, P * E * C, 6)
        moved = self.chain.to_joint_space(frames, moved, np.tile(link, (1, P * E)))
        found = moved.reshape(M, P, E, C, -1).sum(axis=3)
        drivers = [self.hand.joint_names.index(mode.driver) for mode in self.hand.modes]
        found[:, :, np.arange(E), 6 + np.array(drivers)] += (slope * W).sum(axis=(-2, -1))
        return found


def mode_twists(hand: Hand, chain: Chain, frames: Frames, *, slope: bool = False) -> Float[np.ndarray, "N E L 6"]:
    """Return the spatial twists (N, E, L, 6) of the links of a chain, (v, w), per unit of each of `Hand.modes`.

    Args:
        hand: The hand.
        chain: Kinematics of its links.
        frames: Poses of the links.
        slope: Return their derivatives by the value of the driven joint instead, while the links rest.
    """
    T = frames.T_world_link
    found = np.zeros((len(T), len(hand.modes), T.shape[1], 6))
    for e, mode in enumerate(hand.modes):
        value = frames.q[:, hand.joint_names.index(mode.driver)]
        for column, name in enumerate(chain.links):
            if name in mode.twists:
                twist, R = (mode.slope if slope else mode.twist)(name, value), T[:, column, :3, :3]
                angular = matvec(R, twist[:, 3:])
                found[:, e, column, :3] = matvec(R, twist[:, :3]) - cross(angular, T[:, column, :3, 3])
                found[:, e, column, 3:] = angular
    return found


def mode_shares(
    hand: Hand,
    chain: Chain,
    frames: Frames,
    force: Float[np.ndarray, "N P K 3"],
    point: Float[np.ndarray, "N K 3"],
    link: Int[np.ndarray, "N K"],
    give: float,
) -> Float[np.ndarray, "N P E"]:
    """Return the torques (N, P, E) in modes that make forces in N, as shares of the torques of springs and limits.

    Args:
        hand: The hand.
        chain: Kinematics of the L links.
        frames: Poses of the links.
        force: P forces on the object at each of K contact points, world frame.
        point: Points of the links that push, world frame; any finite one without a force.
        link: Index of the link of each point.
        give: Angle in rad by which a finger may give way, and still hold the object.
    """
    if not hand.modes:
        return np.zeros((*force.shape[:2], 0))
    twist = np.take_along_axis(mode_twists(hand, chain, frames), link[:, None, :, None], axis=2)
    torque = np.einsum("npkx,nekx->npe", force, velocities(twist, point))
    bounds = [mode.bounds(frames.q[:, hand.joint_names.index(mode.driver)], give) for mode in hand.modes]
    least, greatest = (np.stack([bound[side] for bound in bounds], axis=-1)[:, None] for side in (0, 1))
    return np.abs(torque) / np.maximum(np.where(torque < 0.0, -least, greatest), MIN_LIMIT)


def velocities(twists: Float[np.ndarray, "M E C 6"], p: Float[np.ndarray, "M C 3"]) -> Float[np.ndarray, "M E C 3"]:
    """Return the velocities (M, E, C, 3) at points (M, C, 3) of links with twists (M, E, C, 6)."""
    linear, angular = np.split(twists, 2, axis=-1)
    return linear + cross(angular, p[:, None] + np.zeros_like(angular))


def _carried(linear: np.ndarray, angular: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Covectors (..., 6) on the twist (v, w) of a link, by which S . W changes for a twist S that moves with it."""
    force, moment = np.split(W, 2, axis=-1)
    shape = np.broadcast_shapes(linear.shape, force.shape)
    linear, angular, force, moment = (np.broadcast_to(part, shape) for part in (linear, angular, force, moment))
    # d(S . W) = (angular x f) . v + (linear x f + angular x m) . w.
    return np.concatenate([cross(angular, force), cross(linear, force) + cross(angular, moment)], axis=-1)
