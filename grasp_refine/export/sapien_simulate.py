"""Simulate the grasps of this folder in SAPIEN: the hand closes, then the object is pushed, or lifted."""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import sapien
from sapien.physx import PhysxMaterial

Task = dict[str, np.ndarray]
"""Arrays of task.npz."""

LARGEST_SPEED = 1e4


def main(folder: Path) -> int:
    """Print whether each grasp holds the object; return 0 if all do."""
    task = dict(np.load(folder / "task.npz", allow_pickle=False))
    held = [holds(folder, task, grasp) for grasp in range(len(task["start"]))]
    for grasp, success in enumerate(held):
        print(f"grasp {grasp}: {'held' if success else 'lost'}")
    print(f"{sum(held)} of {len(held)} held")
    return 0 if all(held) else 1


def holds(folder: Path, task: Task, grasp: int) -> bool:
    """Return whether a grasp holds the object in as many pushes as it must, or while it is lifted."""
    trial = Trial(folder, task, grasp)
    if not len(task["push"]):
        return trial.lifts()
    return sum(trial.bears(force) for force in task["push"]) >= int(task["required"])


class Trial:
    """Scene with one grasp after the hand has closed."""

    def __init__(self, folder: Path, task: Task, grasp: int) -> None:
        """Load hand and object, and close the hand."""
        self.task, self.grasp = task, grasp
        sapien.physx.set_scene_config(gravity=np.zeros(3), bounce_threshold=2.0, enable_tgs=False)
        self.scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        self.scene.set_timestep(float(task["timestep"]))
        friction = float(task["friction"])
        material = PhysxMaterial(friction, friction, 0.0)
        self.hand = self._load(folder / "hand.urdf", material, fixed=True)
        self.object = self._load(folder / "object.urdf", material, fixed=False)
        self._add_table(material)
        self._let_collide(folder / "hand.srdf")
        start = task["start"][grasp]
        self.hand.set_root_pose(sapien.Pose(start[:3], start[3:]))
        self.hand.set_solver_position_iterations(32)
        joints = {joint.name: joint for joint in self.hand.active_joints}
        self.joints = [joints[name] for name in task["joints"]]
        numbers = zip(task["stiffness"], task["damping"], task["force_limit"], task["armature"], strict=True)
        for joint, (stiffness, damping, limit, armature) in zip(self.joints, numbers, strict=True):
            joint.set_drive_properties(stiffness, damping, min(limit, np.finfo(np.float32).max))
            joint.set_armature(np.array([armature], dtype=np.float32))
            joint.set_friction(0.0)
        order = [list(task["joints"]).index(joint.name) for joint in self.hand.active_joints]
        self.hand.set_qpos(task["close"][grasp, 0][order].astype(np.float32))
        for row in task["close"][grasp, 1:]:
            self._follow(row, int(task["steps"]))
        body = self._body()
        self.closed = self.hand.qpos, self.hand.qvel, self.pose, body.linear_velocity, body.angular_velocity

    def _load(self, path: Path, material: PhysxMaterial, *, fixed: bool) -> sapien.physx.PhysxArticulation:
        loader = self.scene.create_urdf_loader()
        loader.fix_root_link = fixed
        loader.set_material(material.static_friction, material.dynamic_friction, 0.0)
        articulations, actors, _ = loader.parse(str(path))
        (builder,) = articulations or actors
        for part in builder.link_builders if articulations else [builder]:
            part.visual_records = []  # nothing is drawn
        loaded = builder.build()
        for link in loaded.links if articulations else []:
            link.disable_gravity = True
        return loaded

    def _let_collide(self, path: Path) -> None:
        """Keep links apart that `path` names: SAPIEN reads at most 31 such pairs by itself."""
        apart = {
            frozenset((pair.get("link1"), pair.get("link2"))) for pair in ET.parse(path).iter("disable_collisions")
        }
        names = [link.name for link in self.hand.links]
        partners = {
            one: frozenset(other for other in names if other != one and {one, other} not in apart) for one in names
        }
        # Links with equal partners share a bit; none of them is a partner of another one. Bit 0: object and table.
        bits = {kind: bit for bit, kind in enumerate(dict.fromkeys(partners.values()), start=1)}
        if len(bits) > 31:
            sys.exit("this hand has more kinds of links, by what they may touch, than PhysX's filter has bits")
        for link in self.hand.links:
            mask = 1 | sum({1 << bits[partners[other]] for other in partners[link.name]})
            for shape in link.collision_shapes:
                shape.set_collision_groups([1 << bits[partners[link.name]], mask, 0, 0])
        for shape in self._body().collision_shapes:
            shape.set_collision_groups([1, 2**32 - 1, 0, 0])

    def _add_table(self, material: PhysxMaterial) -> None:
        normal, offset = self.task["table"][:3], float(self.task["table"][3])
        if np.isnan(offset):
            return
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across /= np.linalg.norm(across)
        frame = np.eye(4)
        frame[:3, :3] = np.column_stack([normal, across, np.cross(normal, across)])
        frame[:3, 3] = offset * normal
        builder = self.scene.create_actor_builder()
        builder.add_plane_collision(sapien.Pose(frame), material=material)
        builder.build_static(name="table")

    @property
    def pose(self) -> sapien.Pose:
        """Pose of the object."""
        return self.object.pose

    def _follow(self, targets: np.ndarray, steps: int, force: np.ndarray | None = None) -> None:
        for joint, target in zip(self.joints, targets, strict=True):
            joint.set_drive_target(float(target))
        body = self._body()
        pull = self.task["gravity"] * body.mass + (0.0 if force is None else force)
        for _ in range(steps):
            body.add_force_at_point(pull, (self.pose * body.cmass_local_pose).p)
            self.scene.step()

    def _body(self) -> "sapien.physx.PhysxRigidBodyComponent":
        if isinstance(self.object, sapien.physx.PhysxArticulation):
            return self.object.links[0]
        return self.object.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent)

    def bears(self, force: np.ndarray) -> bool:
        """Return whether the object stays while it is pushed, from where the hand closed."""
        body, (qpos, qvel, pose, velocity, spin) = self._body(), self.closed
        self.hand.set_qpos(qpos)
        self.hand.set_qvel(qvel)
        self.object.set_pose(pose)
        body.set_linear_velocity(velocity)
        body.set_angular_velocity(spin)
        targets = self.task["close"][self.grasp, -1]
        for check in range(int(self.task["checks"]) + 1):
            if check:
                self._follow(targets, int(self.task["push_steps"]), force)
            if self._is_lost(np.zeros(3)):
                return False
        return True

    def lifts(self) -> bool:
        """Return whether the object follows the hand upwards."""
        rows = self.task["lift"][self.grasp]
        parts = len(rows) // int(self.task["checks"])
        for number, row in enumerate(rows, start=1):
            self._follow(row, int(self.task["push_steps"]) // parts)
            rise = float(self.task["lift_height"]) * number / len(rows) * self.task["up"]
            if number % parts == 0 and self._is_lost(rise):
                return False
        return True

    def _is_lost(self, rise: np.ndarray) -> bool:
        moved = np.linalg.norm(self.pose.p - rise)
        turned = 2.0 * np.arccos(min(abs(float(self.pose.q[0])), 1.0))
        return not (moved < self.task["farthest"] and turned < self.task["steepest"])


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parent))
