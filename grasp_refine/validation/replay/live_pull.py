"""One closed grasp whose object is pulled while it is simulated, from where `push` begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import transform_points
from grasp_refine.validation.engines.mujoco.stepping import Rows
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.replay.replay import Replay, Stage, qpos_names
from grasp_refine.validation.simulation import Closed, judge_pushed
from grasp_refine.validation.trials import Reason

STIFFNESS_N_M = 200.0
"""Stiffness of the spring by which a point of the object is pulled; it is critically damped for the object's mass."""

MAX_PULL_N = 30.0
"""Largest force of a pull, newtons."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Pull at the object, in the frame of the grasps."""

    force: Float[np.ndarray, " 3"]
    """Steady force (3,) at the centre of mass, newtons."""
    point: Float[np.ndarray, " 3"] | None = None
    """Point of the object (3,), object frame, that a spring pulls; None: no spring does."""
    towards: Float[np.ndarray, " 3"] | None = None
    """Other end of the spring (3,)."""


class LivePull:
    """Simulation of one closed grasp, in the very world of its validation; a tabletop's grasp is lifted meanwhile."""

    def __init__(self, world: World, closed: Closed) -> None:
        """Continue the first of the closed grasps, which did not fail yet."""
        self.world, self._protocol = world, world.protocol
        rows = np.zeros(1, dtype=int)
        conditions = closed.conditions.select(rows)
        self._rows = Rows(world, conditions, closed.reason[rows] == Reason.HELD, 1)
        self._rows.resume(closed.state[rows])
        self._start = conditions.T_world_object
        self._before: np.ndarray | None = None
        self.time = 0.0
        """Seconds since the hand has closed."""
        self.reason = Reason(int(closed.reason[0]))
        """HELD, or why the object is lost; it stays lost."""
        self.force: np.ndarray = np.zeros(3)
        """Present force (3,), newtons."""
        self.strongest_n = 0.0
        """Largest force so far at which the object was held, newtons."""
        self.moved_m, self.turned_rad = 0.0, 0.0
        """Displacement in metres and rotation in radians of the object from where it should be."""

    def advance(self, seconds: float, pull: Pull) -> None:
        """Simulate so many seconds under a pull; the object is judged at their end, by the limits of the protocol."""
        step = self._protocol.timestep
        wanted = self._start.copy()
        for _ in range(max(round(seconds / step), 1)):
            self._rows.push(self._wrench(pull)[None])
            if self._protocol.tabletop:
                height = self._protocol.lift * min(self.time / self._protocol.seconds, 1.0)
                self._rows.raise_to(height)
                wanted = self._start.copy()
                wanted[:, :3, 3] += height * self.world.up
            self._rows.step(1)
            self.time += step
        (self.moved_m,), (self.turned_rad,), found = judge_pushed(self._rows, wanted, self._protocol)
        if self.reason == Reason.HELD:
            self.reason = Reason(int(found[0]))
        if self.reason == Reason.HELD:
            self.strongest_n = max(self.strongest_n, float(np.linalg.norm(self.force)))

    @property
    def diverged(self) -> bool:
        """Whether the simulation diverged, and stands still."""
        return bool(self._rows.unstable[0])

    def replay(self, name: str, hand: str) -> Replay:
        """Return two frames: the object where it was before the hand closed, and all as it is now."""
        world, batch = self.world, self._rows.batch
        qpos = np.repeat(batch.qpos[:1], 2, axis=0)
        at = world.object_at
        qpos[0, at : at + 3], qpos[0, at + 3 : at + 7] = self._start[0, :3, 3], [1.0, 0.0, 0.0, 0.0]
        qvel, ctrl, position, turn = (
            np.repeat(values[:1], 2, axis=0)
            for values in (batch.qvel, batch.ctrl, batch.mocap_pos[:, 0], batch.mocap_quat[:, 0])
        )
        return Replay(
            name=name,
            hand=hand,
            object=world.object,
            direction="pull",
            protocol=self._protocol.name,
            reason=self.reason.label,
            force=self.force,
            qpos_names=qpos_names(world.model),
            time=np.array([0.0, self.time]),
            stage=np.full(2, Stage.PUSH, dtype=int),
            qpos=qpos,
            qvel=qvel,
            ctrl=ctrl,
            mocap_pos=position,
            mocap_quat=turn,
        )

    def _wrench(self, pull: Pull) -> Float[np.ndarray, " 6"]:
        """Return force and torque (6,) at the object's centre of mass, world axes."""
        world = self.world
        T = self._rows.object_poses()[0]
        center = transform_points(T, world.model.body_ipos[world.object_body])
        force, arm = pull.force, np.zeros(3)
        if pull.point is None or pull.towards is None:
            self._before = None
        else:
            point = transform_points(T, pull.point)
            velocity = 0.0 if self._before is None else (point - self._before) / self._protocol.timestep
            self._before, arm = point, point - center
            damping = 2.0 * np.sqrt(STIFFNESS_N_M * world.mass)
            force = force + STIFFNESS_N_M * (pull.towards - point) - damping * velocity
        length = float(np.linalg.norm(force))
        self.force = force * min(1.0, MAX_PULL_N / max(length, 1e-9))
        return np.concatenate([self.force, np.cross(arm, self.force)])
