"""Target `mjcf`: hand and object in one MuJoCo scene, key frames of all grasps, and a script that simulates them.

`scene.xml` is the model in which the program itself simulates the task. `schedule.npz` has the set points over time:

    steps               ()          simulation steps after each row
    close_ctrl          (N, K, u)   set points of the actuators from pregrasp to squeeze
    close_pos, _quat    (N, K, 3), (N, K, 4)   where the holder of the palm goes, quaternions w x y z
    lift_ctrl, _pos, _quat    likewise with the rows of the lift; none where the object is pushed
    push                (D, 3)      forces on the object in newtons, each from the state after closing
    push_steps, checks  ()          steps between two checks, and their number
    farthest, steepest  ()          displacement (m) and rotation (rad) of the object from which on it is lost
    up                  (3,)        direction of the lift
    lift_height         ()          its height, m
    required            ()          number of pushes in which a grasp must hold
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.array_types import Float
from grasp_refine.core.json_files import save_text
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.schedule import ENDS, closing_rows, lift_heights, limits_of, simulated
from grasp_refine.export.target import Readme
from grasp_refine.hands.files.mujoco_messages import compiled, unlogged
from grasp_refine.validation.engines.mujoco.arm_lift import ArmLift
from grasp_refine.validation.engines.mujoco.world import OBJECT, World
from grasp_refine.validation.replay.export import add_light, model_text
from grasp_refine.validation.simulation import Course

VISUAL_GROUP, PIECES_GROUP = 2, 3
"""Groups of geoms in MuJoCo's viewer, which shows 0 to 2 at first."""


@dataclass(frozen=True)
class Mjcf:
    """Scene for MuJoCo and MJX."""

    name: str = "mjcf"
    what: str = "a MuJoCo scene with key frames of all grasps, and a script that simulates them"
    extra: str = ""

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write the scene, the schedule and the script."""
        world, course = simulated(grasps)
        save_text(folder / "scene.xml", _scene(world, grasps, course))
        save_npz(folder / "schedule.npz", _schedule(world, course))
        save_text(folder / "simulate.py", files(__package__).joinpath("mjcf_simulate.py").read_text(encoding="utf-8"))
        offsets = world.protocol.noise.count
        return Readme(
            {
                "scene.xml": f"hand, {grasps.name} and actuators; key frames pregrasp_K, grasp_K, squeeze_K of grasp K",
                "schedule.npz": "set points over time, pushes and limits of the task",
                "simulate.py": "simulates the task from these two files alone; needs mujoco and numpy",
            },
            use="python simulate.py",
            notes=(
                "The object's frame is the world's; names of the hand begin with hand/.",
                "squeeze_K is the grasp with set points of the squeeze: from there the fingers press.",
                *([f"Without the {offsets} offsets of the object that the protocol tries as well."] if offsets else ()),
            ),
        )


def _scene(world: World, grasps: ExportedGrasps, course: Course) -> str:
    spec = world.spec.copy()
    spec.modelname = f"{grasps.hand.name} on {grasps.name}"
    spec.compiler.saveinertial = True
    add_light(spec)
    mesh = grasps.object.mesh
    spec.add_mesh(name="object_visual", uservert=np.ravel(mesh.vertices), userface=np.ravel(mesh.faces))
    body = spec.body(OBJECT)
    for geom in body.geoms:
        geom.group = PIECES_GROUP
    look = body.add_geom(name="object_visual", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="object_visual")
    look.contype = look.conaffinity = 0
    look.mass, look.group, look.rgba = 0.0, VISUAL_GROUP, [0.6, 0.7, 0.8, 1.0]
    with unlogged():
        model = compiled(spec)
    for row in range(len(grasps)):
        for name, (before, share) in ENDS.items():
            # The hand cannot be where a squeeze sends it.
            pose = min(STAGES.index(name), STAGES.index("grasp"))
            qpos, root = model.qpos0.copy(), course.root(before, share)[row]
            if world.root_at is not None:
                qpos[world.root_at : world.root_at + 7] = root
            qpos[world.joints_at] = course.joints[row, pose]
            spec.add_key(
                name=f"{name}_{row}",
                qpos=qpos,
                ctrl=course.set_points(before, share)[row],
                mpos=root[:3],
                mquat=root[3:],
            )
    return model_text(spec, model)


def _schedule(world: World, course: Course) -> dict[str, np.ndarray]:
    close = _rows(course.set_points, course.root, closing_rows(world.protocol))
    lift = _lift(world, course)
    named = {f"close_{key}": values for key, values in close.items()}
    return {**named, **{f"lift_{key}": values for key, values in lift.items()}, **limits_of(world)}


def _rows(
    set_points: Callable[[int, float], np.ndarray],
    root: Callable[[int, float], np.ndarray],
    times: list[tuple[int, float]],
) -> dict[str, Float[np.ndarray, "N K k"]]:
    poses = np.stack([root(*time) for time in times], axis=1)
    return {
        "ctrl": np.stack([set_points(*time) for time in times], axis=1),
        "pos": poses[..., :3],
        "quat": poses[..., 3:],
    }


def _lift(world: World, course: Course) -> dict[str, Float[np.ndarray, "N K k"]]:
    """Set points that raise the hand, as `Simulations.raise_to` does."""
    heights = lift_heights(world.protocol)
    ctrl, root = course.set_points(1, 1.0), course.root(1, 1.0)
    if world.root_at is not None:
        raised = root[:, None, :3] + heights[:, None] * world.up
        still = (len(root), len(heights))
        return {
            "ctrl": np.broadcast_to(ctrl[:, None], (*still, ctrl.shape[1])),
            "pos": raised,
            "quat": np.broadcast_to(root[:, None, 3:], (*still, 4)),
        }
    arm, T = ArmLift.of(world), transform_from_pose(root)
    raised = [arm.set_points(T, ctrl, height * world.up)[:, None] for height in heights]
    by_arm = np.concatenate([ctrl[:, None, :][:, :0], *raised], axis=1)
    held = np.repeat(root[:, None], len(heights), axis=1)
    return {"ctrl": by_arm, "pos": held[..., :3], "quat": held[..., 3:]}
