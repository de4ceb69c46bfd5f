"""Links of a hand in obstacles: in bodies of the scene, or below the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from grasp_refine.core.plurals import first_of
from grasp_refine.motion.sweep import TOUCHING_M
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.hand_object import HandObject, moving_links
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.surroundings import Surroundings
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.state import State

TABLE = "table"
"""Name of the plane below an object."""

MAX_NAMED = 2
"""Number of overlaps that a line of text names; it counts the others."""


@dataclass(frozen=True)
class Overlap:
    """A link that is in a body around the object."""

    link: str
    """Name of the link."""
    body: str
    """Name of the body."""
    depth: float
    """Depth in metres."""

    def __str__(self) -> str:
        return f"{self.link} in {self.body}, {1e3 * self.depth:.1f} mm deep"


class ObstacleMeter:
    """Overlaps of the shown hand, for the scene and for texts; the last pose's are kept."""

    def __init__(self) -> None:
        """Start without a hand."""
        self._lock = Lock()
        self._around: _Around | None = None
        self._last: tuple[Pose, tuple[Overlap, ...]] | None = None

    def __call__(self, state: State, prepared: HandObject) -> tuple[Overlap, ...]:
        """Return the overlaps of the shown pose, the deepest first; none where nothing is around the object.

        Args:
            state: The state.
            prepared: Its hand and object.
        """
        scene, pose = state.scene, state.shown
        if (scene.environment is None and scene.table is None) or not pose.posed:
            return ()
        with self._lock:
            around = self._around
            if around is None or not around.is_of(prepared, scene.environment, scene.table):
                around = self._around = _Around.of(prepared, scene.environment, scene.table)
                self._last = None
            if self._last is None or self._last[0] is not pose and not self._last[0].same(pose):
                self._last = pose, around.overlaps(pose)
            return self._last[1]


@dataclass(frozen=True, eq=False)
class _Around:
    """Hand and object, with their surroundings."""

    prepared: HandObject
    environment: Environment | None
    table: Plane | None
    bodies: Surroundings | None
    counts: np.ndarray
    """Mask (L,) of the links that count: not fixed ones, such as the base of an arm."""

    @staticmethod
    def of(prepared: HandObject, environment: Environment | None, table: Plane | None) -> _Around:
        links = prepared.chain.links
        moving = moving_links(prepared.hand, links)
        bodies = None if environment is None else Surroundings.measured(environment, prepared.bodies, moving)
        return _Around(
            prepared, environment, table, bodies, np.ones(len(links), dtype=bool) if moving is None else moving
        )

    def is_of(self, prepared: HandObject, environment: Environment | None, table: Plane | None) -> bool:
        return self.prepared is prepared and self.environment is environment and self.table is table

    def overlaps(self, pose: Pose) -> tuple[Overlap, ...]:
        """Return the overlaps of a pose that are more than a touch, the deepest first."""
        links = self.prepared.chain.links
        T = self.prepared.chain(pose.T_object_root[None], pose.q[None]).T_world_link
        depths: dict[tuple[str, str], float] = {}
        if self.environment is not None and self.bodies is not None:
            near = self.bodies.near(T, 0.0)
            for column, distance in zip(near.column[0], near.witness.distance[0], strict=True):
                if column >= 0:
                    body = self.environment.bodies[self.bodies.chosen[self.bodies.body[column]]].name
                    depths[links[self.bodies.link[column]], body] = -float(distance)
        if self.table is not None:
            heights, _ = self.table.heights(self.prepared.bodies, T)
            for link, height, counts in zip(links, heights[0], self.counts, strict=True):
                if counts:
                    depths[link, TABLE] = max(-float(height), depths.get((link, TABLE), 0.0))
        deep = [Overlap(*names, depth) for names, depth in depths.items() if depth > TOUCHING_M]
        return tuple(sorted(deep, key=lambda overlap: -overlap.depth))


def overlaps_text(overlaps: Sequence[Overlap]) -> str:
    """Return text that names the deepest overlaps; empty: there is none."""
    named = "; ".join(first_of([str(overlap) for overlap in overlaps], MAX_NAMED))
    return f"in the way: {named}" if named else ""
