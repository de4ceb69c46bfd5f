"""Distances between the fingertips of the same grasps in two sets, for instance before and after a file was written."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose, transform_points
from grasp_refine.grasps.formats.format import Load
from grasp_refine.grasps.formats.grippers import without_follower
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand

MAX_DIFFERENCE_M = 1e-6
"""Largest distance of a fingertip, metres, at which a written grasp is read as the same."""


class DisagreementError(GraspFileError):
    """A written file that is read as other grasps."""


def check_agreement(before: GraspSet, after: GraspSet, load: Load) -> float:
    """Return the largest distance in metres of a fingertip of the grasps in a written file from where it was.

    Raises:
        DisagreementError: it is above `MAX_DIFFERENCE_M`, or the numbers of grasps differ.
    """
    if len(before) != len(after):
        raise DisagreementError(f"{len(before)} grasps were written, {len(after)} are read")
    distances = fingertip_distances(before, after, load)
    worst = int(np.argmax(np.nan_to_num(distances, nan=np.inf)))
    if not distances[worst] <= MAX_DIFFERENCE_M:
        raise DisagreementError(
            f"read again, the fingertips of grasp {worst} ('{before.object[worst]}') are {distances[worst]:.3g} m from "
            f"their original positions, more than {MAX_DIFFERENCE_M:g} m"
        )
    return float(distances[worst])


def check_same(before: GraspSet, after: GraspSet) -> float:
    """Return the largest distance in metres or rad between the original poses and joints and a written file.

    It replaces `check_agreement` where the hand is unknown.

    Raises:
        DisagreementError: it is above `MAX_DIFFERENCE_M`, or hands, links or joints differ.
    """
    before, after = without_follower(before), without_follower(after)
    contents = [(grasps.hand, grasps.base_link, len(grasps), sorted(grasps.joint_names)) for grasps in (before, after)]
    if contents[0] != contents[1]:
        raise DisagreementError(f"{contents[0]} was written, {contents[1]} is read")
    columns = [after.joint_names.index(name) for name in before.joint_names]
    shared = [name for name in before.other_stages if name in after.other_stages]
    pairs = [(before.grasp, after.grasp)]
    pairs += [(before.other_stages[name], after.other_stages[name]) for name in shared]
    differences = [np.zeros(1)]
    for one, other in pairs:
        T_one, T_other = (transform_from_pose(stage.pose) for stage in (one, other))
        differences += [(T_one - T_other).ravel(), (one.q - other.q[:, columns]).ravel()]
    worst = float(np.abs(np.nan_to_num(np.concatenate(differences), nan=np.inf)).max())
    if worst > MAX_DIFFERENCE_M:
        raise DisagreementError(f"read again, poses or joints are {worst:.3g} from the original")
    return worst


def fingertip_distances(one: GraspSet, other: GraspSet, load: Load) -> Float[np.ndarray, " N"]:
    """The largest distance (N,) in metres of a fingertip in two sets of the same N grasps, object frame.

    A fingertip is a contact link of the hand, by its frame's origin and by the point that should touch; all stages
    that both sets have count.

    Raises:
        GraspFileError: the sets have joints that the hand lacks.
    """
    hands = [load(grasps.base_link) for grasps in (one, other)]
    distances = [_distances(fingertips(one, hands[0]), fingertips(other, hands[1]))]
    for name in one.other_stages.keys() & other.other_stages.keys():
        sets = [grasps.at(grasps.other_stages[name]) for grasps in (one, other)]
        distances.append(_distances(*(fingertips(*pair) for pair in zip(sets, hands, strict=True))))
    return np.max(distances, axis=0)


def fingertips(grasps: GraspSet, hand: Hand) -> Float[np.ndarray, "N points 3"]:
    """Points (N, points, 3) of the contact links of a hand in the object frame, metres.

    Raises:
        GraspFileError: the grasps have joints that the hand lacks.
    """
    q, _ = match_joints(grasps, hand)
    T_object_root = transform_from_pose(np.asarray(grasps.hand_pose, dtype=float))
    links = [contact.link for contact in hand.contacts]
    T = Chain(hand, links)(T_object_root, q).T_world_link
    points = np.array([contact.point or _middle(hand, contact.link) for contact in hand.contacts])
    return np.concatenate([T[..., :3, 3], transform_points(T, points)], axis=1)


def _middle(hand: Hand, link: str) -> tuple[float, float, float]:
    body = hand.links_by_name[link].body
    if body is None:
        return (0.0, 0.0, 0.0)
    x, y, z = np.mean([piece.vertices.mean(axis=0) for piece in body.pieces], axis=0).tolist()
    return (x, y, z)


def _distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.linalg.norm(one - other, axis=-1).max(axis=-1)
