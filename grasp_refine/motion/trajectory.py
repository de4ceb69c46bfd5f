"""Trajectories: plans timed by the speed limits of the joints, so that a robot can follow them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import distances
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.arm_gains import DEFAULT_SPEED_RAD_S
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.paths import HandPath
from grasp_refine.motion.plan import WAYPOINTS, MotionPlan

PALM_SPEED = (0.25, 1.0)
"""Speed limits of the palm, in m/s, the reduced speed of ISO 10218-1, and rad/s."""

SPEED_SHARE = 0.5
"""Share of the speed limits that is used."""

MIN_LEG_S = 0.5
"""Least duration of a leg in seconds, in which fingers come to press."""

MIN_KNOTS = 10
"""Least number of poses of a leg after its first one, between which the speed of the palm is found."""

PERIOD_S = 0.02
"""Time in seconds between two set points: legs last whole numbers of periods, so that waypoints are among them."""

POINTS = ("start", *WAYPOINTS)
"""Names of the waypoints, that before the approach too, where the arm comes from a start configuration."""

PEAK = 1.5
"""Largest speed of a leg over its mean one: it starts and ends at rest, s = 3 u^2 - 2 u^3."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Set points of a hand, and its arm, over time."""

    time: Float[np.ndarray, " K"]
    """Times (K,) in seconds, from 0 on, `PERIOD_S` apart."""
    T_world_root: Float[np.ndarray, "K 4 4"]
    """Poses (K, 4, 4) of the base link in the object's frame, metres."""
    q: Float[np.ndarray, "K n"]
    """Joint values (K, n) in `Hand.joint_names` order, rad or m."""
    waypoints: tuple[int, ...]
    """Places of the waypoints among them, the first one and the end of each leg."""
    reaches: bool = False
    """Whether the arm comes from a start configuration first: `MotionPlan.reach`."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of set points."""
        return len(self.time)

    @property
    def named(self) -> dict[str, int]:
        """Places of the waypoints by name."""
        return dict(zip(POINTS[0 if self.reaches else 1 :], self.waypoints, strict=False))

    def velocity(self, values: Float[np.ndarray, "K m"]) -> Float[np.ndarray, "K m"]:
        """Return the rates (K, m) of values at the set points, by central differences; 0 at waypoints, which are rests.

        Args:
            values: Values (K, m) at the times, such as joint values.
        """
        rate = np.gradient(values, PERIOD_S, axis=0) if len(values) else values.copy()
        rate[list(self.waypoints)] = 0.0
        return rate

    def sampled(
        self, seconds: float
    ) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, " S"], HandPath, Int[np.ndarray, " S"]]:
        """Return set points at even times, and the last one.

        Args:
            seconds: Time between them.

        Returns:
            Times (S,) in seconds, places (S,) between the set points of the trajectory, the path of S poses, and the
            numbers (S,) of their legs among `LEGS`; -1 before them.
        """
        time = np.append(np.arange(0.0, self.time[-1], seconds), self.time[-1])
        place = np.interp(time, self.time, np.arange(len(self), dtype=float))
        leg = np.searchsorted(self.waypoints[1:-1], place) - int(self.reaches)
        return time, place, HandPath(self.T_world_root, self.q).at(place), leg


def speed_limits(hand: Hand) -> Float[np.ndarray, " n"]:
    """Return the speed limits (n,) of the independent joints in rad/s or m/s, by default `DEFAULT_SPEED_RAD_S`."""
    limits = [hand.joints_by_name[name].velocity for name in hand.joint_names]
    default = DEFAULT_SPEED_RAD_S * hand.per_radian
    return np.array([fallback if limit is None else limit for limit, fallback in zip(limits, default, strict=True)])


def trajectory(hand: Hand, plan: MotionPlan, *, share: float = SPEED_SHARE) -> Trajectory:
    """Return a trajectory at which no joint, nor the palm, is faster than a share of its limit.

    Each leg begins and ends at rest.

    Args:
        hand: The hand, or the hand on its arm.
        plan: Its legs are taken as far as they are known.
        share: Share of the speed limits.
    """
    limits = speed_limits(hand) * share
    T, q, waypoints = [], [], [0]
    for number, known in enumerate(plan.legs if plan.reach is None else (plan.reach, *plan.legs)):
        leg = known if len(known) > MIN_KNOTS else known.at(np.linspace(0.0, len(known) - 1, MIN_KNOTS + 1))
        T_palm = palm_poses(hand, leg.T_world_root, leg.q)
        palm = np.stack(distances(T_palm[:-1], T_palm[1:]), axis=1) / (share * np.array(PALM_SPEED))
        each = np.concatenate([np.abs(np.diff(leg.q, axis=0)) / limits, palm], axis=1).max(axis=1, initial=0.0)
        total = float(each.sum())
        travelled = np.concatenate([[0.0], np.cumsum(each)]) / total if total else np.linspace(0.0, 1.0, len(leg))
        # Rounding of a duration adds no period.
        periods = int(np.ceil(max(PEAK * total, MIN_LEG_S) / PERIOD_S - 1e-9))
        u = np.linspace(0.0, 1.0, periods + 1)
        timed = leg.at(np.interp(u * u * (3.0 - 2.0 * u), travelled, np.arange(len(leg), dtype=float)))
        first = 0 if number == 0 else 1
        T.append(timed.T_world_root[first:])
        q.append(timed.q[first:])
        waypoints.append(waypoints[-1] + periods)
    if not q:
        n = len(hand.joint_names)
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)), np.zeros((0, n)), ())
    time = PERIOD_S * np.arange(waypoints[-1] + 1)
    return Trajectory(time, np.concatenate(T), np.concatenate(q), tuple(waypoints), plan.reach is not None)
