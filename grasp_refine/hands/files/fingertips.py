"""Fingertips of a hand: the links at the ends of its branches, which are meant to touch the object."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from grasp_refine.hands.files.finger_names import finger_names
from grasp_refine.hands.files.hand_toml import Contact
from grasp_refine.hands.files.tree import Joint, LinkPair, joints_above, rigid_parts

PAD_NAMES = r"pad|tip"
"""Pattern of the names of links that are meant to touch."""

BAR_NAMES = r"knuckle|coupler|crank|rocker"
"""Pattern of the names of links that carry fingers, or move them, and are none where a branch ends with them."""


def branch_ends(solid: Collection[str], joints: Sequence[Joint]) -> list[str]:
    """Return the last solid link of each branch, in the order of `solid`.

    Links fixed to the base are no branch, and links fixed to one with moving ones further on, such as a sensor on
    a phalanx, ends none.

    Args:
        solid: Links with collision geometry.
        joints: Joints of the hand, parents before children.
    """
    part = rigid_parts(joints)
    inner, carriers = set(), set()
    for name in solid:
        for joint in joints_above(name, joints):
            inner.add(joint.parent)
            if joint.movable:
                carriers.add(part[joint.parent])
    moving = {joint.child for joint in joints if joint.movable}
    return [name for name in solid if part.get(name) in moving and name not in inner and part[name] not in carriers]


def fingertips(
    solid: Collection[str],
    joints: Sequence[Joint],
    closing: Collection[LinkPair] = (),
    folded: Mapping[str, str] | None = None,
) -> tuple[Contact, ...]:
    """Return the ends of the branches that are fingers: all solid links of the last rigid part, in one group.

    A pad may be behind the link that it is fixed to; which of them touches depends on the grasp. Where two branches
    close a chain, the one that ends there is no finger, or that with fewer links to the base. An end that folds back is
    none: the outermost part is, of it the pads by name, if any. Nor is a knuckle, by name, beside two others.

    Args:
        solid: Links with collision geometry.
        joints: Joints of the hand, parents before children.
        closing: Pairs of links that close chains.
        folded: End of a branch that folds back -> first link of the part that is farthest out, as of `folded_links`.
    """
    folded = folded or {}
    ends = branch_ends(solid, joints)
    # The names from the link to the base.
    way = {end: [name for joint in joints_above(end, joints) for name in (joint.child, joint.name)] for end in ends}
    bars = set()
    for pair in closing:
        closers = sorted((name for name in pair if name in ends), key=lambda name: len(way[name]))
        if closers and len(closers) < len({*pair} & {*solid}) or len({len(way[name]) for name in closers}) == 2:
            bars.add(closers[0])
    part = rigid_parts(joints)
    named = {name for name in ends if re.search(BAR_NAMES, name.lower()) and name not in folded}
    if len({part[name] for name in ends if name not in named | bars}) >= 2:
        bars |= named
    outer: dict[str, list[str]] = {}
    for farthest in folded.values():
        solids = [name for name in solid if part.get(name) == farthest]
        outer[farthest] = [name for name in solids if re.search(PAD_NAMES, name.lower())] or solids
    tips = [tip for name in ends if name not in bars for tip in (outer[folded[name]] if name in folded else [name])]
    way |= {name: [each for joint in joints_above(name, joints) for each in (joint.child, joint.name)] for name in tips}
    first = {part[name]: name for name in reversed(tips)}
    fingers = finger_names([way[name] for name in first.values()])
    group = {each: finger or first[each] for each, finger in zip(first, fingers, strict=True)}
    touching = [name for name in solid if part.get(name) in group and name in outer.get(part[name], [name])]
    return tuple(Contact(name, group[part[name]]) for name in touching)


def are_two_fingers(contacts: Sequence[Contact]) -> bool:
    """Return True if contact links are of two fingers."""
    return len({contact.group for contact in contacts}) == 2
