"""Tasks made of grasps: disturbed true grasps that must be recovered, or real grasps as input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians
from zlib import crc32

import numpy as np

from grasp_refine.core.se3 import exp_so3
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.hand import Hand
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.grasp.measures import measure_grasps
from grasp_refine_apps.bench.grasp.variants import Variant

TIP_DISTANCE_M = 0.02
"""Largest distance (metres) of every fingertip to the object in grasps that are tried as true grasps."""
CONTACT_TOLERANCE_M, SOLVED_LOSS_M2 = 1e-5, 1e-12
"""Largest gap and penetration (metres) of a true grasp, and its largest loss (m^2)."""


@dataclass(frozen=True, eq=False)
class Tasks:
    """N tasks, or real grasps to make tasks of, on one object at one scale."""

    object: str
    """Name of the object."""
    scale: float
    """Factor that takes the object's mesh to metres."""
    scene: Scene
    """Initial grasps of the tasks, and their targets if any."""
    index: np.ndarray
    """Numbers of the grasps (N,) among the grasps of their object, for `run --index`."""

    def __len__(self) -> int:
        return len(self.index)

    def take(self, rows: np.ndarray | slice) -> Tasks:
        """Select some of the tasks."""
        return replace(self, scene=self.scene.select(rows), index=self.index[rows])

    def of(self, variant: Variant) -> Tasks | None:
        """Adapt the tasks to a variant; None where a hand has fewer contacts, or an object is concave."""
        scene = self.scene
        if variant.contacts is not None:
            if scene.target_object is None or scene.target_link is None:
                return None
            aimed = ~np.isnan(scene.target_object[..., 0])
            if aimed.sum(axis=1).min() < variant.contacts:
                return None
            more = np.cumsum(aimed, axis=1)[..., None] > variant.contacts
            on_link, on_object = (np.where(more, np.nan, aim) for aim in (scene.target_link, scene.target_object))
            scene = replace(scene, target_link=on_link, target_object=on_object)
        if variant.pieces is not None:
            if not can_be_sliced(scene.object.body):
                return None
            scene = replace(scene, object=scene.object.with_body(slice_body(scene.object.body, variant.pieces)))
        return replace(self, scene=scene)


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of true grasps."""

    translation: float = 0.02
    """Distance that the root moves in a random direction, in metres."""
    rotation: float = radians(15.0)
    """Angle that the root turns about a random axis through its origin, in radians."""
    joints: float = 0.2
    """Standard deviation of joint values, in radians; of prismatic joints, 0.1 m per radian. Limits are kept."""

    def apply(
        self, hand: Hand, T_world_root: np.ndarray, q: np.ndarray, keys: list[tuple[int, ...]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return disturbed root poses (N, 4, 4) and joint values (N, n), by random numbers of each grasp's key."""
        T, q = T_world_root.copy(), q.copy()
        for row, key in enumerate(keys):
            rng = np.random.default_rng(key)
            direction, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
            T[row, :3, 3] += self.translation * direction
            T[row, :3, :3] = exp_so3(self.rotation * axis) @ T[row, :3, :3]
            q[row] += self.joints * hand.per_radian * rng.normal(size=q.shape[1])
        return T, np.clip(q, hand.lower, hand.upper)


def given_nothing(groups: Sequence[Tasks], count: int | None) -> tuple[Tasks, ...]:
    """Return the first `count` real grasps of each group as given; None: all."""
    return tuple(_without_targets(group).take(slice(count)) for group in groups)


def given_targets(
    name: str, groups: Sequence[Tasks], count: int, disturbance: Disturbance, seed: int
) -> tuple[Tasks, ...]:
    """Return `count` disturbed true grasps of each group that has any; the choice does not depend on `count`.

    Args:
        name: Name of the set of grasps, from which random numbers depend.
        groups: Real grasps by object and scale.
        count: Number of tasks of each group.
        disturbance: Disturbance of true grasps.
        seed: Seed of disturbances.
    """
    found = []
    for group in groups:
        true = true_grasps(group)
        if not len(true):
            continue
        tasks = true.take(np.arange(count) % len(true))
        own = crc32(f"{name} {group.object} {group.scale:g}".encode())
        scene = tasks.scene
        T, q = disturbance.apply(scene.hand, scene.T_world_root, scene.q, [(seed, own, i) for i in range(count)])
        found.append(replace(tasks, scene=replace(scene, T_world_root=T, q=q)))
    return tuple(found)


def true_grasps(group: Tasks) -> Tasks:
    """Refine real grasps of a group until every fingertip touches the object and nothing penetrates.

    Their targets are the witness points of the fingertips. A plain query decides whether they touch.
    """
    group = _without_targets(group)
    scene = group.scene
    hand, links = scene.hand, scene.links
    tips = tuple(dict.fromkeys(contact.link for contact in hand.contacts))
    columns = [links.index(tip) for tip in tips]
    before = measure_grasps(scene, scene.T_world_root, scene.q)
    near = (before.distance[:, columns] <= TIP_DISTANCE_M).all(axis=1)
    tried = group.take(np.flatnonzero(near))
    if not len(tried):
        return tried
    config = Config(
        solver=LevenbergMarquardt(patience=12, progress=0.1),
        contact_selection=ContactSelection(links=tips),
        # No compromise: a grasp that penetrates is not a true one.
        weights=Weights(penetration=100.0, self_penetration=100.0, wrench=0.0),
        tolerance=SOLVED_LOSS_M2,
    )
    found = refine(tried.scene, config)
    after = measure_grasps(tried.scene, found.T_world_root, found.q)
    exact = (np.abs(after.distance[:, columns]) < CONTACT_TOLERANCE_M).all(axis=1) & (found.loss[:, 1] < SOLVED_LOSS_M2)
    exact &= (
        (after.penetration < CONTACT_TOLERANCE_M)
        & (after.self_penetration < CONTACT_TOLERANCE_M)
        & (after.limits_violated == 0)
    )
    aimed = np.isin(np.arange(len(links)), columns)[:, None]
    scene = replace(
        tried.scene,
        T_world_root=found.T_world_root,
        q=found.q,
        target_link=np.where(aimed, after.point_link, np.nan),
        target_object=np.where(aimed, after.point_object, np.nan),
    )
    return replace(tried, scene=scene).take(np.flatnonzero(exact))


def _without_targets(group: Tasks) -> Tasks:
    """Return grasps without the targets of their file."""
    return replace(group, scene=replace(group.scene, target_link=None, target_object=None, direction=None))


def can_be_sliced(body: Body) -> bool:
    """Return True where the body is one polytope."""
    return len(body.pieces) == 1 and body.pieces[0].radius == 0 and len(body.pieces[0].vertices) > 3


def slice_body(body: Body, count: int) -> Body:
    """Cut the body into `count` pieces: repeatedly, the longest piece is halved along its longest side.

    Distances outside the body are unchanged. Inside, the depth in a piece may be smaller than the depth in the body, as
    with the pieces of any decomposition.
    """
    pieces = list(body.pieces)
    while len(pieces) < count:
        longest = max(range(len(pieces)), key=lambda k: np.ptp(pieces[k].bounds, axis=0).max())
        pieces[longest : longest + 1] = _halves(pieces[longest])
    return replace(body, pieces=tuple(pieces))


def _halves(piece: Piece) -> tuple[Piece, Piece]:
    """Cut a polytope in the middle of its longest side."""
    axis = np.ptp(piece.bounds, axis=0).argmax()
    vertices = piece.vertices
    height = vertices[:, axis] - piece.bounds[:, axis].mean()
    ends = np.unique(np.sort(np.concatenate([piece.faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    ends = ends[height[ends].prod(axis=1) < 0]
    low, high = height[ends].T
    share = (low / (low - high))[:, None]
    cut = (1.0 - share) * vertices[ends[:, 0]] + share * vertices[ends[:, 1]]
    below, above = (hull(np.concatenate([vertices[side], cut])) for side in (height <= 0, height >= 0))
    return below, above
