"""Simulations in Drake: each is a row of numbers, which a thread loads into a context to advance them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import Empty, SimpleQueue

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.validation.engines.drake.build import build_plant
from grasp_refine.validation.engines.drake.plant import Plant, rigid
from grasp_refine.validation.engines.mujoco.parameters import building_engine
from grasp_refine.validation.engines.mujoco.world import UP, World
from grasp_refine.validation.engines.root_joints import root_values
from grasp_refine.validation.engines.simulations import Engine, Simulations, Touch

POSE_NUMBERS = 16
"""Numbers of a transform."""


def engine_for(world: World) -> Engine:
    """Return the engine of a world.

    Raises:
        GraspRefineError: the model has a part that Drake has no counterpart of; names it.
    """
    return building_engine(
        world, lambda world, parameters: Workspaces(build_plant(world, parameters)), Rows, engine="drake"
    )


class Workspace:
    """Context of a plant in which one simulation at a time is advanced."""

    def __init__(self, plant: Plant) -> None:
        """Create the context."""
        self._plant = plant
        self._steps = 0
        context = plant.diagram.CreateDefaultContext()
        self._simulator = Simulator(plant.diagram, context)
        self._context = plant.plant.GetMyMutableContextFromRoot(context)

    def load(self, start: np.ndarray, set_points: np.ndarray, moving: np.ndarray, wrench: np.ndarray) -> Workspace:
        """Take over a simulation: frame of the root's joints (4, 4), set points, positions and velocities, push."""
        plant, context = self._plant, self._context
        plant.start.SetPoseInParentFrame(context, rigid(start))
        plant.plant.SetPositionsAndVelocities(context, moving)
        targets = np.concatenate([set_points, np.zeros_like(set_points)])
        plant.plant.get_desired_state_input_port(plant.hand).FixValue(context, targets)
        push = ExternallyAppliedSpatialForce()
        push.body_index, push.p_BoBq_B = plant.object.index(), plant.centre
        push.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
        plant.plant.get_applied_spatial_force_input_port().FixValue(context, [push])
        return self

    def step(self, count: int) -> Float[np.ndarray, " x"]:
        """Return positions and velocities (x,) after `count` steps; NaN if the solver found none."""
        self._steps += count
        try:
            # Half a step short of the next one, so that rounding adds or drops none.
            self._simulator.AdvanceTo((self._steps - 0.5) * self._plant.plant.time_step())
        except RuntimeError:
            self._steps = 0
            self._simulator.get_mutable_context().SetTime(0.0)
            self._simulator.Initialize()
            return np.full(self._plant.plant.num_multibody_states(), np.nan)
        return self._plant.plant.GetPositionsAndVelocities(self._context)

    def penetrations(self) -> list[tuple[tuple[int, int], float]]:
        """Return the pairs of geoms, by their numbers in MuJoCo, that are in each other, and the depths in metres."""
        query, geoms = self._plant.plant.get_geometry_query_input_port().Eval(self._context), self._plant.geoms
        return [((geoms[p.id_A], geoms[p.id_B]), p.depth) for p in query.ComputePointPairPenetration()]


class Workspaces:
    """Plant with its workspaces; each thread borrows one at a time."""

    def __init__(self, plant: Plant) -> None:
        """Begin without any."""
        self.plant = plant
        self._idle: SimpleQueue[Workspace] = SimpleQueue()

    @contextmanager
    def borrow(self) -> Iterator[Workspace]:
        """Lend a workspace within the context."""
        try:
            workspace = self._idle.get_nowait()
        except Empty:
            workspace = Workspace(self.plant)
        try:
            yield workspace
        finally:
            self._idle.put(workspace)


class Rows(Simulations):
    """Simulations in Drake, as numbers in rows."""

    def __init__(
        self, world: World, spaces: Sequence[Workspaces], running: Bool[np.ndarray, " N"], threads: int
    ) -> None:
        """Begin at rest, with the hands' roots at the origin; `spaces` has one entry per simulation."""
        self.world = world
        self.running = running.copy()
        self.unstable = np.zeros(len(running), dtype=bool)
        # Its servos are implicit, and do not diverge.
        self.runaway = np.full(len(running), "", dtype=object)
        self._spaces = spaces
        self._threads = threads
        # All plants of a world have the same joints and servos.
        self._plant = plant = spaces[0].plant
        self._start = np.tile(np.eye(4), (len(running), 1, 1))
        self._set_points = np.tile(plant.rest, (len(running), 1))
        self._moving = np.zeros((len(running), plant.plant.num_multibody_states()))
        self._wrench = np.zeros((len(running), 6))

    def place(self, root: np.ndarray, joints: np.ndarray, object: np.ndarray) -> None:
        """Place the hands' root bodies (N, 7), joints (N, m) and objects (N, 7), all at rest."""
        plant = self._plant
        self._start = transform_from_pose(root)
        self._moving[:] = 0.0
        positions = self._moving[:, : plant.plant.num_positions()]
        positions[:, plant.joints] = joints
        positions[:, plant.object_at] = np.roll(object, 4, axis=1)
        # One by one, so that rounding does not depend on the batch.
        positions[:] = [plant.helpers @ row for row in positions]

    def drive(self, root: np.ndarray, set_points: np.ndarray) -> None:
        """Set where the hands' root bodies (N, 7) and the actuators (N, u) are to go."""
        plant = self._plant
        self._set_points[:, plant.servos] = plant.set_points(set_points)
        for row, (start, T) in enumerate(zip(self._start, transform_from_pose(root), strict=True)):
            self._set_points[row, plant.root_servos] = root_values(start, T)

    def raise_to(self, height: float) -> None:
        """Set where the root bodies are to go: `height` metres above where `resume` found them to go."""
        lift = self._start[:, :3, :3].mT @ (height * UP)
        self._set_points[:, self._plant.root_servos[:3]] = self._held_at + lift

    def push(self, wrench: np.ndarray) -> None:
        """Set force and torque (N, 6) at the objects' centres of mass, world axes."""
        self._wrench = wrench

    def step(self, count: int) -> None:
        """Advance running simulations by `count` steps; diverging ones stop."""

        def advance(row: int, space: Workspace) -> None:
            self._moving[row] = space.step(count)

        self._each(np.flatnonzero(self.running), advance)
        self.unstable |= self.running & ~np.isfinite(self._moving).all(axis=1)
        self.running &= ~self.unstable

    def touching(self, rows: np.ndarray) -> Touch:
        """Return the contacts in the simulations `rows`; none in the others."""
        found = Touch.none(len(self.running), len(self.world.links))
        link_of_geom = np.array(self.world.link_of_geom)

        def look(row: int, space: Workspace) -> None:
            for geoms, overlap in space.penetrations():
                found.add(row, link_of_geom[list(geoms)], overlap)

        self._each(rows, look)
        return found

    def object_poses(self) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses of the objects (N, 4, 4); NaN where a simulation diverged."""
        pose = np.roll(self._moving[:, self._plant.object_at], 3, axis=1)
        # Drake integrates quaternions without normalising them.
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        return transform_from_pose(pose)

    def state(self) -> Float[np.ndarray, "N s"]:
        """Return all from which the simulations can be resumed."""
        return np.concatenate([self._start.reshape(-1, POSE_NUMBERS), self._set_points, self._moving], axis=1)

    def resume(self, state: np.ndarray) -> None:
        """Resume from states (N, s) of simulations under the same conditions."""
        parts = np.split(state, [POSE_NUMBERS, POSE_NUMBERS + self._set_points.shape[1]], axis=1)
        self._start, self._set_points, self._moving = parts[0].reshape(-1, 4, 4), parts[1].copy(), parts[2].copy()
        self._held_at = self._set_points[:, self._plant.root_servos[:3]]

    def _each(self, rows: np.ndarray, work: Callable[[int, Workspace], None]) -> None:
        """Do `work` on simulations, in threads."""

        def run(row: int) -> None:
            with self._spaces[row].borrow() as space:
                work(row, space.load(self._start[row], self._set_points[row], self._moving[row], self._wrench[row]))

        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(run, rows.tolist()))
