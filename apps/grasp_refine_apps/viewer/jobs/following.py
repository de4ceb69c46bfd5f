"""Fingers that follow the mouse: inverse kinematics of the joints that move a link, stopped by the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.closing.stopped import close_until_stopped
from grasp_refine.core.se3 import transform_points
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.frozen import PALM, Frozen
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.model.pose import Pose, Target, posed_scene

SLIDE_M = 1e-3
"""Distance in metres from the object below which a stopped link slides, and at which it does, over facets."""


def draggable_links(prepared: HandObject) -> frozenset[str]:
    """Return the links that can touch and are moved by a joint that does not carry all fingers."""
    fingers = ~Frozen.of(prepared.hand, (PALM,)).joints
    return frozenset(np.array(prepared.chain.links)[prepared.chain.moves[:, fingers].any(axis=1)].tolist())


def follow(prepared: HandObject, scene: Scene, pose: Pose, wanted: Target) -> Pose:
    """Return the pose that brings a point of a link as near to a point as its finger and the object let it.

    The palm, arm and wrist, and the joints that do not move the link, stay to the last bit. Joints move from where they
    are to the solution of `GraspProblem.solve_position_ik`, until a link that they move touches the object, or would be
    deeper in it than it is; there the point goes on along the surface, and towards it again.

    Args:
        prepared: Hand and object, to be queried.
        scene: Scene of the grasp.
        pose: Present pose.
        wanted: The link, the point on it, and the point where it should be, which need not be on the object.
    """
    chain, hand = prepared.chain, prepared.hand
    column, none = chain.links.index(wanted.link), np.zeros(1, dtype=np.int64)
    moving = chain.moves[:, chain.moves[column]].any(axis=1)
    still = np.array(hand.joint_names)[~chain.moves[column]].tolist()
    config, T, q = Config(freeze=(PALM, *still)), pose.T_object_root[None], pose.q[None]
    T_link = chain(T, q).T_world_link
    for slides in (False, True, False):
        target = wanted
        if slides:
            near = prepared.query(none, T_link, cutoff=SLIDE_M)
            distance = np.where(near.valid[0] & moving, near.distance[0], np.inf)
            if distance.min() >= SLIDE_M:
                break
            normal = near.normal[0, distance.argmin()]
            beyond = float((wanted.point_object - transform_points(T_link[0, column], wanted.point_link)) @ normal)
            target = replace(wanted, point_object=wanted.point_object - max(beyond + SLIDE_M, 0.0) * normal)
        aimed = posed_scene(scene, Pose(T[0], q[0]), (target,))
        assert aimed.target_link is not None and aimed.target_object is not None
        goal = replace(
            Goal.nothing(1, len(chain.links)), target_link=aimed.target_link, target_object=aimed.target_object
        )
        end = GraspProblem(aimed, goal, config, prepared).solve_position_ik(none, Point(T, q))
        depth = np.minimum(np.nan_to_num(prepared.query(none, T_link, cutoff=0.0).distance), 0.0)
        share = close_until_stopped(prepared, T, q, end.q, depth)
        q = np.where(share == 1.0, end.q, q + share * (end.q - q))
        T_link = chain(T, q).T_world_link
    return Pose(pose.T_object_root, q[0])
