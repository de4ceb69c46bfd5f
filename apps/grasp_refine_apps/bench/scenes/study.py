"""The benchmark of scenes: sampled grasps on an arm, before and after refinement, along their trajectories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.core.se3 import transform
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.motion.execution import follow
from grasp_refine.motion.plan import plan_motions
from grasp_refine.objects.object import load_object
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.refine import refine_group
from grasp_refine.refinement.config import Config
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.scene_file import list_scenes, load_scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.jobs import Job, Progress, part_of
from grasp_refine_apps.bench.report import Column, Report, Table

COUNTS = ("free", "held", "clean")
"""Keys of rows with numbers before and after: trajectories that are free, objects that were held and lifted along them,
and those of them with nothing hit."""

FALLEN_M = 1.0
"""Displacement in metres from which on a neighbour fell off what it stood on."""


@dataclass(frozen=True)
class ScenesStudy:
    """Settings of a run."""

    scenes: tuple[str, ...] = ()
    """Scenes, as for `load_scene`; empty: all that come with the program."""
    hands: tuple[str, ...] = ("allegro", "shadow")
    """Hands, as for `load_hand`."""
    arm: str = "ur5e"
    """Arm that carries them, as for `load_hand`."""
    base: str = "0,-0.55,0,0,0,90"
    """Pose x, y, z, roll, pitch, yaw of its base from the origin of the object, metres and degrees, world axes."""
    count: int = 32
    """Number of sampled grasps of each hand in each scene."""
    seed: int = 0
    workers: int = 1

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each hand and scene.

        Raises:
            GraspRefineError: a hand, the arm or a scene cannot be read, or the arm carries no hand.
        """
        T_base = read_pose(self.base, "--base")
        scenes = [load_scene(name) for name in self.scenes or list_scenes()]
        if nameless := [scene.name for scene in scenes if scene.object is None]:
            raise GraspRefineError(f"scene {nameless[0]} does not tell which object to grasp: name it in its file")
        arm = load_hand(self.arm)
        hands = [(hand, mount(arm, hand)) for hand in map(load_hand, self.hands)]
        return [
            Job(f"{hand.name} in {scene.name}", SceneTask(hand, whole, scene, T_base, self.count, self.seed).run)
            for hand, whole in hands
            for scene in scenes
        ]

    def rows(self, done: Sequence[Sequence[Row]]) -> list[Row]:
        """Return the rows of all scenes together, then of each, of each hand with and without knowledge of them."""
        each = [row for rows in done for row in rows]
        groups: dict[tuple[str, bool], list[Row]] = {}
        for row in each:
            groups.setdefault((row["hand"], row["known"]), []).append(row)
        pooled = [
            {
                **{"hand": hand, "scene": "all", "known": known},
                **{key: sum(row[key] for row in rows) for key in ("grasps", "reachable")},
                **{key: np.sum([row[key] for row in rows], axis=0).tolist() for key in COUNTS},
                "pushed_m": max(row["pushed_m"] for row in rows),
            }
            for (hand, known), rows in groups.items()
        ]
        return [*pooled, *each]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return a table of grasps that know of their scene, and one of those that do not."""
        labelled = [{**row, "label": f"{row['hand']} {row['scene']}"} for row in rows]
        columns = [
            Column("label", "hand and scene"),
            Column("grasps", "grasps", form="d"),
            Column("reachable", "reach\u00adable", form="d"),
            Column("free", "trajectory is free", form=_both),
            Column("held", "held and lifted", form=_both),
            Column("clean", "and nothing hit", form=_both),
            Column("pushed_m", "neighbour pushed, at most", "mm", _pushed),
        ]
        heads = {True: "Sampled, refined and planned in the scene", False: "The same without knowing of the scene"}
        tables = [
            Table(f"{head}: before → after refinement", columns, [row for row in labelled if row["known"] == known])
            for known, head in heads.items()
        ]
        return Report("Grasps in scenes", tables)


def _both(counts: Sequence[int]) -> str:
    return f"{counts[0]} → {counts[1]}"


def _pushed(distance: float) -> str:
    return f"{1e3 * distance:.1f}" if distance < FALLEN_M else "fell off"


@dataclass(frozen=True, eq=False)
class SceneTask:
    """Grasps of a hand on an arm in a scene."""

    hand: Hand
    """The hand alone, which is sampled."""
    whole: Hand
    """The hand on its arm."""
    scene: Environment
    T_object_base: Float[np.ndarray, "4 4"]
    """Pose of the base of the arm from the origin of the object, along the axes of the world."""
    count: int
    seed: int

    def run(self, progress: Progress) -> list[Row]:
        """Sample, refine, plan and follow in simulation; return a row with knowledge of the scene, and one without.

        Either way the simulation has the whole scene. Trajectories are planned with what is known, so that without
        knowledge free ones may hit something.

        Raises:
            GraspRefineError: no grasp is found, or MuJoCo cannot compile the world.
        """
        whole = self.whole
        obj = load_object(self.scene.object or "", scale=self.scene.scale, unit="m")
        model = model_of(whole)
        world = build_world(model, obj, Task(SCENE, scene=self.scene))
        T_world_base = transform(np.eye(3), self.scene.T_world_object[:3, 3]) @ self.T_object_base
        rows = []
        for at, known in enumerate((True, False)):
            share = part_of(progress, at / 2, 0.5)
            base = T_world_base if known else np.linalg.inv(self.scene.T_world_object) @ T_world_base
            task = Task(scene=self.scene if known else None, base=base)
            grasps = sample_grasps(self.hand, obj, self.count, task=task, seed=self.seed)
            problem = problem_of(replace(whole, actuator=model.actuator), obj, grasps, task=task)
            (group,) = problem.groups
            outcome = refine_group(group, Config(seed=self.seed))
            share(0.4)
            refined = outcome.posed(group.scene), outcome.motion
            counts, pushed = [], []
            for stage, (given, motion) in enumerate([(group.scene, group.motion()), refined]):
                planned = plan_motions(given, motion)
                found = follow(world, whole, planned, threads=1)
                counts.append([sum(plan.free for plan in planned), found.held.sum(), (found.held & found.clean).sum()])
                pushed.append(np.nanmax(found.pushed_m, initial=0.0))
                share(0.7 + 0.3 * stage)
            rows.append(
                {
                    **{"hand": self.hand.name, "scene": self.scene.name, "known": known, "grasps": len(grasps)},
                    "reachable": int((~group.scene.out_of_reach).sum()),
                    **{key: [int(both[k]) for both in counts] for k, key in enumerate(COUNTS)},
                    "pushed_m": float(max(pushed)),
                }
            )
        return rows
