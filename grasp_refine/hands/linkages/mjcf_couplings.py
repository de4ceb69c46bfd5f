"""Couplings of joints in an MJCF of the hand: tendons, joint equalities, closed chains."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.alignment import Mechanism, align
from grasp_refine.hands.files.hand_toml import Contact, Coupled
from grasp_refine.hands.files.mimics import followed
from grasp_refine.hands.files.mjcf import compile_mjcf, joints_of, matched_joints, read_mjcf
from grasp_refine.hands.files.tree import Joint, Mimic
from grasp_refine.hands.linkages.linkages import Linkage, linkage_note, linkages
from grasp_refine.hands.linkages.servos import moved_joints
from grasp_refine.hands.linkages.tendon_ties import tendon_ties
from grasp_refine.hands.linkages.transmission import transmission_compliance
from grasp_refine.hands.linkages.yielding import YieldingMode

MIN_ALIGNMENT = 1.0 - 1e-6
"""Least cosine between the ratios of two groups that are the same, up to scale and sign."""

MIN_SHARED_RANGE = 0.05
"""Least share of the smaller range of two joints over which their limits allow a tie by a tendon."""


@dataclass(frozen=True)
class Couplings:
    """Couplings between the joints of a hand in an MJCF."""

    path: Path
    """The MJCF."""
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    """Joint that follows another by an equality, by a tendon or in a closed chain -> that one."""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Joint that drives closed chains -> values at which they can be closed."""
    passive: frozenset[str] = frozenset()
    """Joints that follow in a closed chain."""
    linkages: tuple[Linkage, ...] = ()
    """Closed chains, with the names of the MJCF."""
    model: mujoco.MjModel | None = None
    """Model of the MJCF; None where it is not used."""
    ends: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that close chains, by their names in the MJCF."""
    tendons: tuple[Mapping[str, float], ...] = ()
    """Fixed tendons that an actuator drives, alone in driving their joints: joint -> coefficient."""
    single: frozenset[str] = frozenset()
    """Joints that an actuator drives directly."""
    notes: tuple[str, ...] = ()
    """Notes for the user on unused couplings."""

    def with_mimics(self, joints: Sequence[Joint], kept: Collection[str]) -> tuple[list[Joint], list[str]]:
        """Return the joints, with followers of the MJCF as mimic joints, and notes.

        Args:
            joints: Joints of the hand.
            kept: Joints that hand.toml has settings for, as for independent ones: they stay independent.
        """
        new = {name: mimic for name, mimic in self.mimics.items() if name not in kept}
        notes = [
            f"joint '{name}' follows '{mimic.joint}' in {self.path.name}, but hand.toml has settings for it: it stays "
            "independent"
            for name, mimic in self.mimics.items()
            if name in kept
        ]
        followers = {name: mimic for name, mimic in new.items() if name not in self.passive}
        if followers:
            pairs = ", ".join(f"'{name}' follows '{mimic.joint}'" for name, mimic in followers.items())
            notes.append(f"mimic joints, from {self.path.name}: {pairs}")
        joints = [replace(joint, mimic=new.get(joint.name, joint.mimic)) for joint in joints]
        return [_within(joint, self.ranges.get(joint.name)) for joint in joints], notes

    def yielding(
        self, independent: Sequence[Joint], contacts: Sequence[Contact]
    ) -> tuple[tuple[YieldingMode, ...], Float[np.ndarray, " n"] | None]:
        """Return the modes in which closed chains yield, and their compliance (n,); none without closed chains.

        The compliance is that at the joints that drive them, in rad per N m or m per N.

        Args:
            independent: The n independent joints of the hand, with the names of the MJCF.
            contacts: Its contact links.
        """
        names = [joint.name for joint in independent]
        tips = {contact.group: contact.link for contact in contacts}.values()
        driven = [linkage for linkage in self.linkages if linkage.driver in names]
        if not driven or self.model is None:
            return (), None
        compliance = np.zeros(len(names))
        for linkage in driven:
            compliance[names.index(linkage.driver)] = transmission_compliance(self.model, linkage, tips)
        return tuple(mode for linkage in driven for mode in linkage.modes), compliance

    def with_tendons(
        self, declared: tuple[Coupled, ...], joints: Sequence[Joint]
    ) -> tuple[tuple[Coupled, ...], list[str]]:
        """Return the groups of independent joints that share an actuator, hand.toml's first, and notes.

        The ratio of the first joint of a group of the MJCF is 1, so that stiffness and limit apply at that joint.

        Args:
            declared: Groups of hand.toml, whose joints are in no other group.
            joints: Joints of the hand, with the mimic joints of the MJCF.
        """
        by_name = {joint.name: joint for joint in joints}
        groups = [group for group in (_group(tendon, by_name) for tendon in self.tendons) if group is not None]
        taken = {name for group in declared for name in group.joints}
        added = [group for group in groups if not taken & set(group.joints)]
        notes = []
        if added:
            notes.append(f"joints that share an actuator, from {self.path.name}: {', '.join(map(_text, added))}")
        for group in declared:
            theirs = [_text(other) for other in groups if set(other.joints) & set(group.joints)]
            theirs += [name for name in group.joints if name in self.single]
            if theirs and not any(_same(group, other) for other in groups):
                notes.append(
                    f"hand.toml couples {_text(group)}, which counts, although actuators of {self.path.name} drive "
                    f"{', '.join(theirs)}"
                )
        return (*declared, *added), notes


def mjcf_couplings(path: Path, mechanism: Mechanism, named: Mapping[str, str]) -> Couplings:
    """Return the couplings in the MJCF file `path`, by the hand's names and signs of joints.

    An MJCF that cannot be used, or is of another hand, has none, and a note says why.

    Args:
        path: The file.
        mechanism: Joints of the hand as its own file has them.
        named: As for `matched_joints`.
    """
    try:
        spec, _, _ = read_mjcf(path)
        matched = matched_joints(mechanism, named, spec, path)
        model = compile_mjcf(spec, path)
        sign = align(mechanism, matched, model, path).sign
    except HandError as error:
        return Couplings(path, notes=(f"couplings of joints are not read from the MJCF: {error}",))
    ours = {other: name for name, other in matched.items()}
    signs = dict(zip(matched, sign.tolist(), strict=True))
    mimics, notes = _mimics(spec, model, mechanism, ours, signs)
    tied, more = _tendon_mimics(spec, model, mechanism, mimics, ours, signs, path)
    mimics |= tied
    notes += more
    driven = [actuator.target for actuator in spec.actuators if actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON]
    joint_like = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    single = {actuator.target for actuator in spec.actuators if actuator.trntype in joint_like}
    pulled = [tendon for tendon in spec.tendons if tendon.name in driven and len(joints_of(tendon)) > 1]
    users = [name for tendon in pulled for name in joints_of(tendon)]
    tendons = []
    for tendon in pulled:
        joints = joints_of(tendon)
        # Joints that the hand does not have are fixed in the simulation, and what pulls them is deleted.
        if not joints.keys() <= ours.keys():
            continue
        shared = sorted(ours[name] for name in joints if name in single or users.count(name) > 1)
        if shared:
            notes.append(f"tendon '{tendon.name}' of {path.name} is no coupling: {', '.join(shared)} has other drives")
            continue
        tendons.append({ours[name]: signs[ours[name]] * value for name, value in joints.items()})
    chained = linkages(model, {name for tendon in pulled for name in joints_of(tendon)} | single)
    notes += chained.open
    ranges, passive, kept = {}, set(), []
    for linkage in chained.linkages:
        if not {linkage.driver, *linkage.coefficients} <= ours.keys():
            continue
        driver = ours[linkage.driver]
        ends = sorted(signs[driver] * end for end in linkage.range)
        ranges[driver] = ends[0], ends[1]
        kept.append(linkage)
        notes.append(linkage_note(linkage, path.name))
        for name, coefficients in linkage.coefficients.items():
            joint = ours[name]
            if not any(each.name == joint and each.mimic is not None for each in mechanism.joints):
                mimics[joint] = _mimic(joint, driver, coefficients, signs)
                passive.add(joint)
    return Couplings(
        path,
        mimics,
        ranges=ranges,
        passive=frozenset(passive),
        linkages=tuple(kept),
        model=model,
        ends=chained.ends,
        tendons=tuple(tendons),
        single=frozenset(ours[name] for name in single & ours.keys()),
        notes=tuple(notes),
    )


def _within(joint: Joint, bounds: tuple[float, float] | None) -> Joint:
    """Return a joint with limits within `bounds`; None: the joint."""
    if bounds is None:
        return joint
    lower, upper = max(joint.lower, bounds[0]), min(joint.upper, bounds[1])
    return replace(joint, kind="revolute" if joint.kind == "continuous" else joint.kind, lower=lower, upper=upper)


def _mimics(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    mechanism: Mechanism,
    ours: Mapping[str, str],
    signs: Mapping[str, float],
) -> tuple[dict[str, Mimic], list[str]]:
    """Return the independent joints that follow another one by an equality, with that one, and notes.

    In MuJoCo x1 - r1 = c0 + c1 (x2 - r2) + ..., with the reference positions r; values of the hand are sign x there.
    """
    by_name = {joint.name: joint for joint in mechanism.joints}
    found: dict[str, Mimic] = {}
    notes = []
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT or not equality.active or equality.name1 not in ours:
            continue
        follower, leader = ours[equality.name1], ours.get(equality.name2)
        # The URDF's count; the MJCF's are the same for what it simulates.
        if by_name[follower].mimic is not None:
            continue
        polynomial = np.polynomial.Polynomial(np.asarray(equality.data)[:5])
        if leader is None or polynomial.coef[1] == 0.0:
            notes.append(f"joint '{follower}' is tied in the MJCF by an equality that is no function of another joint")
            continue
        if followed(by_name[leader], by_name).joint == follower:
            notes.append(f"joint '{follower}' is tied in the MJCF to '{leader}', which follows it already")
            continue
        r1, r2 = (model.qpos0[model.joint(name).qposadr[0]] for name in (equality.name1, equality.name2))
        here = r1 + polynomial(np.polynomial.Polynomial([-r2, 1.0]))
        values = here.coef.tolist()
        mimic = _mimic(follower, leader, values if any(polynomial.coef[2:]) else values[:2], signs)
        found[follower] = mimic
        by_name[follower] = replace(by_name[follower], mimic=mimic)
    return found, notes


def _mimic(follower: str, leader: str, coefficients: Sequence[float], signs: Mapping[str, float]) -> Mimic:
    """Return the coupling of the hand's joints that are a polynomial of each other in the MJCF, the constant first."""
    offset, multiplier, *higher = (
        signs[follower] * signs[leader] ** power * value for power, value in enumerate(coefficients)
    )
    return Mimic(leader, multiplier, offset, tuple(higher))


def _tendon_mimics(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    mechanism: Mechanism,
    mimics: Mapping[str, Mimic],
    ours: Mapping[str, str],
    signs: Mapping[str, float],
    path: Path,
) -> tuple[dict[str, Mimic], list[str]]:
    """Return the independent joints that tendons tie to another one, with that one, and notes.

    Ties that the limits of the joints do not allow are left out: real files have such, and MuJoCo keeps neither.
    """
    by_name = {joint.name: replace(joint, mimic=mimics.get(joint.name, joint.mimic)) for joint in mechanism.joints}
    found: dict[str, Mimic] = {}
    notes = []
    for tie in tendon_ties(spec, model, moved_joints(spec)):
        if not {tie.follower, tie.leader} <= ours.keys():
            continue
        follower, leader = ours[tie.follower], ours[tie.leader]
        if by_name[follower].mimic is not None or followed(by_name[leader], by_name).joint == follower:
            continue
        mimic = _mimic(follower, leader, (tie.offset, tie.multiplier), signs)
        if not _has_room(mimic, by_name[leader], by_name[follower]):
            notes.append(
                f"tendon '{tie.tendon}' of {path.name} is no coupling: the limits of '{follower}' and '{leader}' do "
                "not allow it"
            )
            continue
        found[follower] = mimic
        by_name[follower] = replace(by_name[follower], mimic=mimic)
        if tie.play:
            notes.append(
                f"tendon '{tie.tendon}' leaves joint '{follower}' {np.degrees(tie.play):.0f} degrees either way from "
                f"where it follows '{leader}'"
            )
    return found, notes


def _has_room(mimic: Mimic, leader: Joint, follower: Joint) -> bool:
    """Return True if a joint can move while one that follows it keeps within its limits."""
    ends = sorted(mimic.multiplier * value + mimic.offset for value in (leader.lower, leader.upper))
    room = min(ends[1], follower.upper) - max(ends[0], follower.lower)
    return bool(room >= MIN_SHARED_RANGE * min(ends[1] - ends[0], follower.upper - follower.lower))


def _group(tendon: Mapping[str, float], joints: Mapping[str, Joint]) -> Coupled | None:
    """Return the independent joints that a tendon pulls, in ratio; None if it pulls only one."""
    ratio: dict[str, float] = {}
    for name, coefficient in tendon.items():
        leads = followed(joints[name], joints)
        ratio[leads.joint] = ratio.get(leads.joint, 0.0) + coefficient * leads.multiplier
    ratio = {name: value for name, value in ratio.items() if value}
    if len(ratio) < 2:
        return None
    first = next(iter(ratio.values()))
    return Coupled(tuple(ratio), tuple(value / first for value in ratio.values()))


def _same(a: Coupled, b: Coupled) -> bool:
    """Return True if two groups have the same joints, in the same ratio."""
    ratio = dict(zip(b.joints, b.ratio, strict=True))
    if set(a.joints) != ratio.keys():
        return False
    u, v = np.array(a.ratio), np.array([ratio[name] for name in a.joints])
    return bool(abs(u @ v) >= MIN_ALIGNMENT * np.linalg.norm(u) * np.linalg.norm(v))


def _text(group: Coupled) -> str:
    ratio = "" if set(group.ratio) == {1.0} else f" ({' : '.join(f'{value:g}' for value in group.ratio)})"
    return " + ".join(group.joints) + ratio
