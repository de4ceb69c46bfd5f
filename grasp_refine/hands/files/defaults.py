"""Settings that a hand.toml leaves open, filled in from the file of the hand, and lookup of the names in it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.files.fingertips import fingertips
from grasp_refine.hands.files.hand_toml import ACTUATOR, Contact, Coupled, HandToml
from grasp_refine.hands.files.tree import Joint, LinkPair

SLIDE_LEVER_M = 0.1
"""Lever in metres at which a prismatic joint is like a revolute one: it moves by so much where that turns by a radian,
and is driven like that without values in hand.toml."""

LEVER_POWERS = {"kp": 2, "damping": 2, "armature": 2, "frictionloss": 1}
"""Powers of the lever by which settings of a prismatic joint are divided: 5 Nm/rad at the lever are 500 N/m."""


@dataclass(frozen=True, eq=False)
class Actuator:
    """Position actuators, one per independent joint: each field is (n,), in Nm and rad, or N and m."""

    kp: Float[np.ndarray, " n"]
    """Stiffness: torque per position error."""
    force_limit: Float[np.ndarray, " n"]
    """Greatest torque; inf where unknown."""
    damping: Float[np.ndarray, " n"]
    """Torque per velocity."""
    armature: Float[np.ndarray, " n"]
    """Inertia of the rotor as seen at the joint."""
    frictionloss: Float[np.ndarray, " n"]
    """Dry friction torque."""
    set_points: Float[np.ndarray, "n 2"] | None = None
    """Least and greatest set point (n, 2), infinite where there is no limit; None: none at all. Set points of a
    coupled group are sums of ratio x set point over its joints, the same for all of them."""

    __repr__ = brief


def contacts(
    toml: HandToml,
    solid: Collection[str],
    joints: Sequence[Joint],
    outside: Collection[str],
    closing: Collection[LinkPair] = (),
    folded: Mapping[str, str] | None = None,
) -> tuple[tuple[Contact, ...], bool, list[str]]:
    """Contact links, whether they are guessed, and notes on them.

    Args:
        toml: What hand.toml says.
        solid: Links with collision geometry.
        joints: Joints of the hand.
        outside: Links that it leaves out.
        closing: Pairs of links that close chains: one of each is no fingertip.
        folded: Ends of branches that fold back, and the link of each that is farthest out, as of `folded_links`.
    """
    where = f"{toml.path}: [[contact]]"
    named: list[Contact] = []
    notes: list[str] = []
    for contact in toml.contacts:
        if not _valid(contact.link, "link with collision geometry", solid, outside, where):
            notes.append(f"contact link '{contact.link}' is left out: it is not below the base link")
        elif any((contact.link, contact.point) == (other.link, other.point) for other in named):
            raise HandError(f"{where}: link '{contact.link}' is listed twice with the same point")
        else:
            named.append(contact)
    guessed = not named
    if guessed:
        named = list(fingertips(solid, joints, closing, folded))
        guess = ", ".join(contact.link for contact in named) or "none, no link with collision geometry moves"
        notes.append(f"contact links guessed, a hand.toml can name others: {guess}")
        above = {joint.child: joint for joint in joints}
        free = [name for name in folded or () if name in above and above[name].mimic is None]
        if free:
            notes.append(
                f"{', '.join(free)} lie beside their fingers, and joints of their own move them: a linkage whose file "
                "ties its joints by no mimic does not hold together"
            )
    return tuple(named), guessed, notes


def rest_pose(toml: HandToml, independent: Sequence[Joint], outside: Collection[str]) -> Float[np.ndarray, " n"]:
    """Rest values (n,) from hand.toml, else the middle of the range, 0 for continuous joints."""
    rest = {j.name: 0.0 if j.kind == "continuous" else (j.lower + j.upper) / 2 for j in independent}
    limits = {joint.name: (joint.lower, joint.upper) for joint in independent}
    for name, value in toml.rest_pose.items():
        where = f"{toml.path}: [rest_pose]"
        if not _valid(name, "independent joint", limits, outside, where):
            continue
        lower, upper = limits[name]
        if not lower <= value <= upper:
            raise HandError(f"{where}: {name} = {value:g} is outside its limits, {lower:g} to {upper:g}")
        rest[name] = value
    return np.array(list(rest.values()))


def actuator(toml: HandToml, independent: Sequence[Joint], outside: Collection[str]) -> Actuator:
    """Actuator settings of the joint, else the file's default, else ours; see `ACTUATOR`."""
    names = [joint.name for joint in independent]
    efforts = {joint.name: np.inf if joint.effort is None else joint.effort for joint in independent}
    columns = {}
    for key, ours in ACTUATOR.items():
        per_joint = dict(toml.actuator.get(key, {}))
        default = per_joint.pop("default", ours)
        for name in per_joint:
            _valid(name, "independent joint", names, outside, f"{toml.path}: [actuator] {key}")
        fallback = efforts if default is None else dict.fromkeys(names, default)
        if key in LEVER_POWERS and ours is not None and "default" not in toml.actuator.get(key, {}):
            fallback |= {
                j.name: ours / SLIDE_LEVER_M ** LEVER_POWERS[key] for j in independent if j.kind == "prismatic"
            }
        columns[key] = np.array([per_joint.get(name, fallback[name]) for name in names])
    return Actuator(**columns)


def coupled(toml: HandToml, independent: Sequence[Joint], outside: Collection[str]) -> tuple[Coupled, ...]:
    """The coupled groups whose joints the hand has; none of them shares a joint with another."""
    names, where = [joint.name for joint in independent], f"{toml.path}: [[coupled]]"
    groups = tuple(
        group
        for group in toml.coupled
        if all([_valid(name, "independent joint", names, outside, where) for name in group.joints])
    )
    driven = [name for group in groups for name in group.joints]
    twice = [name for name in driven if driven.count(name) > 1]
    if twice:
        raise HandError(f"{where}: joint '{twice[0]}' is in several groups")
    return groups


def mjcf_joints(toml: HandToml, movable: Collection[str], outside: Collection[str]) -> dict[str, str]:
    """Joint of the hand -> its name in the MJCF, where hand.toml gives it."""
    where = f"{toml.path}: [mjcf_joints]"
    named = {
        name: other
        for name, other in toml.mjcf_joints.items()
        if _valid(name, "movable joint", movable, outside, where)
    }
    twice = [other for other in named.values() if list(named.values()).count(other) > 1]
    if twice:
        raise HandError(f"{where}: '{twice[0]}' is listed twice")
    return named


def _valid(name: str, what: str, valid: Collection[str], outside: Collection[str], where: str) -> bool:
    """Return True if `name` is valid, False if it is in the part of the file that the hand leaves out."""
    if name not in valid and name not in outside:
        raise HandError(f"{where}: no {what} '{name}'; valid: {', '.join(valid)}")
    return name in valid
