"""Batch of simulations of one world: running and diverged ones, contacts of the hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.files.mujoco_messages import unlogged
from grasp_refine.scene.protocols.contact_model import MUJOCO_CONTACT
from grasp_refine.validation.engines.mujoco.arm_lift import ArmLift
from grasp_refine.validation.engines.mujoco.world import CONES, HAND, OBJECT, World
from grasp_refine.validation.engines.simulations import OBJECT_GEOM, OTHER_GEOM, Engine, Simulations, Touch

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

RUNAWAY_SPEED = 500.0
"""Speed in rad/s or m/s that no joint of a hand reaches, unless its servo or its linkage is unstable."""

SLOW_OBJECT_M_S = 10.0
"""Speed below which an object that is pushed has not yet made the simulation diverge by itself."""

StepCallback = Callable[[Batch], None]
"""Called after every simulation step, and once before the first."""


@dataclass(frozen=True, eq=False)
class Conditions(ArrayRecord):
    """Conditions that differ between N simulations of one world; None: as in the world and its protocol."""

    T_world_object: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of the object at the start, in the frame of the grasps."""
    friction: Float[np.ndarray, " N"]
    """Sliding friction (N,); torsional friction is in proportion, as in the protocol."""
    mass: Float[np.ndarray, " N"] | None = None
    """Mass of the object (N,), kg; its inertia is in proportion."""
    wrench: Float[np.ndarray, "N D 6"] | None = None
    """Force in N and torque in N m (N, D, 6) at the object's centre of mass, in the frame of the grasps, instead of the
    D pushes of the protocol."""
    gain: Float[np.ndarray, " N"] | None = None
    """Factor (N,) of the stiffness of all servos."""
    force_limit: Float[np.ndarray, " N"] | None = None
    """Factor (N,) of the force limits of all servos."""
    contact_time: Float[np.ndarray, " N"] | None = None
    """Factor (N,) of the time constant of contacts with the hand: above 1 they are softer."""
    default_contact: Bool[np.ndarray, " N"] | None = None
    """True (N,) where the friction is MuJoCo's default (`MUJOCO_CONTACT`) instead of the protocol's."""
    thickness: Float[np.ndarray, " N"] | None = None
    """Distance (N,) by which the surface of the object lies outside that of its pieces, metres; negative: inside.

    Depths and touching links of a stage do not need it.
    """

    __repr__ = brief

    @classmethod
    def nominal(cls, world: World, count: int) -> Conditions:
        """Return the object pose of the grasps, with the friction of the protocol."""
        return cls(np.tile(np.eye(4), (count, 1, 1)), np.full(count, world.protocol.friction))

    @property
    def finite(self) -> Bool[np.ndarray, " N"]:
        """True (N,) where all numbers are finite."""
        values = [getattr(self, field.name) for field in fields(self)]
        arrays = [value.reshape(len(value), -1) for value in values if value is not None]
        return np.all([np.isfinite(array).all(axis=1) for array in arrays], axis=0)


def engine_for(world: World) -> Engine:
    """Return the engine of any world."""
    return Rows


class Rows(Simulations):
    """Simulations in MuJoCo, as the engine of `Simulations`."""

    def __init__(
        self,
        world: World,
        conditions: Conditions,
        running: Bool[np.ndarray, " N"],
        threads: int,
        on_step: StepCallback | None = None,
    ) -> None:
        """Begin N simulations at the model's initial state, and step only the `running` ones."""
        self.world = world
        self.batch = Batch(world.model, len(running), threads)
        self.running = running.copy()
        self.unstable = np.zeros(len(running), dtype=bool)
        self.runaway = np.full(len(running), "", dtype=object)
        self._on_step = on_step
        self._data = mujoco.MjData(world.model)
        if running.any():
            # Conditions of simulations that never run may not be finite.
            self._set(conditions.select(np.where(running, np.arange(len(running)), running.argmax())))

    def _set(self, conditions: Conditions) -> None:
        """Give the simulations their own parameters, where these are not the model's."""
        world, protocol = self.world, self.world.protocol
        if (conditions.friction != protocol.friction).any():
            coefficients = self.batch.expand("geom_friction")
            coefficients[:, :, 0] = conditions.friction[:, None]
            coefficients[:, :, 1] = conditions.friction[:, None] * protocol.torsion / protocol.friction
        if conditions.mass is not None:
            share = conditions.mass / world.mass
            self.batch.expand("body_mass")[:, world.object_body] *= share
            self.batch.expand("body_inertia")[:, world.object_body] *= share[:, None]
        if conditions.thickness is not None:
            surface = np.array(world.link_of_geom) == OBJECT_GEOM
            self.batch.expand("geom_margin")[:, surface] += conditions.thickness[:, None]
        if conditions.mass is not None or conditions.thickness is not None:
            # Constants that follow from masses, and the margins of bodies, which the broad phase uses.
            self.batch.set_const()
        if conditions.gain is not None:
            gain = conditions.gain[:, None]
            self.batch.expand("actuator_gainprm")[:, :, 0] *= gain
            self.batch.expand("actuator_biasprm")[:, :, 1:3] *= gain[..., None]
        if conditions.force_limit is not None:
            self.batch.expand("actuator_forcerange")[:] *= conditions.force_limit[:, None, None]
            # A limit at a joint or a tendon is the servo's too.
            self.batch.expand("jnt_actfrcrange")[:] *= conditions.force_limit[:, None, None]
            self.batch.expand("tendon_actfrcrange")[:] *= conditions.force_limit[:, None, None]
        if conditions.contact_time is not None:
            hand = np.array(world.link_of_geom) >= 0
            self.batch.expand("geom_solref")[:, hand, 0] *= conditions.contact_time[:, None]
        if conditions.default_contact is not None:
            at = conditions.default_contact
            self.batch.expand("opt.cone")[at] = CONES[MUJOCO_CONTACT.cone]
            self.batch.expand("opt.impratio")[at] = MUJOCO_CONTACT.impratio
            self.batch.expand("opt.noslip_iterations")[at] = MUJOCO_CONTACT.noslip_iterations

    def place(self, root: np.ndarray, joints: np.ndarray, object: np.ndarray) -> None:
        """Place the hands' root bodies (N, 7), joints (N, m) and objects (N, 7), all at rest."""
        world, qpos = self.world, self.batch.qpos
        if world.root_at is None:
            self.batch.mocap_pos[:, 0], self.batch.mocap_quat[:, 0] = root[:, :3], root[:, 3:]
        else:
            qpos[:, world.root_at : world.root_at + 7] = root
        qpos[:, world.joints_at] = joints
        qpos[:, world.object_at : world.object_at + 7] = object

    def begin(self) -> None:
        """Show the placed simulations to the callback, if any runs."""
        if self._on_step is not None and self.running.any():
            self._on_step(self.batch)

    def drive(self, root: np.ndarray, set_points: np.ndarray) -> None:
        """Set where the hands' root bodies (N, 7) and the actuators (N, u) are to go."""
        self.batch.ctrl[:] = set_points
        self.batch.mocap_pos[:, 0], self.batch.mocap_quat[:, 0] = root[:, :3], root[:, 3:]

    def raise_to(self, height: float) -> None:
        """Set where the root bodies are to go: `height` metres above where `resume` found them to go.

        An arm raises its palm instead, by its joints.
        """
        rise = height * self.world.up
        if self.world.root_at is None:
            T_base = transform_from_pose(np.concatenate([self._held_at[:, 0], self.batch.mocap_quat[:, 0]], axis=1))
            self.batch.ctrl[:] = self._arm_lift.set_points(T_base, self._set_points, rise)
        else:
            self.batch.mocap_pos[:] = self._held_at + rise

    @cached_property
    def _arm_lift(self) -> ArmLift:
        return ArmLift.of(self.world)

    def push(self, wrench: np.ndarray) -> None:
        """Set force and torque (N, 6) at the objects' centres of mass, world axes."""
        self.batch.xfrc_applied[:, self.world.object_body] = wrench

    def state(self) -> Float[np.ndarray, "N s"]:
        """Return the states of MuJoCo, warm starts included."""
        return self.batch.state.copy()

    def resume(self, state: np.ndarray) -> None:
        """Resume from states (N, s) of simulations under the same conditions."""
        self.batch.state[:] = state
        self._held_at, self._set_points = self.batch.mocap_pos.copy(), self.batch.ctrl.copy()

    def step(self, count: int) -> None:
        """Advance running simulations by `count` steps; diverging ones stop."""
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
            self._stop_runaways(ids)
            self.running &= ~self.unstable
            if self._on_step is not None:
                self._on_step(self.batch)

    def _stop_runaways(self, ids: np.ndarray) -> None:
        """Note the simulations `ids` whose hand diverges, which is no fault of the grasp."""
        world, speed = self.world, np.abs(np.nan_to_num(self.batch.qvel[ids], nan=np.inf))
        at = int(world.model.joint(OBJECT).dofadr[0])
        slow = np.linalg.norm(speed[:, at : at + 3], axis=1) < SLOW_OBJECT_M_S
        joints = world.hand_dofs
        fast = speed[:, joints] > RUNAWAY_SPEED
        pushed = self.batch.xfrc_applied[ids, world.object_body].any(axis=1)
        for row in np.flatnonzero((slow | ~pushed) & fast.any(axis=1)):
            joint = world.model.dof_jntid[joints[speed[row, joints].argmax()]]
            self.runaway[ids[row]] = world.model.joint(joint).name.removeprefix(f"{HAND}/")
            self.unstable[ids[row]] = True

    def touching(self, rows: np.ndarray) -> Touch:
        """Return the contacts in the simulations `rows`; none in the others."""
        count = len(self.running)
        links = np.zeros((count, len(self.world.links)), dtype=bool)
        depth, depth_table = np.zeros(count), np.zeros(count)
        for row in rows:
            geoms, distance = self.contacts(int(row))
            owners = np.sort(self.world.link_of_geom[geoms], axis=1)
            by_link = (owners[:, 1] >= 0) & (distance <= 0)
            on_object, on_table = by_link & (owners[:, 0] == OBJECT_GEOM), by_link & (owners[:, 0] == OTHER_GEOM)
            links[row, owners[on_object, 1]] = True
            depth[row] = np.max(-distance[on_object], initial=0.0)
            depth_table[row] = np.max(-distance[on_table], initial=0.0)
        return Touch(links, depth, depth_table)

    def contacts(self, row: int) -> tuple[Int[np.ndarray, "C 2"], Float[np.ndarray, " C"]]:
        """Return the geoms (C, 2) of the contacts in one simulation, and their distances (C,), metres."""
        self.batch.get_data(row, self._data)
        with unlogged():
            mujoco.mj_fwdPosition(self.world.model, self._data)
        return self._data.contact.geom.copy(), self._data.contact.dist.copy()

    def pushed(self) -> Float[np.ndarray, "N V"]:
        """Return the displacements of the movable bodies around the objects, metres."""
        at = self.world.neighbours_at[:, None] + np.arange(3)
        moved = self.batch.qpos[:, at] - self.world.model.qpos0[at]
        return np.sqrt((moved * moved).sum(axis=-1))

    def object_poses(self) -> Float[np.ndarray, "N 4 4"]:
        """Return the poses of the object (N, 4, 4)."""
        at = self.world.object_at
        return transform_from_pose(self.batch.qpos[:, at : at + 7])
