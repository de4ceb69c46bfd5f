"""Goal of the grasps of a scene: the links that should touch the object, and their target points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import Witness, query_items
from grasp_refine.core.short_repr import brief
from grasp_refine.scene.contact_links import contact_gaps
from grasp_refine.scene.contact_selection import ContactSelection, nearest_points
from grasp_refine.scene.hand_object import POINT, HandObject
from grasp_refine.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Goal:
    """Goal of N grasps: which of the L links of a scene should touch the object, and where."""

    touching: np.ndarray
    """Links (N, L) that should touch."""
    target_link: np.ndarray
    """Target points on the links (N, L, 3), link frames, metres; NaN: anywhere."""
    target_object: np.ndarray
    """Target points on the object (N, L, 3), object frame, metres; NaN: anywhere."""
    queries: np.ndarray
    """Narrow-phase queries (N,) that the selection took."""
    off_surface: np.ndarray
    """Lower bound of the loss (N,) in m^2 from targets that lie off the surfaces of their bodies."""
    direction: np.ndarray | None = None
    """Target unit normals from link to object (N, L, 3), object frame; NaN: any. None: no target normals."""

    __repr__ = brief

    @staticmethod
    def nothing(count: int, links: int) -> Goal:
        """Return the goal of `count` grasps in which no link should touch anything."""
        no_target = np.full((count, links, 3), np.nan)
        none = np.zeros((count, links), dtype=bool)
        return Goal(none, no_target, no_target, np.zeros(count, dtype=np.int64), np.zeros(count))

    @property
    def aimed(self) -> np.ndarray:
        """Links (N, L) with a target."""
        return ~np.isnan(self.target_link[..., 0])


def goal_of(
    scene: Scene,
    touching: ContactSelection,
    prepared: HandObject | None = None,
    *,
    nearest: bool = False,
    others: bool = False,
) -> Goal:
    """Return the goal of a scene: its targets if it has any, else that the links near the object touch it.

    Args:
        scene: Hand, object, grasps and, perhaps, targets.
        touching: Selection of the links that touch where there are no targets.
        prepared: Geometry of the hand and the object; None: built here.
        nearest: Without targets, these links should touch at their present witness points, not just anywhere;
            links that are not near but have a target normal get no target.
        others: Beside targets, the links near the object that have none should touch as well.
    """
    prepared = prepared or HandObject.of(scene)
    if scene.target_link is not None and scene.target_object is not None:
        targets = scene.target_link, scene.target_object
        # A point on one side only is no target.
        missing = np.logical_or(*(np.isnan(target).any(axis=-1, keepdims=True) for target in targets))
        target_link, target_object = (np.where(missing, np.nan, target) for target in targets)
        chosen, queries = _with_directions(~missing[..., 0], scene), np.zeros(len(scene.q), dtype=np.int64)
        if others:
            near = goal_of(replace(scene, target_link=None, target_object=None), touching, prepared)
            chosen, queries = chosen | near.touching, near.queries
        off = _off_surface(prepared, scene.number, target_link, target_object)
        return Goal(chosen, target_link, target_object, queries, off, scene.direction)
    witness, T = _at_start(scene, prepared, touching)
    chosen = ~np.isnan(contact_gaps(replace(scene, contact_gap=None), witness, touching))
    target_link, target_object = np.full((2, *chosen.shape, 3), np.nan)
    if nearest:
        known = chosen & witness.valid
        target_link, target_object = nearest_points(witness, T, np.broadcast_to(np.eye(4), T.shape), known)
    on_surface = np.zeros(len(scene.q))
    return Goal(chosen, target_link, target_object, witness.num_queries.sum(axis=1), on_surface, scene.direction)


def _with_directions(touching: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the links (N, L) that should touch, including links with a target normal."""
    return touching if scene.direction is None else touching | ~np.isnan(scene.direction[..., 0])


def _off_surface(
    prepared: HandObject, number: np.ndarray, target_link: np.ndarray, target_object: np.ndarray
) -> np.ndarray:
    """Return sums (N,) of the squared distances of all targets from the surfaces of their bodies, in m^2."""
    total = np.zeros(len(target_link))
    of_side = np.arange(target_link.shape[1]), number[:, None]
    for pairs, pair, target in zip(prepared.points, of_side, (target_link, target_object), strict=True):
        item = np.flatnonzero(~np.isnan(target[..., 0]))
        T = np.broadcast_to(np.eye(4), (2, len(item), 4, 4)).copy()
        T[1, :, :3, 3] = target.reshape(-1, 3)[item]
        found = query_items(pairs, np.broadcast_to(pair, target.shape[:2]).reshape(-1)[item], *T)
        off = np.where(found.valid, (found.distance + POINT) ** 2, 0.0)
        total += np.bincount(item // target.shape[1], weights=off, minlength=len(total))
    return total


def _at_start(scene: Scene, prepared: HandObject, touching: ContactSelection) -> tuple[Witness, np.ndarray]:
    """Return witness points of the links that may touch, and the poses (N, L, 4, 4) of all, at the initial grasps."""
    with np.errstate(invalid="ignore"):
        T = prepared.chain(scene.T_world_root, scene.q).T_world_link
    cutoff = touching.cutoff(scene.hand, scene.links)
    return prepared.query(scene.number, T, cutoff=cutoff), T
