"""Targets `sapien` and `drake`: URDF of hand and object with all convex pieces, and a script that simulates the grasps.

`task.npz` has, in the joints of `hand.urdf`:

    joints              (j,)        names of the joints that are driven; the first six move the root
    stiffness, damping, force_limit, armature    (j,)    of their drives, N, m, rad, kg
    start               (N, 7)      pose of the hand's root where its six joints are 0: x y z, qw qx qy qz
    close               (N, K, j)   targets from pregrasp to squeeze; the first row is the pregrasp
    lift                (N, L, j)   targets of the lift; none where the object is pushed
    table               (4,)        normal of the table under the object, and its offset; NaN: there is none

and the numbers of `schedule.npz` of target `mjcf`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from importlib.resources import files
from math import isfinite
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.json_files import save_text
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.export.bodies import Bodies, BodyLink
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.schedule import closing_rows, lift_heights, limits_of, simulated
from grasp_refine.export.target import Readme
from grasp_refine.export.urdf import ROOT_JOINTS, save_urdf
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.rigid_groups import pose_of
from grasp_refine.validation.engines.root_joints import ROOT_LAG_S, ROOT_STIFFNESS, root_values
from grasp_refine.validation.simulation import Course

NO_LIMIT = 1e30
"""Force limit of drives without one."""


PROGRAMS = {"sapien": ("SAPIEN", "sapien 3"), "drake": ("Drake", "drake")}
"""Name of a target -> name of the program, and its package."""


@dataclass(frozen=True)
class UrdfFolder:
    """Folder for SAPIEN and ManiSkill, or for Drake; its URDFs are for any program."""

    name: str
    extra: str = ""

    @property
    def what(self) -> str:
        """Contents of the folder in a line."""
        return f"URDF of hand and object in convex pieces, and a script that simulates them in {PROGRAMS[self.name][0]}"

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write URDFs, meshes, the task and the script."""
        world, course = simulated(grasps)
        bodies = Bodies.of(world)
        save_urdf(bodies, grasps.speed_limits, folder)
        save_npz(folder / "task.npz", _task(world, bodies, course))
        script = files(__package__).joinpath(f"{self.name}_simulate.py").read_text(encoding="utf-8")
        save_text(folder / "simulate.py", script)
        program, package = PROGRAMS[self.name]
        return Readme(
            {
                "hand.urdf": "the hand below six joints that move its root; hand.srdf names links that never touch",
                "object.urdf": f"{grasps.name} in convex pieces, metres, its frame as in the grasps",
                "task.npz": "joint names, drives, targets over time, pushes and limits of the task",
                "simulate.py": f"simulates the task in {program} from these files alone; needs {package} and numpy",
            },
            use="python simulate.py",
            notes=(
                "start is the pose of the hand's root in the object's frame, x y z qw qx qy qz.",
                "Joints that follow others have targets of their own, and equal shares of the force of their servo.",
            ),
        )


def _task(world: World, bodies: Bodies, course: Course) -> dict[str, np.ndarray]:
    driven = {link.joint: link for link in bodies.links if link.parent and link.kind != "fixed"}
    mine = list(world.hand.joints)
    names = [name for name in mine if name in driven]
    drives = [_driver(driven, name) for name in names]
    # A joint and its followers share a servo: together, their drives are as stiff and as strong as the servo.
    count = Counter(drive.joint for drive in drives)
    gain = np.array([abs(_multiplier(driven[name], drive)) or 1.0 for name, drive in zip(names, drives, strict=True)])
    share = np.array([1.0 / count[drive.joint] for drive in drives]) / gain
    servos = np.array([(drive.stiffness, drive.damping, _finite(drive.force_limit)) for drive in drives]).reshape(-1, 3)
    stiffness, damping, limit = servos.T
    root = np.repeat(ROOT_STIFFNESS, 3)
    close = _targets(course, bodies, closing_rows(world.protocol), names, mine)
    task = {
        "joints": np.array([*ROOT_JOINTS, *names]),
        "stiffness": np.array([*root, *stiffness * share / gain]),
        "damping": np.array([*ROOT_LAG_S * root, *damping * share / gain]),
        "force_limit": np.array([*np.full(6, NO_LIMIT), *limit * share]),
        "armature": np.array([*np.zeros(6), *(driven[name].armature for name in names)]),
        "start": course.root(0, 0.0),
        "close": close,
        "lift": _lift(world, course, close),
        "friction": np.asarray(bodies.friction),
        "timestep": np.asarray(bodies.timestep),
        "gravity": world.model.opt.gravity.copy(),
        "table": _table(world),
    }
    return {**task, **limits_of(world)}


def _driver(driven: dict[str, BodyLink], name: str) -> BodyLink:
    """Return the link whose servo moves a joint: its own, or that of the joint that it follows."""
    link = driven[name]
    follows = link.leader is not None and not link.stiffness and link.leader[0] in driven
    return driven[link.leader[0]] if follows and link.leader is not None else link


def _multiplier(link: BodyLink, drive: BodyLink) -> float:
    """Return the values of a joint per value of the joint whose servo moves it."""
    return 1.0 if link.leader is None or link is drive else link.leader[1]


def _targets(
    course: Course, bodies: Bodies, times: list[tuple[int, float]], names: list[str], mine: list[str]
) -> Float[np.ndarray, "N K j"]:
    starts = transform_from_pose(course.root(0, 0.0))
    columns = [mine.index(name) for name in names]
    rows = []
    for stage, share in [(0, 0.0), *times]:
        values = course.joints[:, stage] + share * (course.joints[:, stage + 1] - course.joints[:, stage])
        now = transform_from_pose(course.root(stage, share))
        root = np.stack([root_values(*both) for both in zip(starts, now, strict=True)])
        rows.append(np.concatenate([root, (values - bodies.shift)[:, columns]], axis=1))
    return np.stack(rows, axis=1)


def _lift(world: World, course: Course, close: np.ndarray) -> Float[np.ndarray, "N L j"]:
    heights = lift_heights(world.protocol)
    lift = np.repeat(close[:, -1:], len(heights), axis=1)
    R = transform_from_pose(course.root(0, 0.0))[:, :3, :3]
    lift[..., :3] += heights[:, None] * (R.mT @ world.up)[:, None]
    return lift


def _table(world: World) -> Float[np.ndarray, " 4"]:
    """Return the normal (3,) of the table and its offset along it; NaN where there is none."""
    model = world.model
    planes = [geom for geom in range(model.ngeom) if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE]
    if not planes:
        return np.full(4, np.nan)
    normal = pose_of(model.geom_pos[planes[0]], model.geom_quat[planes[0]])[:3, 2]
    return np.array([*normal, normal @ model.geom_pos[planes[0]]])


def _finite(limit: float) -> float:
    return limit if isfinite(limit) else NO_LIMIT
