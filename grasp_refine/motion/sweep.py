"""Sweep of a hand along a path: the first thing that it runs into, by dense samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.array_types import Float
from grasp_refine.motion.paths import HandPath
from grasp_refine.scene.hand_object import HandObject, moving_links
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Surroundings

SPACING_M = 0.004
"""Largest movement in metres of any point of the hand or its arm between two samples."""

TOUCHING_M = 2e-4
"""Depth in metres up to which two bodies only touch."""

SELF_TOUCHING_M = 5e-4
"""Largest allowed depth of two links in each other, which a refined grasp may leave."""

Overlaps = tuple[np.ndarray, float, np.ndarray, tuple[str, ...], tuple[str, ...]]
"""Depths (K, P) of pairs in metres, allowed depths, places (K, P, 3), and the names of both sides (P,)."""


@dataclass(frozen=True)
class Obstruction:
    """The first place on a path where two bodies overlap."""

    first: str
    """Link of the hand or its arm, or the object that it carries."""
    second: str
    """Obstacle that it runs into: a link, the object, the table, or a body of the scene."""
    place: tuple[float, float, float]
    """Deepest point (3,) in the object's frame, metres."""
    depth: float
    """Depth in metres at that sample."""
    share: float
    """Share of the path that is free."""

    def __str__(self) -> str:
        x, y, z = self.place
        return f"{self.first} and {self.second} meet at ({x:.3f}, {y:.3f}, {z:.3f}) m, {self.depth * 1e3:.1f} mm deep"


class Sweep:
    """Checks of the paths of one hand around one object."""

    def __init__(self, scene: Scene, prepared: HandObject) -> None:
        """Prepare the bodies."""
        self.scene, self.prepared = scene, prepared

    def sampled(self, path: HandPath) -> HandPath:
        """Return a path with samples at most `SPACING_M` apart."""
        return path.sampled(self.prepared.chain, self.prepared.bounding_spheres, SPACING_M)

    def obstruction(
        self, path: HandPath, *, allowed: float | None = TOUCHING_M, carries: bool = False
    ) -> Obstruction | None:
        """Return what a path first runs into; None: it is free.

        Args:
            path: The path; it is sampled densely here.
            allowed: Depth in metres up to which links may be in the object; None: in any depth.
            carries: Whether the object moves with the palm.
        """
        path = self.sampled(path)
        T = self.prepared.chain(path.T_world_root, path.q).T_world_link
        found = [self._earliest(len(path), *part) for part in self._parts(path, T, allowed, carries)]
        met = [one for one in found if one is not None]
        return min(met, key=lambda one: (one.share, -one.depth), default=None)

    def depth_in_object(self, path: HandPath) -> float:
        """Return the largest depth in metres of links in the object at the end of a path; 0 where none is in it."""
        T = self.prepared.chain(path.T_world_root[-1:], path.q[-1:]).T_world_link
        return float(np.max(-self._against_object(T).distance, initial=0.0))

    def _parts(self, path: HandPath, T: np.ndarray, allowed: float | None, carries: bool) -> Iterator[Overlaps]:
        """Yield the overlaps of each kind of pair."""
        scene, links = self.scene, self.scene.links
        if allowed is not None:
            w = self._against_object(T)
            yield _depths(w), allowed, w.point_a, links, (scene.object.name,) * len(links)
        if self.prepared.self_collision_pairs is not None:
            first, second = self.prepared.self_collision_links
            w = query(self.prepared.self_collision_pairs, T[:, first], T[:, second], cutoff=0.0)
            names = tuple(tuple(links[k] for k in side) for side in (first, second))
            yield _depths(w), SELF_TOUCHING_M, w.point_a, names[0], names[1]
        if scene.table is not None:
            height, lowest = scene.table.heights(self.prepared.bodies, T)
            depth = -height
            moving = moving_links(scene.hand, links)
            depth = depth if moving is None else np.where(moving, depth, -np.inf)
            yield depth, TOUCHING_M, lowest, links, ("table",) * len(links)
        yield from self._in_scene(self._links_around, T, links)
        if carries and self._object_around is not None:
            T_palm = T[:, :1] @ np.linalg.inv(T[:1, :1])
            for depth, most, place, carried, bodies in self._in_scene(self._object_around, T_palm, ("object",)):
                # What touches at the start, such as a shelf, is left.
                yield depth, most + max(float(depth[0, 0]), 0.0), place, carried, bodies

    def _against_object(self, T: np.ndarray) -> Witness:
        return query(self.prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=0.0)

    @cached_property
    def _links_around(self) -> Surroundings | None:
        hand, links = self.scene.hand, self.scene.links
        return self._around(self.prepared.bodies, moving_links(hand, links))

    @cached_property
    def _object_around(self) -> Surroundings | None:
        return self._around((self.scene.object.body,), None)

    def _around(self, bodies: tuple, counts: np.ndarray | None) -> Surroundings | None:
        environment = self.scene.environment
        return None if environment is None else Surroundings.measured(environment, bodies, counts)

    @staticmethod
    def _in_scene(around: Surroundings | None, T: np.ndarray, names: tuple[str, ...]) -> Iterator[Overlaps]:
        """Yield the deepest pair of each sample in the bodies of the scene, as one column for each pair that occurs."""
        if around is None:
            return
        near = around.near(T, 0.0, most=1)
        column, w = near.column[:, 0], near.witness
        for pair in np.unique(column[column >= 0]):
            at = column == pair
            depth = np.where(at, -w.distance[:, 0], -np.inf)[:, None]
            body = around.environment.bodies[around.chosen[around.body[pair]]].name
            yield depth, TOUCHING_M, w.point_a[:, :1], (names[around.link[pair]],), (body,)

    @staticmethod
    def _earliest(
        count: int,
        depth: Float[np.ndarray, "K P"],
        allowed: float,
        place: np.ndarray,
        first: tuple[str, ...],
        second: tuple[str, ...],
    ) -> Obstruction | None:
        deep = depth > allowed
        if not deep.any():
            return None
        sample = int(deep.any(axis=1).argmax())
        pair = int(depth[sample].argmax())
        x, y, z = place[sample, pair].tolist()
        share = sample / max(count - 1, 1)
        return Obstruction(first[pair], second[pair], (x, y, z), float(depth[sample, pair]), share)


def _depths(witness: Witness) -> np.ndarray:
    return np.where(witness.valid, -witness.distance, -np.inf)
