"""Batch of simulations of one world: running and diverged ones, contacts of the hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco.batch import Batch, SimulationError

from grasp_refine.core.array_records import take
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.core.short_repr import brief
from grasp_refine.validation.messages import unlogged
from grasp_refine.validation.world import OBJECT_GEOM, OTHER_GEOM, World

DIVERGED = [
    warning.value
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
        mujoco.mjtWarning.mjWARN_INERTIA,
        # Without memory for all contacts, bodies pass through each other.
        mujoco.mjtWarning.mjWARN_CONTACTFULL,
        mujoco.mjtWarning.mjWARN_CNSTRFULL,
    )
]
"""Warnings of MuJoCo after which a simulation is not valid."""

StepCallback = Callable[[Batch], None]
"""Called after every simulation step, and once before the first."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions that differ between N simulations: pose of the object, and friction."""

    T_world_object: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of the object at the start, in the frame of the grasps."""
    friction: Float[np.ndarray, " N"]
    """Sliding friction (N,); torsional friction is in proportion, as in the protocol."""

    __repr__ = brief

    @classmethod
    def nominal(cls, world: World, count: int) -> Conditions:
        """Return the object pose of the grasps, with the friction of the protocol."""
        return cls(np.tile(np.eye(4), (count, 1, 1)), np.full(count, world.protocol.friction))

    def select(self, rows: np.ndarray) -> Conditions:
        """Return the conditions of the simulations `rows`."""
        return take(self, rows)


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


class Rows:
    """N simulations of a world; the result of each depends neither on the others nor on the number of threads."""

    def __init__(
        self,
        world: World,
        friction: Float[np.ndarray, " N"],
        running: Bool[np.ndarray, " N"],
        threads: int,
        on_step: StepCallback | None = None,
    ) -> None:
        """Begin N simulations at the model's initial state, of which those that are `running` will be stepped."""
        self.world = world
        self.batch = Batch(world.model, len(running), threads)
        self.running = running.copy()
        self.unstable = np.zeros(len(running), dtype=bool)
        self._on_step = on_step
        self._data = mujoco.MjData(world.model)
        if (friction != world.protocol.friction).any():
            coefficients = self.batch.expand("geom_friction")
            coefficients[:, :, 0] = friction[:, None]
            coefficients[:, :, 1] = friction[:, None] * world.protocol.torsion / world.protocol.friction

    def step(self, count: int) -> None:
        """Advance running simulations by `count` steps; those that diverge stop."""
        for steps in (count,) if self._on_step is None else (1,) * count:
            ids = np.flatnonzero(self.running)
            if not len(ids):
                return
            try:
                # Warnings are counted below.
                with unlogged():
                    self.batch.step(ids, nstep=steps)
            except SimulationError as error:
                self.unstable[error.ids] = True
            self.unstable[ids] |= (self.batch.warning[ids][:, DIVERGED, 1] > 0).any(axis=1)
            self.unstable[ids] |= ~np.isfinite(self.batch.qpos[ids]).all(axis=1)
            self.running &= ~self.unstable
            if self._on_step is not None:
                self._on_step(self.batch)

    def touching(self, rows: np.ndarray) -> Touch:
        """Return the contacts in the simulations `rows`; none in the others."""
        count = len(self.running)
        links = np.zeros((count, len(self.world.links)), dtype=bool)
        depth, depth_table = np.zeros(count), np.zeros(count)
        for row in rows:
            self.batch.get_data(int(row), self._data)
            with unlogged():
                mujoco.mj_fwdPosition(self.world.model, self._data)
            contact = self._data.contact
            owners = np.sort(self.world.link_of_geom[contact.geom], axis=1)
            by_link = (owners[:, 1] >= 0) & (contact.dist <= 0)
            on_object, on_table = by_link & (owners[:, 0] == OBJECT_GEOM), by_link & (owners[:, 0] == OTHER_GEOM)
            links[row, owners[on_object, 1]] = True
            depth[row] = np.max(-contact.dist[on_object], initial=0.0)
            depth_table[row] = np.max(-contact.dist[on_table], initial=0.0)
        return Touch(links, depth, depth_table)

    def object_poses(self) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses of the object (N, 4, 4)."""
        at = self.world.object_at
        return transform_from_pose(self.batch.qpos[:, at : at + 7])
