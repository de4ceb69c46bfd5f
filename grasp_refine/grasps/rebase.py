"""Change of the base link of grasps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, Stage, match_joints
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand


def rebased(grasps: GraspSet, base_link: str, load: Callable[[str], Hand]) -> GraspSet:
    """Return the grasps with the `hand_pose` of `base_link` and the joints below it.

    Where `base_link` lies above the link that the grasps begin at, the joints between the two, which the grasps lack,
    are at rest; where it lies below, the joints between are left out. Either way every link that both hands have stays
    where it was.

    Args:
        grasps: Grasps of a hand.
        base_link: A link of the same hand.
        load: The hand below one of its links.

    Raises:
        GraspFileError: neither link hangs from the other, or the grasps are of another hand.
        HandError: no such link.
    """
    if base_link == grasps.base_link:
        return grasps
    new = load(base_link)
    upwards = grasps.base_link in new.links_by_name
    whole = new if upwards else load(grasps.base_link)
    if not upwards and base_link not in whole.links_by_name:
        raise GraspFileError(
            f"the grasps begin at link '{grasps.base_link}', from which link '{base_link}' does not hang, nor the "
            "other way round: they cannot be converted to it"
        )
    inner = Chain(whole, (grasps.base_link if upwards else base_link,))
    columns = [whole.joint_names.index(name) for name in new.joint_names]

    def moved(stage: Stage) -> Stage:
        q, _ = match_joints(grasps.at(stage), whole)
        T_object_root = transform_from_pose(stage.pose)
        T_root_link = inner(np.broadcast_to(np.eye(4), (len(q), 4, 4)), q).T_world_link[:, 0]
        T = T_object_root @ (inverse(T_root_link) if upwards else T_root_link)
        return Stage(pose_from_transform(T), q[:, columns])

    grasp = moved(grasps.grasp)
    others: dict[str, Any] = {name: moved(stage) for name, stage in grasps.other_stages.items()}
    return replace(grasps, base_link=base_link, joint_names=new.joint_names, hand_pose=grasp.pose, q=grasp.q, **others)
