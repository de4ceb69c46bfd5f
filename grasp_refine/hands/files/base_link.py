"""Base link of a hand where none is given: its palm, so that an arm or a wrist above it does not move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from grasp_refine.hands.files.tree import JointEntry, Tree


@dataclass(frozen=True)
class Base:
    """Base link of a hand, and the reason for its choice."""

    link: str
    """Its name."""
    above: tuple[str, ...]
    """Movable joints on the way from the root to it, which do not move."""
    why: str
    """The reason, for people."""
    others: tuple[str, ...] = ()
    """Links below it, other than itself, that several moving branches leave: each may be the intended palm."""


def guess_base(tree: Tree) -> Base:
    """Return the base link of the hand in `tree`, and the reason for it.

    Links that fixed joints connect are one part. From the root on, the first part with several moving branches that
    carry collision geometry is the palm's; links fixed to an arm, such as a camera, are no branch. Where no movable
    joint is above that part, the root is the base. Otherwise the base is the lowest link of the part above all these
    branches that something solid is fixed to. A robot that is one chain has no palm and begins at its root; so does
    one with a joint below the palm that mimics one above it.
    """
    leaving: dict[str, list[JointEntry]] = {name: [] for name in tree.links}
    for joint in tree.joints.values():
        leaving[joint.parent].append(joint)
    # Without any collision geometry, all links count.
    solid = {name for name, link in tree.links.items() if link.collisions} or set(tree.links)
    carries = {name for name in tree.links if any(link in solid for link in _below(name, leaving))}
    first, above = tree.root, []
    while True:
        part = list(_below(first, leaving, fixed=True))
        branches = [joint for link in part for joint in leaving[link] if joint.kind != "fixed"]
        branches = [joint for joint in branches if joint.child in carries]
        if len(branches) != 1:
            break
        above.append(branches[0].name)
        first = branches[0].child
    if not branches:
        return Base(tree.root, (), "it is the root; no link further on has two moving branches, as a palm has")
    others = _palms([joint.child for joint in branches], leaving, carries, solid)
    if not above:
        why = f"it is the root, and {len(branches)} moving branches leave what is fixed to it"
        return Base(tree.root, (), why, others)
    base = _lowest(first, part, {joint.parent for joint in branches}, solid, leaving)
    below = {joint.name for link in _below(base, leaving) for joint in leaving[link]}
    for name in below:
        mimic = tree.joints[name].mimic
        if mimic is not None and mimic.joint in tree.joints and mimic.joint not in below:
            why = f"it is the root; joint '{name}' mimics '{mimic.joint}' above the palm '{base}'"
            return Base(tree.root, (), why, others)
    why = f"it is the palm: {len(branches)} moving branches leave it, one chain leads to it"
    return Base(base, tuple(above), why, others)


def _palms(
    firsts: list[str], leaving: dict[str, list[JointEntry]], carries: set[str], solid: set[str]
) -> tuple[str, ...]:
    """The palms of the parts at or below some links that several moving branches with something solid leave."""
    palms = []
    for first in firsts:
        part = list(_below(first, leaving, fixed=True))
        moving = [joint for link in part for joint in leaving[link] if joint.kind != "fixed"]
        branches = [joint for joint in moving if joint.child in carries]
        if len(branches) > 1:
            palms.append(_lowest(first, part, {joint.parent for joint in branches}, solid, leaving))
        palms += _palms([joint.child for joint in branches], leaving, carries, solid)
    return tuple(palms)


def _below(link: str, leaving: dict[str, list[JointEntry]], *, fixed: bool = False) -> Iterator[str]:
    """`link` and all links below it, or only links that fixed joints connect to it; parents before children."""
    waiting = [link]
    while waiting:
        yield waiting[-1]
        waiting += [j.child for j in leaving[waiting.pop()][::-1] if j.kind == "fixed" or not fixed]


def _lowest(
    first: str, part: list[str], parents: set[str], solid: set[str], leaving: dict[str, list[JointEntry]]
) -> str:
    """The lowest link of `part`, which begins at `first`, that is above all `parents` and has something solid."""
    base = first
    for link in part:  # parents before children, so that the last one that fits is the lowest
        inside = set(_below(link, leaving, fixed=True))
        if parents <= inside and (inside & solid or not solid & set(part)):
            base = link
    return base
