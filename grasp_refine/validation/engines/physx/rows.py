"""Simulations in PhysX: each is a row of numbers, and a scene while it advances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.validation.engines.mujoco.parameters import building_engine
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.physx.blueprint import Blueprint, blueprint_of
from grasp_refine.validation.engines.physx.workspace import Workspace
from grasp_refine.validation.engines.root_joints import root_values
from grasp_refine.validation.engines.simulations import Engine, Simulations, Touch

POSE_NUMBERS = 7
"""Numbers of a pose: position and quaternion."""

ROOT_JOINTS = 6
"""Number of joints of the hand's root; they are the first ones."""


def engine_for(world: World) -> Engine:
    """Return the engine of a world.

    It uses one thread: SAPIEN holds Python's lock while PhysX steps.

    Raises:
        GraspRefineError: the model has a part that PhysX has no counterpart of; names it.
    """
    return building_engine(
        world, blueprint_of, lambda world, models, running, threads: Rows(world, models, running), engine="physx"
    )


class Rows(Simulations):
    """Simulations in PhysX, as numbers in rows."""

    def __init__(self, world: World, blueprints: Sequence[Blueprint], running: Bool[np.ndarray, " N"]) -> None:
        """Begin at rest, with the hands' roots at the origin; `blueprints` has one entry per simulation."""
        count = len(running)
        self.world = world
        self.running = running.copy()
        self.unstable = np.zeros(count, dtype=bool)
        # Its drives are implicit, and do not diverge.
        self.runaway = np.full(count, "", dtype=object)
        self._blueprints = blueprints
        # All blueprints of a world have the same joints.
        self._joint_count = len(blueprints[0].helpers)
        self._scenes: dict[int, Workspace] = {}
        self._start = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1))
        self._targets = np.zeros((count, self._joint_count))
        self._moving = np.zeros((count, 2 * self._joint_count + POSE_NUMBERS + 6))
        self._moving[:, self._object_at.start + 3] = 1.0
        self._wrench = np.zeros((count, 6))

    @property
    def _object_at(self) -> slice:
        """Indices (7,) of the object's pose."""
        return slice(2 * self._joint_count, 2 * self._joint_count + POSE_NUMBERS)

    def place(self, root: np.ndarray, joints: np.ndarray, object: np.ndarray) -> None:
        """Place the hands' root bodies (N, 7), joints (N, m) and objects (N, 7), all at rest."""
        self._scenes.clear()
        self._start = root.copy()
        self._moving[:] = 0.0
        positions = self._moving[:, : self._joint_count]
        positions[:, self._blueprints[0].joints] = joints
        # One by one, so that rounding does not depend on the batch.
        positions[:] = [self._blueprints[0].helpers @ row for row in positions]
        self._moving[:, self._object_at] = object

    def drive(self, root: np.ndarray, set_points: np.ndarray) -> None:
        """Set where the hands' root bodies (N, 7) and the actuators (N, u) are to go."""
        for row, blueprint in enumerate(self._blueprints):
            clipped = np.clip(set_points[row : row + 1], *blueprint.control_range.T)
            self._targets[row] = blueprint.drives.targets(clipped)[0]
        for row, (start, T) in enumerate(zip(transform_from_pose(self._start), transform_from_pose(root), strict=True)):
            self._targets[row, :ROOT_JOINTS] = root_values(start, T)

    def raise_to(self, height: float) -> None:
        """Set where the root bodies are to go: `height` metres above where `resume` found them to go."""
        lift = transform_from_pose(self._start)[:, :3, :3].mT @ (height * self.world.up)
        self._targets[:, :3] = self._held_at + lift

    def push(self, wrench: np.ndarray) -> None:
        """Set force and torque (N, 6) at the objects' centres of mass, world axes."""
        self._wrench = wrench

    def step(self, count: int) -> None:
        """Advance running simulations by `count` steps; diverging ones stop."""
        for row in [row for row in self._scenes if not self.running[row]]:
            del self._scenes[row]
        for row in np.flatnonzero(self.running).tolist():
            if row not in self._scenes:
                self._scenes[row] = self._scene(row)
            scene = self._scenes[row]
            scene.step(self._targets[row], self._wrench[row], count)
            self._moving[row] = scene.moving
        self.unstable |= self.running & ~np.isfinite(self._moving).all(axis=1)
        self.running &= ~self.unstable

    def touching(self, rows: np.ndarray) -> Touch:
        """Return the contacts in the simulations `rows`; none in the others."""
        found = Touch.none(len(self.running), len(self.world.links))
        link_of_geom = np.array(self.world.link_of_geom)
        for row in rows.tolist():
            scene = self._scenes.get(row)
            contacts = (self._scene(row).find_contacts() if scene is None else scene).contacts()
            for geoms, overlap, pressed in contacts:
                if overlap >= 0 or pressed:
                    found.add(row, link_of_geom[list(geoms)], overlap)
        return found

    def object_poses(self) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses of the objects (N, 4, 4); NaN where a simulation diverged."""
        pose = self._moving[:, self._object_at].copy()
        # PhysX has quaternions of single precision.
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        return transform_from_pose(pose)

    def state(self) -> Float[np.ndarray, "N s"]:
        """Return all from which the simulations can be resumed."""
        return np.concatenate([self._start, self._targets, self._moving], axis=1)

    def resume(self, state: np.ndarray) -> None:
        """Resume from states (N, s) of simulations under the same conditions."""
        self._scenes.clear()
        parts = np.split(state, [POSE_NUMBERS, POSE_NUMBERS + self._joint_count], axis=1)
        self._start, self._targets, self._moving = (part.copy() for part in parts)
        self._held_at = self._targets[:, :3].copy()

    def _scene(self, row: int) -> Workspace:
        return Workspace(self._blueprints[row], self._start[row], self._moving[row])
