"""Comparison of the open grasps with others, number by number: the other grasp as a ghost, and its numbers."""

from __future__ import annotations

from math import degrees

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import distances
from grasp_refine.measures.measures import MEASURES
from grasp_refine_apps.viewer.meters.meter import ContactMeter
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.contacts import distances_text
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.state import State

QUALITY = MEASURES["quality"]
"""Measure that is shown where the file has it."""


def check_comparable(collection: Collection, other: Collection) -> None:
    """Refuse grasps of another hand.

    Raises:
        GraspRefineError: names both hands.
    """
    hands = [(each.hand.name, each.hand.base_link, each.hand.joint_names) for each in (collection, other)]
    if hands[0] != hands[1]:
        raise GraspRefineError(
            f"{other.title}: its hand cannot be compared with '{collection.hand.name}': other joints, or another base "
            "link; compare grasps of one hand"
        )


def compared_pose(state: State) -> Pose | None:
    """Return the pose of the compared grasp of the same number, in the object's frame; None: there is none."""
    compared, number = state.compared, state.number
    if compared is None or number >= len(compared.collection):
        return None
    other, ours = compared.collection.group(number), state.collection.group(number)
    if (other.object, other.scale) != (ours.object, ours.scale):
        return None
    work = compared.works.get(number)
    pose = compared.collection.pose(number) if work is None else work.standing
    return pose if pose.posed else None


def compared_text(state: State, contacts_of: ContactMeter) -> str:
    """Return the numbers of the compared grasp in one line; empty: nothing is compared."""
    compared, number = state.compared, state.number
    if compared is None:
        return ""
    collection, pose = compared.collection, compared_pose(state)
    name = _name(collection, state.collection)
    if pose is None:
        if number >= len(collection):
            return f"{name}: has no grasp of this number, only {len(collection)}"
        return f"{name}: its grasp of this number is {collection.label(number)}, which cannot be compared"
    found = contacts_of.at(collection.scene(number), pose, collection.recorded(number))
    parts = [distances_text(found.contact_error, found.penetration)]
    work, column = compared.works.get(number), collection.columns.get(QUALITY.entries["after"])
    if column is not None and column.known[number] and (work is None or not work.changed):
        parts.append(f"{QUALITY.title} {column.text(number)}")
    (moved,), (turned,) = distances(state.standing.T_object_root[None], pose.T_object_root[None])
    parts.append(f"{1e3 * moved:.1f} mm and {degrees(turned):.1f}° away")
    return f"{name}: {', '.join(parts)}"


def _name(collection: Collection, ours: Collection) -> str:
    """Name of compared grasps: that of their file, with its folder where our file has the same."""
    paths = [next(iter(each.problem.files), None) for each in (collection, ours)]
    if paths[0] is None:
        return collection.title
    same = paths[1] is not None and paths[0].name == paths[1].name
    return "/".join(paths[0].parts[-2:]) if same else paths[0].name
