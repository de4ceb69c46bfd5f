"""The kinematic tree of a hand: links and joints as its file has them, and joints as the program uses them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.shape import Shape

LinkPair = tuple[str, str]
"""Names of two links."""


Kind = Literal["revolute", "continuous", "prismatic", "fixed"]
"""Kinds of joints that a hand can have."""


@dataclass(frozen=True)
class Mimic:
    """Coupling of a joint to another, whose value x gives its own: offset + multiplier x + higher[0] x^2 + ..."""

    joint: str
    """Name of the joint that is followed; it may follow a further one."""
    multiplier: float
    """Rad or m of this joint per rad or m of the followed one."""
    offset: float
    """Value in rad or m of this joint where the followed one is at 0."""
    higher: tuple[float, ...] = ()
    """Coefficients of the second power and higher ones; none where the coupling is linear."""

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients of the polynomial, the constant first."""
        return self.offset, self.multiplier, *self.higher

    def value(self, x: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """Values of this joint where the followed one is at `x`."""
        if not self.higher:
            return self.multiplier * x + self.offset
        return np.polynomial.polynomial.polyval(x, np.array(self.coefficients))

    def after(self, leader: Mimic) -> Mimic:
        """Return the coupling of this joint to the one that `leader`, the coupling of the followed joint, follows."""
        if not (self.higher or leader.higher):
            offset = self.offset + self.multiplier * leader.offset
            return Mimic(leader.joint, self.multiplier * leader.multiplier, offset)
        P = np.polynomial.Polynomial
        offset, multiplier, *higher = P(self.coefficients)(P(leader.coefficients)).coef.tolist()
        return Mimic(leader.joint, multiplier, offset, tuple(higher))


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint: its child moves by q, about or along `axis`, from `T_parent_child`."""

    name: str
    """Unique name."""
    kind: Kind
    """Type of motion."""
    parent: str
    """Link towards the base."""
    child: str
    """Link that the joint carries."""
    T_parent_child: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the child in its parent where the joint is at 0."""
    axis: Float[np.ndarray, " 3"]
    """Unit axis (3,) in the child frame; zeros for a fixed joint."""
    lower: float
    """Least value in rad or m; -inf if continuous, 0 if fixed."""
    upper: float
    """Greatest value in rad or m; inf if continuous, 0 if fixed."""
    mimic: Mimic | None
    """Coupling to another joint; None if it moves independently, or is fixed."""
    effort: float | None
    """Greatest torque (Nm) or force (N); None where the file names none above 0."""
    velocity: float | None = None
    """Greatest speed in rad/s or m/s; None where the file names none above 0."""

    __repr__ = brief

    @property
    def movable(self) -> bool:
        """Whether the joint moves, independently or by following another."""
        return self.kind != "fixed"

    def motion(self, value: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch 4 4"]:
        """Transforms (..., 4, 4) of the child, in its own frame, at joint values `value` (...), rad or m."""
        step = np.asarray(value)[..., None] * self.axis
        if self.kind == "prismatic":
            return transform(np.broadcast_to(np.eye(3), (*step.shape, 3)), step)
        return transform(exp_so3(step), np.zeros_like(step))


def joints_above(link: str, joints: Sequence[Joint]) -> list[Joint]:
    """Return the joints from a link up to the base, the last one first."""
    above = {joint.child: joint for joint in joints}
    found = []
    while link in above:
        found.append(above[link])
        link = above[link].parent
    return found


def rigid_parts(joints: Sequence[Joint], moving: Collection[str] | None = None) -> dict[str, str]:
    """Return link -> the first link of its rigid part: the child of a joint that moves, or the base.

    Args:
        joints: All joints, parents before children.
        moving: Names of the moving joints; None: all movable joints.
    """
    part: dict[str, str] = {}
    for joint in joints:
        own = part.setdefault(joint.parent, joint.parent)
        part[joint.child] = joint.child if (joint.movable if moving is None else joint.name in moving) else own
    return part


@dataclass(frozen=True, eq=False)
class LinkEntry:
    """A link as its file has it."""

    name: str
    """Name."""
    collisions: tuple[Shape, ...] = ()
    """Collision geometry."""
    mass: float | None = None
    """Mass in kg; None where the file gives none."""
    inertia: Inertia | None = None
    """Mass, centre and moments, not necessarily physical; None where it has no moments."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class JointEntry:
    """A joint as its file has it: values are finite, but not checked otherwise."""

    name: str
    """Name."""
    kind: str
    """Type of motion, in the words of URDF; others for types that no hand can have."""
    parent: str
    """Link towards the base."""
    child: str
    """Link that the joint carries."""
    T_parent_child: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) of the child in its parent where the joint is at 0."""
    axis: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    """Axis (3,) in the child frame, of any length."""
    lower: float | None = None
    """Lower limit in rad or m."""
    upper: float | None = None
    """Upper limit in rad or m."""
    effort: float | None = None
    """Greatest torque (Nm) or force (N)."""
    velocity: float | None = None
    """Greatest speed in rad/s or m/s."""
    mimic: Mimic | None = None
    """Coupling to another joint."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Tree:
    """The links and joints of the file of a hand, checked to form one tree."""

    path: Path
    """The file."""
    root: str
    """The only link without a parent."""
    links: dict[str, LinkEntry]
    """Links by name, in file order."""
    joints: dict[str, JointEntry]
    """Joints by name, in file order."""
    excluded: tuple[LinkPair, ...] = ()
    """Pairs of links that never collide, by the file."""
    notes: tuple[str, ...] = ()
    """Notes for the user on parts that were not read."""

    __repr__ = brief

    @classmethod
    def of(cls, path: Path, links: Sequence[LinkEntry], joints: Sequence[JointEntry]) -> Tree:
        """Return the tree of links and joints of the file `path`.

        Raises:
            HandError: a name occurs twice, or they are not one tree.
        """
        for what, names in (("links", [link.name for link in links]), ("joints", [joint.name for joint in joints])):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise HandError(f"{path}: several {what} have the name '{twice[0]}'")
        by_name, joint_by_name = {link.name: link for link in links}, {joint.name: joint for joint in joints}
        return cls(path, _root(path, by_name, joint_by_name), by_name, joint_by_name)

    def below(self, base_link: str) -> tuple[list[LinkEntry], list[Joint]]:
        """Links (the base first) and joints (parents before children) of the tree below `base_link`.

        The rest is not checked, so that errors in it do not matter.

        Raises:
            HandError: there is no such link, or a joint below it is not one that a hand can have.
        """
        if base_link not in self.links:
            raise HandError(f"{self.path}: no link '{base_link}'; its links: {', '.join(self.links)}")
        leaving: dict[str, list[JointEntry]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            leaving[joint.parent].append(joint)
        joints, waiting = [], leaving[base_link][::-1]
        while waiting:
            joints.append(_joint(waiting.pop(), self.path))
            waiting += leaving[joints[-1].child][::-1]
        self._check_mimics({joint.name: joint for joint in joints}, base_link)
        return [self.links[name] for name in (base_link, *(joint.child for joint in joints))], joints

    def _check_mimics(self, joints: dict[str, Joint], base_link: str) -> None:
        for name in joints:
            chain = [name]
            while (mimic := joints[chain[-1]].mimic) is not None:
                where = f"{self.path}: joint '{chain[-1]}' mimics '{mimic.joint}'"
                if mimic.joint not in self.joints:
                    raise HandError(f"{where}, which does not exist; its joints: {', '.join(self.joints)}")
                if mimic.joint not in joints:
                    raise HandError(f"{where}, which is not below the base link '{base_link}'")
                if not joints[mimic.joint].movable:
                    raise HandError(f"{where}, which is fixed")
                if mimic.joint in chain:
                    raise HandError(f"{where}, which makes a cycle: {' -> '.join([*chain, mimic.joint])}")
                chain.append(mimic.joint)


def _root(path: Path, links: dict[str, LinkEntry], joints: dict[str, JointEntry]) -> str:
    if not links:
        raise HandError(f"{path}: has no links")
    above: dict[str, JointEntry] = {}
    for joint in joints.values():
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise HandError(
                    f"{path}: joint '{joint.name}' has the {role} link '{link}', which does not exist; "
                    f"its links: {', '.join(links)}"
                )
        if joint.child in above:
            raise HandError(
                f"{path}: link '{joint.child}' is the child of two joints, "
                f"'{above[joint.child].name}' and '{joint.name}'"
            )
        above[joint.child] = joint
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        raise HandError(f"{path}: {len(roots)} links have no parent, one is allowed: {', '.join(roots)}")
    connected = set(roots)
    for name in links:
        chain = [name]
        while chain[-1] not in connected:
            chain.append(above[chain[-1]].parent)
            if chain[-1] in chain[:-1]:
                cycle = chain[chain.index(chain[-1]) :]
                raise HandError(f"{path}: links form a cycle: {' -> '.join(cycle[::-1])}")
        connected.update(chain)
    return roots[0]


def _joint(raw: JointEntry, path: Path) -> Joint:
    where = f"{path}: joint '{raw.name}'"
    if raw.kind in ("floating", "planar", "ball"):
        raise HandError(
            f"{where} is {raw.kind}, which is not supported; a hand's root moves freely anyway: "
            f"choose a base_link below it, such as '{raw.child}'"
        )
    kind: Kind | None = next((kind for kind in get_args(Kind) if kind == raw.kind), None)
    if kind is None:
        raise HandError(f"{where} has the type '{raw.kind}'; valid: {', '.join(get_args(Kind))}")
    axis, mimic = np.zeros(3), None
    if raw.kind != "fixed":
        with np.errstate(over="ignore"):
            length = float(np.linalg.norm(raw.axis))
        if not 1e-9 < length < 1e9:
            raise HandError(f"{where} has the axis {raw.axis.tolist()}, which is no direction")
        axis, mimic = raw.axis / length, raw.mimic
    lower, upper = _limits(raw, where)
    # Some exporters write effort 0, or velocity 0, where they do not know it.
    effort, velocity = (value if value is not None and value > 0 else None for value in (raw.effort, raw.velocity))
    return Joint(raw.name, kind, raw.parent, raw.child, raw.T_parent_child, axis, lower, upper, mimic, effort, velocity)


def _limits(raw: JointEntry, where: str) -> tuple[float, float]:
    if raw.kind == "fixed":
        return 0.0, 0.0
    if raw.kind == "continuous":
        return -np.inf, np.inf
    if raw.lower is None or raw.upper is None:
        hint = "; without limits its type would be continuous" if raw.kind == "revolute" else ""
        raise HandError(f"{where} is {raw.kind} and needs limits, lower and upper{hint}")
    if raw.lower > raw.upper:
        raise HandError(f"{where} has reversed limits: lower {raw.lower:g} is above upper {raw.upper:g}")
    return raw.lower, raw.upper
