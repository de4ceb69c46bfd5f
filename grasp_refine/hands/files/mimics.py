"""Mimic joints: the independent joint that each follows in the end, and the limits of that one with its followers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.tree import Joint, Mimic

LIMIT_ROUNDING = {"revolute": 1e-3, "continuous": 1e-3, "prismatic": 1e-5}
"""Narrowing of limits by followers, in rad or m by kind of joint, up to which it is rounding and gets no note."""


def followed(joint: Joint, joints: Mapping[str, Joint]) -> Mimic:
    """The independent joint that `joint` follows through all mimic joints between; itself, where it is independent.

    The coupling maps the value of the independent joint to the value of `joint`.
    """
    coupling = Mimic(joint.name, 1.0, 0.0)
    while joint.mimic is not None:
        coupling = coupling.after(joint.mimic)
        joint = joints[joint.mimic.joint]
    return coupling


def mimic_map(
    joints: Sequence[Joint], independent: Sequence[str]
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, " m"], tuple[str, ...]]:
    """Matrix (m, n), offset (m,) and names (m,) that give the values of all m movable joints.

    values = matrix @ q + offset, for q in the order of `independent` and names in the order of `joints`, up to the
    `curves` of couplings that are not linear.
    """
    by_name = {joint.name: joint for joint in joints}
    movable = [joint for joint in joints if joint.movable]
    matrix, offset = np.zeros((len(movable), len(independent))), np.zeros(len(movable))
    for row, joint in enumerate(movable):
        leads = followed(joint, by_name)
        offset[row] = leads.offset
        matrix[row, independent.index(leads.joint)] = leads.multiplier
    return matrix, offset, tuple(joint.name for joint in movable)


@dataclass(frozen=True, eq=False)
class Curves:
    """Parts of the values of m movable joints that are not linear in the n independent joints."""

    leader: Int[np.ndarray, " m"]
    """Index (m,) of the independent joint that each follows."""
    higher: Float[np.ndarray, "m d"]
    """Coefficients (m, d) of its second and higher powers."""

    def __call__(self, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch m"]:
        """Return the nonlinear term beside matrix @ q + offset of `mimic_map`."""
        x = q[..., self.leader]
        total = np.zeros_like(x)
        for coefficient in self.higher.T[::-1]:
            total = (total + coefficient) * x
        return total * x

    @property
    def curved(self) -> Bool[np.ndarray, " m"]:
        """Mask (m,) of the joints that have such a part."""
        return np.asarray(self.higher.any(axis=1))

    def take(self, rows: Sequence[int] | Int[np.ndarray, " r"], sign: Float[np.ndarray, " r"] | None = None) -> Curves:
        """Return the curves of the joints `rows`, times `sign` (r,)."""
        at = np.asarray(rows, dtype=np.int64)
        higher = self.higher[at]
        return Curves(self.leader[at], higher if sign is None else sign[:, None] * higher)


def curves(joints: Sequence[Joint], independent: Sequence[str]) -> Curves:
    """Return the parts of the values of all movable joints that `mimic_map` leaves out."""
    by_name = {joint.name: joint for joint in joints}
    leads = [followed(joint, by_name) for joint in joints if joint.movable]
    higher = np.zeros((len(leads), max((len(each.higher) for each in leads), default=0)))
    for row, each in enumerate(leads):
        higher[row, : len(each.higher)] = each.higher
    return Curves(np.array([independent.index(each.joint) for each in leads], dtype=np.int64), higher)


def limit_by_followers(
    joints: Sequence[Joint], path: Path, follower_limits: Literal["own", "leader"] = "own"
) -> tuple[list[Joint], list[str]]:
    """Return the joints, independent ones with limits that keep their followers within theirs, and notes on changes.

    With `follower_limits` "leader", mimic joints have instead the limits that follow from the joint that they follow.

    An independent joint keeps its own limits too. A continuous one whose followers have limits turns within limits, so
    that it is returned as a revolute one.

    Raises:
        HandError: a joint is left without a range, or a mimic joint that never moves is outside its limits.
    """
    by_name = {joint.name: joint for joint in joints}
    if follower_limits == "leader":
        return [_limited_by_leader(joint, by_name) for joint in joints], []
    range_of = {joint.name: (joint.lower, joint.upper) for joint in joints}
    allowed: dict[str, dict[str, list[float]]] = {}  # leader -> follower -> values of the leader that keep it in limits
    for follower in joints:
        if follower.mimic is None or follower.kind == "continuous":
            continue
        leads = followed(follower, by_name)
        if leads.higher:
            continue  # linkages are solved within the limits of their joints
        where = f"{path}: joint '{follower.name}', limited to {follower.lower:g} to {follower.upper:g}"
        if leads.multiplier == 0:
            if not follower.lower <= leads.offset <= follower.upper:
                raise HandError(f"{where}, is always at {leads.offset:g}: its mimic multiplier is 0; change either")
            continue
        own = by_name[leads.joint]
        ends = sorted((limit - leads.offset) / leads.multiplier for limit in (follower.lower, follower.upper))
        allowed.setdefault(own.name, {})[follower.name] = ends
        lower, upper = range_of[own.name]
        lower, upper = max(lower, ends[0]), min(upper, ends[1])
        if lower > upper and lower - upper <= LIMIT_ROUNDING[own.kind]:
            # Limits that meet in one value, up to the digits written.
            lower = upper = min(max(lower, own.lower), own.upper)
        if lower > upper or (upper - lower < 1e-6 < own.upper - own.lower):
            raise HandError(
                f"{where}, is {leads.multiplier:g} x '{own.name}' + {leads.offset:g}, which leaves '{own.name}' no "
                f"value within its own {own.lower:g} to {own.upper:g}: a sign or a limit is wrong; with "
                f"`follower_limits='leader'` the limits of '{follower.name}' are ignored"
            )
        range_of[own.name] = lower, upper
    notes = [_note(by_name[name], *range_of[name], of_followers) for name, of_followers in allowed.items()]
    return [_with_limits(joint, *range_of[joint.name]) for joint in joints], [note for note in notes if note]


def _limited_by_leader(joint: Joint, by_name: Mapping[str, Joint]) -> Joint:
    """Return a mimic joint with the limits that its leader has; others unchanged, as followers along curves."""
    if joint.mimic is None or joint.kind == "continuous":
        return joint
    leads = followed(joint, by_name)
    own = by_name[leads.joint]
    if leads.higher or not np.isfinite([own.lower, own.upper]).all():
        return joint
    lower, upper = sorted(leads.offset + leads.multiplier * limit for limit in (own.lower, own.upper))
    return replace(joint, lower=lower, upper=upper)


def _note(own: Joint, lower: float, upper: float, allowed: Mapping[str, Sequence[float]]) -> str:
    """Note on the followers that narrow the range of `own`; "" where none narrows it beyond rounding."""
    if max(lower - own.lower, own.upper - upper) <= LIMIT_ROUNDING[own.kind]:
        return ""
    who = [name for name, ends in allowed.items() if own.lower < ends[0] == lower or own.upper > ends[1] == upper]
    return (
        f"joint '{own.name}' moves from {lower:.4g} to {upper:.4g} {'m' if own.kind == 'prismatic' else 'rad'}, "
        f"its own limits are {own.lower:g} to {own.upper:g}: beyond, {', '.join(who)} would leave "
        f"{'its' if len(who) == 1 else 'their'} limits"
    )


def _with_limits(joint: Joint, lower: float, upper: float) -> Joint:
    if (lower, upper) == (joint.lower, joint.upper):
        return joint
    kind = "revolute" if joint.kind == "continuous" and np.isfinite([lower, upper]).all() else joint.kind
    return replace(joint, kind=kind, lower=lower, upper=upper)
