"""Inverse kinematics of an arm: joint values that bring the palm to a pose, from several starts.

Damped least squares with the damping of Sugihara (Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
method, IEEE T-RO 2011): it is the error itself plus a little, so that steps are short far from a solution, or where
there is none, and Newton steps close to one. A joint at a limit that would leave it is held there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind, check_shape
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import log_so3
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs

ROTATION_M_PER_RAD = 0.1
"""Distance in metres that counts as much as one radian, in errors and in the measure of singularity."""

REACHED_M, REACHED_RAD = 1e-7, 1e-6
"""Errors in metres and radians at which a pose is reached."""

ITERATIONS, POLISHING = 60, 2
"""Most iterations from a start, and most iterations that refine a solution."""

MAX_STEP_RAD = 0.4
"""Largest step of a joint, in radians, or in `Hand.per_radian` of a slide."""

BIAS = 1e-7
"""Damping that is left at a solution, m^2."""

SAME_RAD = 1e-3
"""Difference in radians below which two solutions are the same."""

GOOD_DEXTERITY = 0.05
"""Smallest singular value in metres per radian from on which an arm is far enough from singular: of solutions beyond
it, the nearest to the rest pose is the best."""

STARTS = 24
"""Number of starts for each pose."""


@dataclass(frozen=True, eq=False)
class ArmSolutions:
    """Up to K different ways in which the arm brings the palm to each of N poses, the best ones first."""

    q: Float[np.ndarray, "N K n"]
    """Joint values (N, K, n) of the arm and the hand; NaN where there are fewer solutions."""
    dexterity: Float[np.ndarray, "N K"]
    """Smallest singular value (N, K) of the arm, see `dexterity`; NaN as above."""
    free: Bool[np.ndarray, "N K"]
    """True (N, K) where no link of arm or hand is in another."""

    __repr__ = brief

    @property
    def reached(self) -> Bool[np.ndarray, " N"]:
        """True (N,) where there is a solution without self-collision."""
        return np.asarray(self.free.any(axis=1))

    @property
    def best(self) -> Float[np.ndarray, "N n"]:
        """Best joint values (N, n); NaN for the arm where there is no solution."""
        return self.q[:, 0]


class ArmKinematics:
    """Pose and Jacobian of the palm of a hand on an arm, and their inverse."""

    def __init__(self, hand: Hand) -> None:
        """Prepare the chain from the base to the palm.

        Raises:
            HandError: the hand is on no arm.
        """
        check_kind("hand", hand, Hand)
        if hand.arm is None:
            raise HandError(f"hand {hand.name} is on no arm: mount(arm, hand) puts it on one")
        self.hand, self.arm = hand, hand.arm
        self.joints = np.flatnonzero(hand.arm.joints)
        self.lower, self.upper = hand.lower[self.joints], hand.upper[self.joints]
        self.chain = Chain(hand, [hand.arm.palm])

    def palm(self, T_world_base: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses (N, 4, 4) of the palm."""
        return self.chain(T_world_base, q).T_world_link[:, 0]

    def jacobian(
        self, T_world_base: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
    ) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N 6 a"]]:
        """Return the poses (N, 4, 4) of the palm, and velocities (N, 6, a) of its origin, and turns, per arm joint."""
        frames = self.chain(T_world_base, q)
        T = frames.T_world_link[:, 0]
        forces, none = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3, 3))
        linear = np.concatenate([forces, np.cross(T[:, None, :3, 3], forces)], axis=-1)
        covector = np.concatenate([linear, np.concatenate([none, forces], axis=-1)], axis=1)
        J = self.chain.to_joint_space(frames, covector, np.zeros(6, dtype=np.int64))
        return T, J[:, :, 6 + self.joints]

    def dexterity(self, T_world_base: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]) -> np.ndarray:
        """Return the smallest singular values (N,) of the palm's Jacobian, in metres per radian; 0: singular.

        Turns of the palm count as `ROTATION_M_PER_RAD` per radian. An arm of fewer than six joints has as many values.
        NaN where poses or joint values are not finite.
        """
        known = np.isfinite(q).all(axis=1) & np.isfinite(T_world_base).all(axis=(1, 2))
        found = np.full(len(q), np.nan)
        if known.any():
            _, J = self.jacobian(T_world_base[known], q[known])
            found[known] = np.linalg.svd(_weighted(J), compute_uv=False)[:, -1]
        return found

    def follow(
        self,
        T_world_base: Float[np.ndarray, "N 4 4"],
        q: Float[np.ndarray, "N n"],
        T_world_palm: Float[np.ndarray, "N 4 4"],
        iterations: int = ITERATIONS,
    ) -> tuple[Float[np.ndarray, "N n"], Bool[np.ndarray, " N"]]:
        """Return joint values (N, n) near `q` that bring the palm to poses, and a mask (N,) of poses that are reached.

        Where a pose is out of reach, the values bring the palm as near as the iterations do. Only the arm moves.
        """
        q = q.copy()
        q[:, self.joints] = np.clip(q[:, self.joints], self.lower, self.upper)
        reached = np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        for iteration in range(iterations + 1):
            T, J = self.jacobian(T_world_base[active], q[active])
            error = _error(T, T_world_palm[active])
            done = (np.linalg.norm(error[:, :3], axis=1) < REACHED_M) & (
                np.linalg.norm(error[:, 3:], axis=1) < REACHED_RAD
            )
            reached[active] = done
            if iteration == iterations:
                break
            active, error, J = active[~done], error[~done], J[~done]
            if not len(active):
                break
            values = q[active][:, self.joints] + self._step(q[active][:, self.joints], error, J)
            q[active[:, None], self.joints] = np.clip(values, self.lower, self.upper)
        return q, reached

    def polished(
        self,
        T_world_base: Float[np.ndarray, "N 4 4"],
        q: Float[np.ndarray, "N n"],
        T_world_palm: Float[np.ndarray, "N 4 4"],
    ) -> Float[np.ndarray, "N n"]:
        """Return joint values (N, n) still nearer to poses of the palm that `q` reaches: to 1e-9 away from singular."""
        q = q.copy()
        for _ in range(POLISHING):
            T, J = self.jacobian(T_world_base, q)
            values = q[:, self.joints] + self._step(q[:, self.joints], _error(T, T_world_palm), J)
            q[:, self.joints] = np.clip(values, self.lower, self.upper)
        return q

    def solve(
        self,
        T_world_base: Float[np.ndarray, "*N 4 4"],
        q_hand: Float[np.ndarray, "N h"],
        T_world_palm: Float[np.ndarray, "N 4 4"],
        *,
        starts: int = STARTS,
        seed: int = 0,
    ) -> ArmSolutions:
        """Return the different ways to bring the palm to poses, from several starts.

        Solutions without self-collision come first, then solutions farther from singular, up to `GOOD_DEXTERITY`, then
        nearer to the rest pose. The first start is the rest pose, the others are random, the same for all poses.

        Args:
            T_world_base: Poses (N, 4, 4) of the base, or one (4, 4) for all.
            q_hand: Joint values (N, h) of the hand, in the order that it has without its arm.
            T_world_palm: Poses (N, 4, 4) to reach; where they, or the joint values, are not finite, nothing is found.
            starts: Number of starts.
            seed: Seed of the starts.

        Raises:
            GraspRefineError: arrays of other shapes.
        """
        hand, count = self.hand, len(q_hand)
        check_kind("starts", starts, int)
        q_hand, T_world_palm = as_numbers("q_hand", q_hand), as_numbers("T_world_palm", T_world_palm)
        check_shape(
            "q_hand", q_hand, "N", len(hand.joint_names) - len(self.joints), why="joints of the hand without its arm"
        )
        check_shape("T_world_palm", T_world_palm, count, 4, 4)
        T_world_base = np.broadcast_to(T_world_base, (count, 4, 4))
        q = np.full((count, starts, len(hand.joint_names)), np.nan)
        q[:, :, ~self.arm.joints] = q_hand[:, None]
        known = np.isfinite(T_world_palm).all(axis=(1, 2)) & np.isfinite(q_hand).all(axis=1)
        known &= np.isfinite(T_world_base).all(axis=(1, 2))
        found = np.zeros((count, starts), dtype=bool)
        if known.any():
            some = T_world_base[known], q_hand[known], T_world_palm[known]
            values, found[known] = self._attempts(*some, starts, seed)
            values[..., self.joints] = self._near_rest(values[..., self.joints])
            q[known] = values
        found &= ~self._repeated(q[:, :, self.joints], found)
        return self._ranked(T_world_base, q, found)

    def shortfall(
        self,
        T_world_base: Float[np.ndarray, "N 4 4"],
        q_hand: Float[np.ndarray, "N h"],
        T_world_palm: Float[np.ndarray, "N 4 4"],
        *,
        seed: int = 0,
    ) -> Float[np.ndarray, "N 2"]:
        """Return how far (N, 2), in metres and radians, the palm stays from poses at the best of several attempts.

        The arguments are as in `solve`; poses and values are finite.
        """
        q, _ = self._attempts(T_world_base, q_hand, T_world_palm, STARTS, seed)
        count, rows = len(q), np.repeat(np.arange(len(q)), STARTS)
        palm = self.palm(T_world_base[rows], q.reshape(len(rows), -1))
        error = _error(palm, T_world_palm[rows]).reshape(count, STARTS, 2, 3)
        away = np.linalg.norm(error, axis=-1)
        best = (away @ [1.0, ROTATION_M_PER_RAD]).argmin(axis=1)
        return away[np.arange(count), best]

    def _attempts(
        self, T_world_base: np.ndarray, q_hand: np.ndarray, T_world_palm: np.ndarray, starts: int, seed: int
    ) -> tuple[Float[np.ndarray, "N K n"], Bool[np.ndarray, "N K"]]:
        """Return joint values (N, K, n) from each start, and a mask (N, K) of values that reach the pose."""
        count, rows = len(q_hand), np.repeat(np.arange(len(q_hand)), starts)
        q = np.empty((len(rows), len(self.hand.joint_names)))
        q[:, ~self.arm.joints], q[:, self.joints] = q_hand[rows], np.tile(self._starts(starts, seed), (count, 1))
        q, reached = self.follow(T_world_base[rows], q, T_world_palm[rows])
        return q.reshape(count, starts, -1), reached.reshape(count, starts)

    def _ranked(self, T_world_base: np.ndarray, q: np.ndarray, found: np.ndarray) -> ArmSolutions:
        """Return solutions (N, K, n), some of them `found`, ordered and measured."""
        count, starts = found.shape
        at = np.flatnonzero(found.reshape(-1))
        flat, grasp = q.reshape(count * starts, -1), at // max(starts, 1)
        dexterity, free = np.full(count * starts, np.nan), np.zeros(count * starts, dtype=bool)
        dexterity[at] = self.dexterity(T_world_base[grasp], flat[at])
        free[at] = self_penetration(self.hand, self.pairs, flat[at]) == 0.0
        dexterity, free = dexterity.reshape(count, starts), free.reshape(count, starts)
        per_radian = self.hand.per_radian[self.joints]
        away = np.abs((q[..., self.joints] - self.hand.rest[self.joints]) / per_radian).max(axis=2)
        poor = GOOD_DEXTERITY - np.minimum(np.nan_to_num(dexterity), GOOD_DEXTERITY)
        score = np.where(found, np.where(free, 0.0, 1e6) + 1e4 * poor + away, np.inf)
        order = np.argsort(score, axis=1, kind="stable")[:, : max(int(found.sum(axis=1).max(initial=1)), 1)]
        q = np.take_along_axis(q, order[..., None], axis=1)
        q[..., self.joints] = np.where(np.take_along_axis(found, order, axis=1)[..., None], q[..., self.joints], np.nan)
        return ArmSolutions(q, np.take_along_axis(dexterity, order, axis=1), np.take_along_axis(free, order, axis=1))

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links that can touch and that the arm moves against each other."""
        arm = self.arm.links
        return tuple(pair for pair in touching_pairs(self.hand) if arm & set(pair))

    def _starts(self, count: int, seed: int) -> np.ndarray:
        """Return joint values (count, a) of the arm: the rest pose, and draws within half a turn of it."""
        per_radian = self.hand.per_radian[self.joints]
        rest = self.hand.rest[self.joints]
        lower = np.maximum(self.lower, rest - np.pi * per_radian)
        upper = np.minimum(self.upper, rest + np.pi * per_radian)
        slides = self.hand.slides[self.joints]
        lower, upper = np.where(slides, self.lower, lower), np.where(slides, self.upper, upper)
        drawn = np.random.default_rng(seed).uniform(lower, upper, (max(count - 1, 0), len(rest)))
        return np.concatenate([rest[None], drawn])[:count]

    def _near_rest(self, values: np.ndarray) -> np.ndarray:
        """Return joint values (M, a) with whole turns left out, so that they are near the rest pose and allowed."""
        slides, rest = self.hand.slides[self.joints], self.hand.rest[self.joints]
        turns = 2.0 * np.pi * np.round((values - rest) / (2.0 * np.pi))
        near = values - np.where(slides, 0.0, turns)
        return np.where((near >= self.lower) & (near <= self.upper), near, values)

    def _repeated(self, values: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Return a mask (N, K) of solutions that are the same as an earlier one, but for whole turns."""
        away = values[:, :, None] - values[:, None]
        turns = 2.0 * np.pi * np.round(away / (2.0 * np.pi))
        away = away - np.where(self.hand.slides[self.joints], 0.0, turns)
        same = (np.abs(away) < SAME_RAD * self.hand.per_radian[self.joints]).all(axis=-1) & found[:, None]
        return np.tril(same, -1).any(axis=2)

    def _step(self, values: np.ndarray, error: np.ndarray, J: np.ndarray) -> np.ndarray:
        """Return steps (M, a) of the arm towards errors (M, 6)."""
        J, error = _weighted(J), error * _WEIGHTS
        g = (J.mT @ error[..., None])[..., 0]
        held = ((values <= self.lower) & (g < 0.0)) | ((values >= self.upper) & (g > 0.0))
        J = np.where(held[:, None], 0.0, J)
        damping = 0.5 * (error * error).sum(axis=1) + BIAS
        damped = J.mT @ J + damping[:, None, None] * np.eye(J.shape[2])
        step = np.linalg.solve(damped, np.where(held, 0.0, g)[..., None])[..., 0]
        most = MAX_STEP_RAD * self.hand.per_radian[self.joints]
        return step / np.maximum((np.abs(step) / most).max(axis=1, keepdims=True), 1.0)


_WEIGHTS = np.repeat([1.0, ROTATION_M_PER_RAD], 3)


def _weighted(J: np.ndarray) -> np.ndarray:
    return J * _WEIGHTS[:, None]


def _error(T: np.ndarray, T_wanted: np.ndarray) -> np.ndarray:
    """Return the translation and rotation (M, 6) from poses to wanted ones, world axes."""
    turn = log_so3(T_wanted[:, :3, :3] @ T[:, :3, :3].mT)
    return np.concatenate([T_wanted[:, :3, 3] - T[:, :3, 3], turn], axis=1)
