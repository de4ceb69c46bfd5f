"""Joints that fixed tendons of an MJCF tie to other ones: equalities of tendons, and limits with hardly any play."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from grasp_refine.hands.files.mjcf import joints_of

MAX_PLAY_RAD = 0.2
"""Largest distance in radians of a hinge from where a limited tendon ties it: tendons of the Shadow hand in Gymnasium
Robotics leave 0.14."""


@dataclass(frozen=True)
class TendonTie:
    """Joint that a tendon makes a linear function of another one; names and values of the MJCF."""

    tendon: str
    """Name of the tendon."""
    follower: str
    """Name of the joint that no actuator moves by itself."""
    leader: str
    """Name of the joint that it follows."""
    multiplier: float
    """Value of the follower per value of the leader."""
    offset: float
    """Value of the follower where the leader's is 0."""
    play: float = 0.0
    """Largest distance in radians of the follower from this value."""


def tendon_ties(spec: mujoco.MjSpec, model: mujoco.MjModel, driven: Collection[str]) -> list[TendonTie]:
    """Return the joints that tendons tie, from driven joints outwards: each leader is driven or a follower before.

    In MuJoCo an equality of tendons is l1 - r1 = c0 + c1 (l2 - r2), with lengths l = sum of coefficient x joint value
    and lengths at the reference positions r; without a second tendon l1 - r1 = c0. Tendons of two joints are ties. So
    are limits of a tendon over two hinges that leave the follower less than `MAX_PLAY_RAD`, which then is in their
    middle.

    Args:
        spec: The MJCF.
        model: It, compiled.
        driven: Joints that actuators or other equalities move.
    """
    rows = [*_equalities(spec, model), *_limits(spec, model)]
    moved = set(driven)
    ties: list[TendonTie] = []
    while True:
        for row in rows:
            followers = [name for name in row.coefficients if name not in moved]
            if len(followers) == 1:
                break
        else:
            return ties
        rows.remove(row)
        follower, leader = followers[0], next(name for name in row.coefficients if name != followers[0])
        own = row.coefficients[follower]
        play = row.slack / abs(own)
        if play <= MAX_PLAY_RAD:
            multiplier = -row.coefficients[leader] / own
            ties.append(TendonTie(row.tendon, follower, leader, multiplier, row.value / own, play))
            moved.add(follower)


@dataclass(frozen=True)
class _Row:
    """Sum of coefficient x value over two joints, which is `value` up to `slack`."""

    tendon: str
    coefficients: Mapping[str, float]
    value: float
    slack: float = 0.0


def _equalities(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[_Row]:
    """Return the active linear equalities of tendons that tie two joints."""
    tendons = {tendon.name: joints_of(tendon) for tendon in spec.tendons}
    rows = []
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_TENDON or not equality.active:
            continue
        constant, slope, *higher = np.asarray(equality.data)[:5]
        terms = dict(tendons[equality.name1])
        value = constant + model.tendon_length0[model.tendon(equality.name1).id]
        if equality.name2:
            if any(higher):
                continue
            value -= slope * model.tendon_length0[model.tendon(equality.name2).id]
            for name, coefficient in tendons[equality.name2].items():
                terms[name] = terms.get(name, 0.0) - slope * coefficient
        terms = {name: coefficient for name, coefficient in terms.items() if coefficient}
        if len(terms) == 2:
            rows.append(_Row(equality.name1, terms, value))
    return rows


def _limits(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[_Row]:
    """Return the limits of tendons over two hinges."""
    rows = []
    for tendon in spec.tendons:
        number, terms = model.tendon(tendon.name).id, joints_of(tendon)
        hinges = all(model.jnt_type[model.joint(name).id] == mujoco.mjtJoint.mjJNT_HINGE for name in terms)
        if model.tendon_limited[number] and len(terms) == 2 and hinges and all(terms.values()):
            lower, upper = model.tendon_range[number]
            rows.append(_Row(tendon.name, terms, (lower + upper) / 2, (upper - lower) / 2))
    return rows
