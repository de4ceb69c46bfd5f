"""Engines that simulate grasps: what the protocol of a trial asks of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.short_repr import brief

OBJECT_GEOM, OTHER_GEOM = -1, -2
"""Owners of geoms without a link, beside the indices of links: the object, and others, such as the table."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Contacts of the hands of N simulations."""

    links: Bool[np.ndarray, "N L"]
    """True (N, L) where a link touches the object."""
    depth: Float[np.ndarray, " N"]
    """Largest penetration of the links in the object (N,), metres."""
    depth_table: Float[np.ndarray, " N"]
    """Largest penetration of the links in the table (N,), metres."""

    __repr__ = brief

    @staticmethod
    def none(count: int, links: int) -> Touch:
        """Return no contact of `count` simulations of a hand of some links."""
        return Touch(np.zeros((count, links), dtype=bool), np.zeros(count), np.zeros(count))

    def add(self, row: int, owners: Int[np.ndarray, " 2"], depth: float) -> None:
        """Add a contact of two geoms in a simulation, if one is of a link and the other is not.

        Args:
            row: Number of the simulation.
            owners: Owners of the geoms, as of `World.link_of_geom`.
            depth: Penetration in metres.
        """
        other, link = sorted(owners)
        if link < 0 or other >= 0:
            return
        if other == OBJECT_GEOM:
            self.links[row, link] = True
            self.depth[row] = max(self.depth[row], depth)
        else:
            self.depth_table[row] = max(self.depth_table[row], depth)


class Simulations(ABC):
    """N simulations of a world; the result of each depends neither on the others nor on the number of threads."""

    running: Bool[np.ndarray, " N"]
    """True (N,) where `step` advances the simulation."""
    unstable: Bool[np.ndarray, " N"]
    """True (N,) where the simulation diverged."""
    runaway: np.ndarray
    """Name (N,) of the hand's joint that made it diverge; empty where none did, or the object may have."""

    @abstractmethod
    def place(
        self,
        root: Float[np.ndarray, "N 7"],
        joints: Float[np.ndarray, "N m"],
        object: Float[np.ndarray, "N 7"],
    ) -> None:
        """Place the hands' root bodies, joints in the order of `HandModel.joints`, and objects, all at rest."""

    def begin(self) -> None:  # noqa: B027
        """Take note that all is placed, and the hands are about to close; by default nobody watches."""

    @abstractmethod
    def drive(self, root: Float[np.ndarray, "N 7"], set_points: Float[np.ndarray, "N u"]) -> None:
        """Set where the hands' root bodies and the actuators are to go."""

    @abstractmethod
    def raise_to(self, height: float) -> None:
        """Set where the root bodies are to go: `height` metres above where `resume` found them to go."""

    @abstractmethod
    def push(self, wrench: Float[np.ndarray, "N 6"]) -> None:
        """Set force and torque at the objects' centres of mass, world axes."""

    @abstractmethod
    def step(self, count: int) -> None:
        """Advance running simulations by `count` steps; diverging ones stop."""

    @abstractmethod
    def touching(self, rows: np.ndarray) -> Touch:
        """Return the contacts in the simulations `rows`; none in the others."""

    @abstractmethod
    def object_poses(self) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses of the objects."""

    def pushed(self) -> Float[np.ndarray, "N V"]:
        """Return the displacements of the movable bodies around the objects, metres."""
        return np.zeros((len(self.running), 0))

    @abstractmethod
    def state(self) -> Float[np.ndarray, "N s"]:
        """Return all from which the simulations can be resumed."""

    @abstractmethod
    def resume(self, state: Float[np.ndarray, "N s"]) -> None:
        """Resume from states of simulations under the same conditions."""


Engine = Callable[..., Simulations]
"""Maker of simulations: called with world, conditions, (N,) True for running ones, threads, and a callback."""
