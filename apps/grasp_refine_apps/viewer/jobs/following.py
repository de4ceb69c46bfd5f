"""Fingers that follow the mouse: inverse kinematics of the joints of a link, stopped by the object and other links."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from grasp_refine.closing.stopped import close_until_stopped
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.link_pairs import LinkPairs, link_pairs
from grasp_refine.hands.self_collision import touching_pairs
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


LINK_TOLERANCE_M = 1e-6
"""Distance in metres by which links may be deeper in each other than before: errors of queries."""


def draggable_links(prepared: HandObject) -> frozenset[str]:
    """Return the links that can touch and are moved by a joint that does not carry all fingers."""
    fingers = ~Frozen.of(prepared.hand, (PALM,)).joints
    return frozenset(np.array(prepared.chain.links)[prepared.chain.moves[:, fingers].any(axis=1)].tolist())


@dataclass(frozen=True)
class _Links:
    """Overlaps of the links of a hand with each other."""

    pairs: LinkPairs
    """Pairs of links that can touch."""
    index: Int[np.ndarray, "2 P"]
    """Indices of their links in the chain of the hand and the object."""
    size: int
    """Number of links of that chain, and of further ones, which no finger moves."""

    @staticmethod
    def of(prepared: HandObject) -> _Links:
        """Prepare the pairs of a hand."""
        links = list(prepared.chain.links)
        pairs = link_pairs(prepared.hand, touching_pairs(prepared.hand))
        links += [name for name in pairs.chain.links if name not in links]
        names = np.array(pairs.chain.links, dtype=object)
        index = [[links.index(name) for name in names[side]] for side in (pairs.first, pairs.second)]
        return _Links(pairs, np.array(index, dtype=int), len(links))

    def overlap(self, q: Float[np.ndarray, "R n"]) -> Float[np.ndarray, "R P"]:
        """Return the depths (R, P) of the pairs in each other, 0 where they are apart, metres."""
        return np.maximum(-np.nan_to_num(self.pairs.distances(q, 0.0)), 0.0)

    def deeper(
        self,
        rows: Int[np.ndarray, " R"],
        q: Float[np.ndarray, "R n"],
        T_link: Float[np.ndarray, "R L 4 4"],
        than: Float[np.ndarray, " P"],
    ) -> Bool[np.ndarray, "R L"]:
        """Return which of the first L links are deeper in another one than these depths (P,); an `Obstruction`."""
        found = np.zeros((len(q), self.size), dtype=bool)
        row, pair = np.nonzero(self.overlap(q) > than + LINK_TOLERANCE_M)
        for side in self.index:
            found[row, side[pair]] = True
        return found[:, : T_link.shape[1]]


def follow(prepared: HandObject, scene: Scene, pose: Pose, wanted: Target) -> Pose:
    """Return the pose that brings a point of a link as near to a point as its finger and the object let it.

    The palm, arm and wrist, and the joints that do not move the link, stay to the last bit. Joints move from where they
    are to the solution of `GraspProblem.solve_position_ik`, until a link that they move touches the object or another
    link, or would be deeper in it than it is. At the object the point goes on along the surface, and towards it again.

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
    links = _Links.of(prepared)
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
        obstruction = partial(links.deeper, than=links.overlap(q)[0])
        share = close_until_stopped(prepared, T, q, end.q, depth, obstruction)
        q = np.where(share == 1.0, end.q, q + share * (end.q - q))
        T_link = chain(T, q).T_world_link
    return Pose(pose.T_object_root, q[0])
