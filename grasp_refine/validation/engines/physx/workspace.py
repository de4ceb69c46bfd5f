"""One simulation in PhysX: a scene of its own, so that it depends on no other."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.validation.engines.physx.binding import Entity, Pose, Scene, physx
from grasp_refine.validation.engines.physx.blueprint import Blueprint, Body
from grasp_refine.validation.engines.physx.tendons import STIFFNESS as TENDON_STIFFNESS

POSITION_ITERATIONS = 16
"""Iterations of the solver per step: twice as many change 4 of 116 verdicts, half as many 10 of 132."""

COUPLED_ITERATIONS = 32
"""Iterations where tendons couple joints of the hand, which light links solve slowly."""

CLOSED_ITERATIONS = 255
"""Iterations where bodies are tied to each other: the most that PhysX does."""

VELOCITY_ITERATIONS = 1
"""Iterations that remove velocities which would overcome friction or penetrate, after these."""

WELD = (1e4, 10.0)
"""Stiffness and damping against rotation of welded bodies, N m/rad and N m s/rad."""

DEPENETRATION_M_S = 1.0
"""Largest speed at which bodies leave each other: faster than this, grasps that penetrate throw their object."""

FASTEST = 1e4
"""Largest speed of joints and bodies, m/s or rad/s: none that a hand reaches."""

INSTANT_S = 1e-9
"""Time step that only finds contacts."""


class Workspace:
    """Scene in which one simulation advances."""

    def __init__(self, blueprint: Blueprint, start: Float[np.ndarray, " 7"], moving: Float[np.ndarray, " x"]) -> None:
        """Create the scene.

        Args:
            blueprint: Its parts.
            start: Pose (7,) at which all joints of the hand's root are 0.
            moving: Positions and velocities (x,), as `moving` returns them.
        """
        # Gravity acts on the object alone, as a force.
        physx.set_scene_config(
            gravity=np.zeros(3, dtype=np.float32),
            bounce_threshold=2.0,
            enable_pcm=True,
            # Projected Gauss-Seidel: by the temporal kind, loads below the friction cone drag contacts by 6 mm/s.
            enable_tgs=False,
            enable_ccd=False,
            enable_enhanced_determinism=True,
            enable_friction_every_iteration=True,
            cpu_workers=0,
        )
        self._system = physx.PhysxCpuSystem()
        self._system.timestep = blueprint.timestep
        self._scene = Scene([self._system])
        self._geoms = blueprint.geoms
        self._add_world(blueprint)
        links = self._add_hand(blueprint, start)
        self._hand = links[0].articulation
        coupled = COUPLED_ITERATIONS if blueprint.tendons else POSITION_ITERATIONS
        self._hand.set_solver_position_iterations(CLOSED_ITERATIONS if blueprint.ties else coupled)
        self._hand.set_solver_velocity_iterations(VELOCITY_ITERATIONS)
        self._hand.set_sleep_threshold(0.0)
        self._object = self._add_object(blueprint.object)
        self._gravity = blueprint.gravity * blueprint.object.mass
        # PhysX numbers the joints of a tree by depth.
        numbers = [int(joint.name) for joint in self._hand.active_joints]
        self._order = np.array(numbers)
        self._joints = [links[number + 1].joint for number in range(len(numbers))]
        self._load(moving)

    def _add_world(self, blueprint: Blueprint) -> None:
        if blueprint.fixed:
            component = physx.PhysxRigidStaticComponent()
            for shape in blueprint.fixed:
                component.attach(shape)
            self._add(component)

    def _add_hand(self, blueprint: Blueprint, start: np.ndarray) -> list[physx.PhysxArticulationLinkComponent]:
        links: list[physx.PhysxArticulationLinkComponent] = []
        drives = blueprint.drives
        for number, link in enumerate(blueprint.links):
            made = physx.PhysxArticulationLinkComponent(links[link.parent] if links else None)
            links.append(made)
            _give_mass(made, link.body)
            made.disable_gravity = True
            joint = made.joint
            joint.type = link.kind
            joint.pose_in_parent = link.on_parent
            if number:
                joint.name = str(number - 1)
                joint.limit = np.array([link.limits], dtype=np.float32)
                # PhysX's default slows all joints by a share of their speed.
                joint.friction, joint.max_velocity = 0.0, FASTEST
                joint.armature = np.array([link.armature], dtype=np.float32)
                joint.set_drive_properties(
                    drives.stiffness[number - 1],
                    drives.damping[number - 1],
                    min(drives.limit[number - 1], np.finfo(np.float32).max),
                )
        for tendon in blueprint.tendons:
            links[0].articulation.create_fixed_tendon(
                [links[link] for link in tendon.links],
                tendon.weights.tolist(),
                tendon.responses.tolist(),
                rest_length=tendon.length,
                stiffness=TENDON_STIFFNESS,
            )
        ties: dict[int, list[physx.PhysxDriveComponent]] = {}
        for tie in blueprint.ties:
            drive = physx.PhysxDriveComponent(links[tie.links[1]])
            drive.parent = links[tie.links[0]]
            drive.pose_in_parent, drive.pose_in_child = tie.frames
            for axis in (drive.set_limit_x, drive.set_limit_y, drive.set_limit_z):
                axis(0.0, 0.0)
            if tie.welded:
                drive.set_drive_property_slerp(*WELD)
            ties.setdefault(tie.links[1], []).append(drive)
        for number, made in enumerate(links):
            entity = Entity()
            entity.add_component(made)
            for drive in ties.get(number, []):
                entity.add_component(drive)
            if not number:
                entity.pose = Pose(start[:3], start[3:])
            self._scene.add_entity(entity)
        return links

    def _add_object(self, body: Body) -> physx.PhysxRigidDynamicComponent:
        component = physx.PhysxRigidDynamicComponent()
        _give_mass(component, body)
        component.disable_gravity = True
        component.set_solver_position_iterations(POSITION_ITERATIONS)
        component.set_solver_velocity_iterations(VELOCITY_ITERATIONS)
        component.set_sleep_threshold(0.0)
        self._entity = self._add(component)
        return component

    def _add(self, component: physx.PhysxRigidBaseComponent) -> Entity:
        entity = Entity()
        entity.add_component(component)
        self._scene.add_entity(entity)
        return entity

    def _load(self, moving: np.ndarray) -> None:
        """Take positions and velocities of joints and object."""
        count = len(self._order)
        at, speed = moving[:count], moving[count : 2 * count]
        pose, rates = moving[2 * count : 2 * count + 7], moving[2 * count + 7 :]
        self._hand.set_qpos(at[self._order].astype(np.float32))
        self._hand.set_qvel(speed[self._order].astype(np.float32))
        self._entity.pose = Pose(pose[:3], pose[3:])
        self._object.set_linear_velocity(rates[:3])
        self._object.set_angular_velocity(rates[3:])

    @property
    def moving(self) -> Float[np.ndarray, " x"]:
        """Positions, then velocities of the joints, pose (7,) of the object, its velocity and angular velocity."""
        count = len(self._order)
        moving = np.empty(2 * count + 13)
        moving[:count][self._order] = self._hand.qpos
        moving[count : 2 * count][self._order] = self._hand.qvel
        pose = self._entity.pose
        moving[2 * count :] = *pose.p, *pose.q, *self._object.linear_velocity, *self._object.angular_velocity
        return moving

    def step(self, targets: Float[np.ndarray, " j"], wrench: Float[np.ndarray, " 6"], count: int) -> None:
        """Advance by `count` steps towards the targets (j,) of the joints, the object pushed by a wrench (6,)."""
        for joint, target in zip(self._joints, targets.tolist(), strict=True):
            joint.set_drive_target(target)
        # Loads beyond the range of single precision are infinite.
        with np.errstate(over="ignore"):
            force, torque = np.split(np.float32(np.concatenate([wrench[:3] + self._gravity, wrench[3:]])), 2)
        push, advance = self._object.add_force_torque, self._system.step
        for _ in range(count):
            push(force, torque)
            advance()

    def find_contacts(self) -> Workspace:
        """Find the contacts at the present state, which is lost."""
        self._system.timestep = INSTANT_S
        self._system.step()
        return self

    def contacts(self) -> list[tuple[tuple[int, int], float, bool]]:
        """Return the geoms of MuJoCo of the contacts, the depth in metres, and whether these press on each other."""
        found = []
        for contact in self._system.get_contacts():
            first, second = (self._geoms[shape] for shape in contact.shapes)
            depth = max((-point.separation for point in contact.points), default=0.0)
            pressed = any(np.any(point.impulse) for point in contact.points)
            found.append(((first, second), depth, pressed))
        return found


def _give_mass(component: physx.PhysxRigidBodyComponent, body: Body) -> None:
    for shape in body.shapes:
        component.attach(shape)
    component.mass = body.mass
    component.cmass_local_pose, component.inertia = body.centre, body.moments.astype(np.float32)
    component.linear_damping = component.angular_damping = 0.0
    component.max_depenetration_velocity = DEPENETRATION_M_S
    component.max_angular_velocity = FASTEST
