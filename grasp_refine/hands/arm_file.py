"""Arms that carry hands, read from their files: a gripper at the end of one is cut off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from grasp_refine.core.array_records import take
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.files.base_link import guess_base
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.link_geometry import HULL_LIMIT
from grasp_refine.hands.hand import Hand, load_hand


def load_arm(
    source: str | Path,
    *,
    candidates: int = 1024,
    hull_limit: float = HULL_LIMIT,
    progress: Callable[[str], None] | None = None,
) -> Hand:
    """Return the arm that `source` names, for `mount`, from its base on and without a gripper of its own, with a note.

    Args:
        source: Name or path, as for `load_hand`.
        candidates: Surface points per link, as there.
        hull_limit: Distance by which hulls may stand out of meshes, as there.
        progress: Called with a line on each download, as there.

    Raises:
        AssetError: no such name, or an asset that cannot be fetched.
        HandError: a file is missing or malformed.
        GraspRefineError: an argument of another kind.
    """
    arm = load_hand(source, candidates=candidates, hull_limit=hull_limit, progress=progress)
    tree = read_tree(arm.urdf)
    palm = guess_base(tree)
    if not palm.above:
        return arm
    if arm.base_link == palm.link:
        arm = load_hand(source, base_link=tree.root, candidates=candidates, hull_limit=hull_limit, progress=progress)
    return without(arm, palm.link) if palm.link in arm.links_by_name else arm


def without(arm: Hand, link: str) -> Hand:
    """Return an arm without a link and all that hangs from it, as its gripper, and a note on that."""
    cut = {link}
    for joint in arm.joints:  # parents before children
        cut |= {joint.child} if joint.parent in cut else set()
    joints = tuple(joint for joint in arm.joints if joint.child not in cut)
    above = next(joint.parent for joint in arm.joints if joint.child == link)
    known = {joint.name for joint in joints}
    kept = np.array([name in known for name in arm.joint_names], dtype=bool)
    links = tuple(one for one in arm.links if one.name not in cut)
    solids = tuple(one.name for one in links if one.body is not None)
    lost = [one.name for one in arm.joints if one.child in cut and one.movable]
    notes = [note for note in arm.notes if not any(f"'{name}'" in note for name in (*cut, *lost))]
    notes.append(
        f"the gripper of its file, {count_text(len(cut), 'link')} from '{link}' on, is cut off at '{above}', which "
        "carries the hand instead"
    )
    return replace(
        arm,
        links=tuple(replace(one, solids=solids) for one in links),
        joints=joints,
        joint_names=tuple(name for name in arm.joint_names if name in known),
        lower=arm.lower[kept],
        upper=arm.upper[kept],
        rest=arm.rest[kept],
        contacts=tuple(contact for contact in arm.contacts if contact.link not in cut),
        notes=tuple(notes),
        actuator=take(arm.actuator, kept),
        modes=(),
        compliance=None if arm.compliance is None else arm.compliance[kept],
        coupled=tuple(group for group in arm.coupled if set(group.joints) <= known),
        excluded=None if arm.excluded is None else tuple(pair for pair in arm.excluded if not cut & set(pair)),
        mount=arm.mount if arm.mount not in cut else above,
    )
