"""Paths of a hand: straight lines of the palm, by the joints of its arm if it has one, and between two poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.culling import motion
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import distances, exp_so3, log_so3, transform
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.inverse_kinematics import ArmKinematics

KNOT_M = 0.01
"""Largest distance in metres between the poses of a straight trajectory at which an arm's joints are solved for."""

MAX_JUMP_RAD = 0.3
"""Largest movement of a joint of an arm between two of them; more is a jump near a singularity."""

MAX_ARC_RAD = 0.1
"""Largest rotation of the base, or of a joint, over which a link moves nearly on a straight line."""

MAX_SAMPLES = 2000
"""Most samples of a path."""


@dataclass(frozen=True, eq=False)
class HandPath:
    """K poses of a hand, one after the other; between them joints move evenly."""

    T_world_root: Float[np.ndarray, "K 4 4"]
    """Poses (K, 4, 4) of the base link in the object's frame; the same for a hand on an arm."""
    q: Float[np.ndarray, "K n"]
    """Joint values (K, n) in `Hand.joint_names` order, rad or m."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.q)

    def reversed(self) -> HandPath:
        """Return the path from its end to its start."""
        return HandPath(self.T_world_root[::-1], self.q[::-1])

    def sampled(self, chain: Chain, spheres: Float[np.ndarray, "L 4"], spacing: float) -> HandPath:
        """Return the path with samples so dense that between two no point of a link moves by more than a spacing.

        Args:
            chain: Kinematics of the links.
            spheres: Their bounding spheres, centre and radius, link frames.
            spacing: Distance in metres.
        """
        _, turns = distances(self.T_world_root[:-1], self.T_world_root[1:])
        # Links move on arcs; the distance of their ends says little of a long one.
        arcs = self._divided(np.maximum(np.abs(np.diff(self.q, axis=0)).max(axis=1, initial=0.0), turns) / MAX_ARC_RAD)
        T = chain(arcs.T_world_root, arcs.q).T_world_link
        return arcs._divided(motion(spheres, T[:-1], T[1:]).max(axis=1, initial=0.0) / spacing)

    def _divided(self, parts: Float[np.ndarray, " M"]) -> HandPath:
        """Return the path with each of its M movements between two poses in so many equal parts, rounded up."""
        count = np.maximum(np.ceil(parts).astype(int), 1)
        count = np.minimum(count, max(MAX_SAMPLES // max(len(count), 1), 1))
        return self.at(np.concatenate([k + np.arange(n) / n for k, n in enumerate(count)] + [np.array([len(count)])]))

    def at(self, place: Float[np.ndarray, " P"]) -> HandPath:
        """Return the poses at places (P,) from 0, the first pose, to K - 1, the last one."""
        first = np.minimum(np.floor(place).astype(int), max(len(self) - 2, 0))
        after = np.minimum(first + 1, len(self) - 1)
        share = (place - first)[:, None]
        q = self.q[first] + share * (self.q[after] - self.q[first])
        before, then = self.T_world_root[first], self.T_world_root[after]
        turn = log_so3(before[:, :3, :3].mT @ then[:, :3, :3])
        R = before[:, :3, :3] @ exp_so3(share * turn)
        T = transform(R, before[:, :3, 3] + share * (then[:, :3, 3] - before[:, :3, 3]))
        still = (before == then).all(axis=(1, 2))
        return HandPath(np.where(still[:, None, None], before, T), q)


def straight(
    hand: Hand, T_world_root: Float[np.ndarray, "4 4"], q: Float[np.ndarray, " n"], along: Float[np.ndarray, " 3"]
) -> tuple[HandPath, bool]:
    """Return the path on which the palm moves by a vector without turning, and whether the arm can follow all of it.

    Where it cannot, the path ends at the last pose that it reaches.

    Args:
        hand: The hand, on an arm or not.
        T_world_root: Pose of its base link at the start.
        q: Joint values there; fingers keep theirs.
        along: Vector of the movement in metres, in the frame of `T_world_root`'s world.
    """
    # Rounding of a length adds no pose.
    count = max(int(np.ceil(np.linalg.norm(along) / KNOT_M - 1e-9)), 1)
    moves = np.linspace(0.0, 1.0, count + 1)[:, None] * along
    if hand.arm is None:
        T = np.tile(T_world_root, (count + 1, 1, 1))
        T[:, :3, 3] += moves
        return HandPath(T, np.tile(q, (count + 1, 1))), True
    kinematics = ArmKinematics(hand)
    T_base, values = T_world_root[None], [q]
    T_palm = kinematics.palm(T_base, q[None])
    for move in moves[1:]:
        wanted = T_palm.copy()
        wanted[:, :3, 3] += move
        found, reached = kinematics.follow(T_base, values[-1][None], wanted)
        if not reached[0] or (np.abs(found[0] - values[-1]) > MAX_JUMP_RAD * hand.per_radian).any():
            break
        values.append(found[0])
    return HandPath(np.tile(T_world_root, (len(values), 1, 1)), np.stack(values)), len(values) == count + 1
