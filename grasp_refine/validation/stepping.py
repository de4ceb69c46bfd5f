"""Many simulations of one world at once: who still runs, who diverged, and who touches what."""

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
        # Without memory for all contacts, things pass through each other.
        mujoco.mjtWarning.mjWARN_CONTACTFULL,
        mujoco.mjtWarning.mjWARN_CNSTRFULL,
    )
]
"""Warnings after which a simulation means nothing any more."""

Watch = Callable[[Batch], None]
"""Is called after every simulation step, and once before the first."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """What may differ between N simulations: where the object lies, and how slippery everything is."""

    T_world_object: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of the object at the start, in the frame that grasps are given in."""
    friction: Float[np.ndarray, " N"]
    """Sliding friction (N,); torsional friction is in the protocol's proportion to it."""

    __repr__ = brief

    @classmethod
    def nominal(cls, world: World, count: int) -> Conditions:
        """The object where the grasps say it is, with the friction of the protocol."""
        return cls(np.tile(np.eye(4), (count, 1, 1)), np.full(count, world.protocol.friction))

    def select(self, rows: np.ndarray) -> Conditions:
        """Those of the simulations `rows`."""
        return take(self, rows)


@dataclass(frozen=True, eq=False)
class Touch:
    """What the hands of N simulations touch."""

    links: Bool[np.ndarray, "N L"]
    """Which links touch the object (N, L)."""
    depth: Float[np.ndarray, " N"]
    """How deep any of them is in the object (N,), metres."""
    depth_table: Float[np.ndarray, " N"]
    """How deep any of them is in the table (N,), metres."""

    __repr__ = brief


class Rows:
    """N simulations of a world; what becomes of one depends neither on the others nor on the number of threads."""

    def __init__(
        self,
        world: World,
        friction: Float[np.ndarray, " N"],
        running: Bool[np.ndarray, " N"],
        threads: int,
        watch: Watch | None = None,
    ) -> None:
        """N simulations at the model's initial state, of which those that are `running` will be stepped."""
        self.world = world
        self.batch = Batch(world.model, len(running), threads)
        self.running = running.copy()
        self.unstable = np.zeros(len(running), dtype=bool)
        self._watch = watch
        self._data = mujoco.MjData(world.model)
        if (friction != world.protocol.friction).any():
            coefficients = self.batch.expand("geom_friction")
            coefficients[:, :, 0] = friction[:, None]
            coefficients[:, :, 1] = friction[:, None] * world.protocol.torsion / world.protocol.friction

    def step(self, count: int) -> None:
        """Advance those that run by `count` steps; those that diverge run no longer."""
        for steps in (count,) if self._watch is None else (1,) * count:
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
            if self._watch is not None:
                self._watch(self.batch)

    def touching(self, rows: np.ndarray) -> Touch:
        """What touches what in the simulations `rows`; nothing in the others."""
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
        """Poses of the object (N, 4, 4)."""
        at = self.world.object_at
        return transform_from_pose(self.batch.qpos[:, at : at + 7])
