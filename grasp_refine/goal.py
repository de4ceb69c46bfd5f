"""What is wanted of the grasps of a scene: which links should touch the object, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.chain import Chain
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.scene import Scene
from grasp_refine.targets import Touching, nearest_points

POINT = 1e-6
"""Radius in metres of the balls that stand for target points."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Which of the L links of a scene should touch the object in each of N grasps, and where."""

    touching: np.ndarray
    """Links (N, L) that should touch."""
    target_link: np.ndarray
    """Where on the link (N, L, 3), link frames, metres; NaN: anywhere."""
    target_object: np.ndarray
    """Where on the object (N, L, 3), object frame; NaN: anywhere."""
    queries: np.ndarray
    """Narrow-phase queries (N,) that it took to find out."""
    off_surface: np.ndarray
    """Smallest loss (N,) in m^2 that targets can have which lie off their surfaces, by their distances from these."""
    direction: np.ndarray | None = None
    """Wanted unit normals from link to object (N, L, 3), object frame; NaN: any. None: none is wanted."""

    @property
    def aimed(self) -> np.ndarray:
        """Links (N, L) with a target."""
        return ~np.isnan(self.target_link[..., 0])


def goal_of(scene: Scene, touching: Touching, *, nearest: bool = False) -> Goal:
    """The goal of a scene: its targets if it has any, else that the links which are near the object touch it.

    Args:
        scene: Hand, object, grasps and, perhaps, targets.
        touching: Which links touch where there are no targets.
        nearest: Without targets, those links should touch at their present witness points, and not just anywhere.
    """
    if scene.target_link is not None and scene.target_object is not None:
        given = scene.target_link, scene.target_object
        # A point on one side only is no target.
        missing = np.logical_or(*(np.isnan(target).any(axis=-1, keepdims=True) for target in given))
        target_link, target_object = (np.where(missing, np.nan, target) for target in given)
        none, off = np.zeros(len(scene.q), dtype=np.int64), _off_surface(scene, target_link, target_object)
        return Goal(~missing[..., 0], target_link, target_object, none, off, scene.direction)
    witness, T = _at_start(scene, touching)
    chosen = touching.choose(scene.hand, scene.links, witness)
    target_link, target_object = np.full((2, *chosen.shape, 3), np.nan)
    if nearest:
        target_link, target_object = nearest_points(witness, T, np.broadcast_to(np.eye(4), T.shape), chosen)
    on_surface = np.zeros(len(scene.q))
    return Goal(chosen, target_link, target_object, witness.asked.sum(axis=1), on_surface, scene.direction)


def _off_surface(scene: Scene, target_link: np.ndarray, target_object: np.ndarray) -> np.ndarray:
    """Sums (N,) of the squared distances of all targets from the surfaces of their bodies, in m^2."""
    bodies = [scene.hand.links_by_name[name].body for name in scene.links]
    point = build_body("target", [sphere(POINT)], candidates=16)
    total = np.zeros(len(target_link))
    columns = np.flatnonzero(~np.isnan(target_link[..., 0]).all(axis=0))
    if not len(columns):
        return total
    for targets, others in ((target_link, [bodies[c] for c in columns]), (target_object, [scene.object.body])):
        pairs = Pairs.against(others, point)
        pairs = Pairs(pairs.a * (len(columns) // len(others)), pairs.b * (len(columns) // len(others)))
        T = np.broadcast_to(np.eye(4), (*targets[:, columns].shape[:2], 4, 4)).copy()
        T[..., :3, 3] = targets[:, columns]
        found = query(pairs, np.broadcast_to(np.eye(4), T.shape), T)
        total += np.where(found.valid, (found.distance + POINT) ** 2, 0.0).sum(axis=1)
    return total


def _at_start(scene: Scene, touching: Touching) -> tuple[Witness, np.ndarray]:
    """Witness points of the links that may touch, and the poses (N, L, 4, 4) of all, at the initial grasps."""
    bodies = scene.hand.links_by_name
    pairs = Pairs.against([bodies[name].body for name in scene.links], scene.object.body)
    with np.errstate(invalid="ignore"):
        T = Chain(scene.hand, scene.links)(scene.T_world_root, scene.q).T_world_link
    cutoff = touching.cutoff(scene.hand, scene.links)
    return query(pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff), T
