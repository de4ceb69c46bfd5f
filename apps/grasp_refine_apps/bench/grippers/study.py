"""The benchmark of grippers: sampled grasps, and the same ones perturbed, before and after refinement.

Objects are scaled as objects.csv suggests or, where no grasp is found, by ever smaller factors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, transform_from_pose
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.evidence.cases import ObjectCase, read_objects
from grasp_refine_apps.bench.hold.measure import GroupTask, Method
from grasp_refine_apps.bench.jobs import Job, Progress
from grasp_refine_apps.bench.report import Column, Report, Table

ASSETS_OBJECTS = (
    *("ycb_005_tomato_soup_can", "ycb_007_tuna_fish_can", "ycb_011_banana", "ycb_013_apple", "ycb_021_bleach_cleanser"),
    *("ycb_035_power_drill", "ycb_037_scissors", "ycb_044_flat_screwdriver", "ycb_051_large_clamp"),
    *("ycb_056_tennis_ball", "ycb_061_foam_brick", "ycb_065c_cups", "ycb_077_rubiks_cube", "robosuite_bottle"),
    *("robosuite_can", "robosuite_lemon", "rdg_hammer_40", "rdg_stapler_gray_d9", "rdg_mug_gray_d7", "tm_rabbit"),
)
"""Objects of a folder of assets, names in objects.csv."""

SHIFT_M, TURN_RAD = 0.005, np.radians(10.0)
"""Perturbation of sampled grasps: distance in metres, angle in radians."""

SHRINKING, MIN_SCALE = 0.8, 0.4
"""Factor by which an object on which no grasp is found is scaled, again and again, and least factor in all."""

KINDS = ("sampled", "perturbed")
"""Kinds of grasps of a job, as many of each."""

_ONE, _SEVERAL = (replace(DEXGRASPBENCH, palm="rigid", multiccd=several) for several in (False, True))

PROTOCOLS = {
    "friction 0.6": _SEVERAL,
    "friction 0.6, one point": _ONE,
    "friction 0.3": _SEVERAL.with_friction(0.3),
    "friction 0.3, one point": _ONE.with_friction(0.3),
}
"""Ways to simulate."""


@dataclass(frozen=True)
class GrippersStudy:
    """Settings of a run."""

    hands: tuple[str, ...]
    """Grippers, as for `load_hand`."""
    objects: tuple[str, ...]
    """Names in objects.csv or, without assets, objects as for `load_object`; empty: `ASSETS_OBJECTS`."""
    assets: Path | None = None
    """Folder with objects and objects.csv."""
    count: int = 4
    """Number of sampled grasps of each gripper on each object."""
    seed: int = 0
    """Seed of samples, perturbations and refinement."""
    workers: int = 1

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each gripper and object.

        Raises:
            GraspRefineError: a gripper cannot be read, or there is no such object.
        """
        things = [ObjectCase(name, name, 1.0) for name in self.objects]
        if self.assets is not None:
            known = {case.name: case for case in read_objects(self.assets)}
            names = self.objects or ASSETS_OBJECTS
            if unknown := [name for name in names if name not in known]:
                raise GraspRefineError(f"--objects {unknown[0]}: there are {', '.join(known)}")
            things = [known[name] for name in names]
        hands: list[Hand] = [load_hand(name) for name in self.hands]
        return [
            Job(f"{hand.name} on {thing.name}", GripperTask(hand, thing, self.count, self.seed).run)
            for hand in hands
            for thing in things
        ]

    def rows(self, done: Sequence[Sequence[Row]]) -> list[Row]:
        """Return the rows of each gripper and kind of grasps: over all objects, then of each object."""
        each = [row for rows in done for row in rows]
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in each:
            groups.setdefault((row["hand"], row["kind"]), []).append(row)
        pooled = [
            {
                **{key: rows[0][key] for key in ("hand", "kind", "label")},
                "object": "all",
                "scale": None,
                "grasps": sum(row["grasps"] for row in rows),
                "held": [np.sum([row["held"][k] for row in rows], axis=0).tolist() for k in range(len(PROTOCOLS))],
            }
            for rows in groups.values()
        ]
        return [*pooled, *each]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return the table of all objects, and of the objects on which grasps are lost."""
        parts = ([row for row in rows if (row["object"] == "all") == pooled] for pooled in (True, False))
        pooled, each = ([{**row, "trials": _trials(row)} for row in part] for part in parts)
        held = [Column(f"trials.{k}", name, "%", _held) for k, name in enumerate(PROTOCOLS)]
        lost = [
            {**row, "label": f"{row['label']} {row['object']}"}
            for row in each
            if any(before_not_after for *_, before_not_after in row["held"])
        ]
        first = [Column("label", "grasps"), Column("grasps", "number", form="d")]
        tables = [Table("Held before → after refinement (and lost of those that held)", [*first, *held], pooled)]
        if lost:
            tables.append(Table("Objects on which grasps are lost", [*first, *held], lost))
        scaled = [row for row in each if row["scale"] != 1.0]
        if scaled:
            columns = [*first, Column("object", "object"), Column("scale", "scaled by", form=".2f")]
            tables.append(Table("Objects on which grasps are found at a smaller scale only", columns, scaled))
        return Report("Grasps of grippers", tables)


def _trials(row: Row) -> dict[str, tuple[float, float, int]]:
    """Shares that held before and after and number lost, by number of the protocol."""
    return {
        str(k): (before / row["grasps"], after / row["grasps"], lost)
        for k, (before, after, lost) in enumerate(row["held"])
    }


def _held(trials: tuple[float, float, int]) -> str:
    before, after, lost = trials
    return f"{100.0 * before:.1f} → {100.0 * after:.1f}" + (f" ({lost})" if lost else "")


@dataclass(frozen=True, eq=False)
class GripperTask:
    """Grasps of a gripper on an object."""

    hand: Hand
    object: ObjectCase
    count: int
    seed: int

    def run(self, progress: Progress) -> list[Row]:
        """Sample, perturb, refine and simulate grasps; return a row for each of `KINDS`.

        Its entry `held` has, for each of `PROTOCOLS`, the numbers of grasps that held before, after, and before only.

        Raises:
            GraspRefineError: no grasp is found, even on the smallest object.
        """
        model = model_of(self.hand)
        scene, factor = sampled(replace(self.hand, actuator=model.actuator), self.object, self.count, self.seed)
        moved = perturbed(scene, self.seed)
        both = [np.concatenate([getattr(part, name) for part in (scene, moved)]) for name in ("T_world_root", "q")]
        scene = replace(scene, T_world_root=both[0], q=both[1])
        methods = Method("as-came"), Method("forces", Config.starts)
        task = GroupTask(self.object.name, scene, None, model, methods, PROTOCOLS, Config.width, self.seed, 1)
        before, after = (
            np.stack([found.reason[name] == Reason.HELD for name in PROTOCOLS]) for found in task.run(progress)
        )
        counts = np.stack([before, after, before & ~after], axis=1)
        return [
            {
                **{"hand": self.hand.name, "kind": kind, "label": f"{self.hand.name} {kind}"},
                **{"object": self.object.name, "scale": factor, "grasps": part.shape[-1]},
                "held": part.sum(axis=-1).tolist(),
            }
            for kind, part in zip(KINDS, np.split(counts, 2, axis=-1), strict=True)
        ]


def sampled(hand: Hand, thing: ObjectCase, count: int, seed: int) -> tuple[Scene, float]:
    """Return sampled grasps, and the factor by which the object was scaled beyond its scale.

    Raises:
        GraspRefineError: no grasp is found, even on the smallest object.
    """
    factor = 1.0
    while True:
        obj: Object = load_object(thing.source, scale=thing.scale * factor)
        try:
            grasps = sample_grasps(hand, obj, count, seed=seed)
        except GraspRefineError:
            factor *= SHRINKING
            if factor < MIN_SCALE:
                raise
            continue
        return Scene(hand, obj, transform_from_pose(grasps.hand_pose), grasps.q), factor


def perturbed(scene: Scene, seed: int) -> Scene:
    """Return the grasps of a scene, each moved by `SHIFT_M` and turned by `TURN_RAD` about the middle of its pads."""
    rng = np.random.default_rng([seed, crc32(scene.object.name.encode())])
    T = scene.T_world_root.copy()
    center = closure_frame(scene.hand).center
    for row in range(len(T)):
        direction, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        middle = T[row, :3, :3] @ center + T[row, :3, 3]
        R = exp_so3(TURN_RAD * axis)
        T[row, :3, 3] = middle + R @ (T[row, :3, 3] - middle) + SHIFT_M * direction
        T[row, :3, :3] = R @ T[row, :3, :3]
    return replace(scene, T_world_root=T)
