"""Grasps by the names of another file of the same hand, which has a prefix before its joints and links."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.files.prefixed_names import prefixed_names


def with_prefixes(grasps: GraspSet, links: Collection[str], joints: Collection[str]) -> GraspSet | None:
    """Return the grasps by the names of a hand; None where a name is not found there, or several times.

    Args:
        grasps: Grasps with the joints and links of the hand, up to a prefix.
        links: Names of the hand's links.
        joints: Names of its joints.
    """
    base = prefixed_names(grasps.base_link, links)
    columns = [prefixed_names(name, joints) for name in grasps.joint_names]
    recorded = grasps.contact_links
    touching = (
        {} if recorded is None else {name: prefixed_names(name, links) for name in set(recorded.name.flat) - {""}}
    )
    aimed = [] if grasps.targets is None else [prefixed_names(name, links) for name in grasps.targets.links]
    if any(len(found) != 1 for found in (base, *columns, *aimed, *touching.values())):
        return None
    names = tuple(name for (name,) in columns)
    targets = None if grasps.targets is None else replace(grasps.targets, links=tuple(name for (name,) in aimed))
    if recorded is not None:
        renamed = [touching[name][0] if name else "" for name in recorded.name.flat]
        recorded = replace(recorded, name=np.array(renamed, dtype=str).reshape(recorded.name.shape))
    return replace(grasps, base_link=base[0], joint_names=names, targets=targets, contact_links=recorded)
