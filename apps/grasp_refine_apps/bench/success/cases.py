"""Cases of a study: a hand on an object, with grasps of one source; and how their problems are loaded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.core.se3 import exp_so3, pose_from_transform, transform
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.files.source import hand_files
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.spec import SAMPLE, ProblemSpec
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.scene_file import load_scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.bench.success.assets import (
    EMBEDDED,
    HandCase,
    ObjectCase,
    find_hands,
    matching_object,
    read_objects,
)

SAMPLED, PERTURBED, UNAWARE = "sampled", "perturbed", "sampled unaware of the scene"
"""Sources of grasps beside files."""

SHIFT_M, TURN_RAD = 0.005, np.radians(10.0)
"""Perturbation of grasps: distance in metres, angle in radians."""

SHRINKING, MIN_SCALE = 0.8, 0.4
"""Factor by which an object on which no grasp is found is scaled, again and again, and least factor in all."""


@dataclass(frozen=True)
class Case:
    """Grasps of one hand from one source; on one object, but for a grasp file with several."""

    spec: ProblemSpec
    """Hand, object and grasps, as for `run`."""
    hand: str = ""
    """Name of the hand in tables; empty: its own."""
    source: str = SAMPLED
    """Source of the grasps in tables."""
    object: ObjectCase | None = None
    """The object with its classes; None: they are not known."""
    count: int | None = None
    """Largest number of grasps on each object at each scale, taken from the first on; None: all."""
    requested: int | None = None
    """Number of grasps that are sampled, or taken from the file; None: all of the file."""

    @property
    def name(self) -> str:
        """Name for people, and of its files."""
        spec = self.spec
        hand, source = self.hand or spec.hand or "", self.source if spec.grasps is not None else ""
        where = self.object.name if self.object is not None else str(spec.scene or spec.object or "")
        return "/".join(filter(None, (source, hand, where))) or "example"


@dataclass(frozen=True)
class Axes:
    """Hands, objects, scenes and sources of grasps; every combination is a case."""

    spec: ProblemSpec = field(default_factory=ProblemSpec)
    """Inputs of all cases; without axes, the inputs of the only case."""
    assets: Path | None = None
    """Folder of assets, from which hands, objects and generators are chosen by name."""
    hands: tuple[str, ...] = ()
    """Hands, as for `run`, or of the assets; empty: all of the assets, or the hand of `spec`."""
    on: tuple[str, ...] = ()
    """Objects, as for `run`, or of the assets; empty: all of the assets, or the object of `spec`."""
    scenes: tuple[str, ...] = ()
    """Scenes; their objects are grasped."""
    generators: tuple[str, ...] = ()
    """Names of grasp files of the assets, and `SAMPLED`; empty: all. NAME:N takes N grasps, evenly from its
    file."""
    count: int | None = None
    """Number of sampled grasps in each case; of grasps of a file the largest number on each object at each scale."""
    generated: int = 20
    """Largest number of grasps of each generator on each object, evenly from its file."""
    every: int = 1
    """Each hand gets sampled grasps on every n-th object of the assets, each on others."""
    unaware: bool = False
    """Whether grasps are sampled and refined once more without knowing of the scene, which is simulated."""
    stand: str = "0,-0.55,0,0,0,90"
    """Pose x, y, z, roll, pitch, yaw of an arm's base from the origin of a scene's object, metres and degrees, world
    axes; where `spec` has none."""

    def cases(self) -> list[Case]:
        """Return all cases; cases of one hand and object follow each other.

        Raises:
            GraspRefineError: a hand, object, scene or generator does not exist.
        """
        if self.assets is not None:
            found = list(self._of_assets(self.assets))
            if not found:
                raise GraspRefineError("no grasps of these generators are of these hands and objects")
            return sorted(found, key=lambda case: (case.hand, case.object.name if case.object else ""))
        if self.scenes:
            return list(self._in_scenes())
        if not (self.hands or self.on):
            source = Path(self.spec.grasps).stem if self.spec.grasps is not None else "example"
            sampled = str(self.spec.grasps).startswith(SAMPLE)
            return [Case(self.spec, source=SAMPLED if sampled else source, count=None if sampled else self.count)]
        hands, things = self.hands or (self.spec.hand,), self.on or (self.spec.object,)
        for hand in filter(None, hands):
            hand_files(hand, self.spec.urdf, self.spec.mjcf, lambda line: None)
        return [
            Case(replace(self.spec, hand=hand, object=thing, grasps=self._sampled), hand or "")
            for hand in hands
            for thing in things
        ]

    @property
    def _sampled(self) -> Path:
        return Path(f"{SAMPLE}{self.count or 1}")

    def _of_assets(self, assets: Path) -> Iterator[Case]:
        """Yield the cases of a folder of assets."""
        objects = read_objects(assets)
        files = {file.stem: file for file in sorted((assets / "grasps" / "normalised").glob("*.npz"))}
        known = {thing.name: thing for thing in objects}
        _check("on", self.on, known)
        numbers = dict(_number_of(text, files) for text in self.generators)
        _check("generators", list(numbers), {SAMPLED: None, **files})
        of_assets = {hand.name: hand for hand in find_hands(assets)}
        plain = [name for name in self.hands if name not in of_assets and f"{EMBEDDED}{name}" in of_assets]
        plain += [name for name in self.hands if name not in of_assets and Path(name).exists()]
        _check("hands", [name for name in self.hands if name not in plain], of_assets)
        hands = {name: HandCase(name, name, name) for name in plain} | of_assets
        hands = {name: hand for name, hand in hands.items() if not self.hands or name in self.hands}
        if not self.generators or SAMPLED in self.generators:
            chosen = [thing for thing in objects if not self.on or thing.name in self.on]
            for number, hand in enumerate(hand for hand in hands.values() if hand.mjcf is None):
                for thing in (thing for at, thing in enumerate(chosen) if (at + number) % self.every == 0):
                    yield self._case(hand, thing, SAMPLED, self.count or 1, grasps=self._sampled, scale=thing.scale)
        for generator, file in files.items():
            if not self.generators or generator in numbers:
                yield from self._generated(generator, file, numbers.get(generator), list(hands.values()), objects)

    def _generated(
        self, generator: str, file: Path, number: int | None, hands: list[HandCase], objects: list[ObjectCase]
    ) -> Iterator[Case]:
        """Yield the cases of a generator, of its own hand alone; `number` grasps in all, or `generated` on each object.

        Raises:
            GraspRefineError: the file cannot be read, or names an object that is not one of the assets.
        """
        grasps = load_grasps(file)
        of_file = _evenly(len(grasps), number or 0)
        for name in dict.fromkeys(grasps.object.tolist()):
            thing = matching_object(name, objects)
            if self.on and thing.name not in self.on:
                continue
            rows = np.flatnonzero(grasps.object == name)
            some = np.flatnonzero(np.isin(rows, of_file)) if number else _evenly(len(rows), self.generated)
            if not len(some):
                continue
            # Some scale the mesh, others name one in metres.
            scale = thing.scale if (grasps.scale[rows[some]] == 1.0).all() else 1.0
            chosen = {"grasps": file, "object_name": name, "index": tuple(some.tolist()), "scale": scale}
            for hand in hands:
                if hand.base == grasps.hand and not hand.name.startswith(EMBEDDED):
                    yield self._case(hand, thing, generator, len(some), **chosen)

    def _case(self, hand: HandCase, thing: ObjectCase, source: str, requested: int, **inputs: Any) -> Case:
        files: dict[str, Any] = {"hand": hand.hand, "urdf": hand.urdf, "mjcf": hand.mjcf, "object": thing.source}
        return Case(replace(self.spec, **files, **inputs), hand.name, source, thing, requested=requested)

    def _in_scenes(self) -> Iterator[Case]:
        """Yield the cases of scenes; where grasps do not know of it, `Case.source` is `UNAWARE`.

        Raises:
            GraspRefineError: there is no such scene, hand or arm, the arm carries no hand, or a scene has no object.
        """
        spec, scenes = self.spec, [load_scene(name) for name in self.scenes]
        hands = {name: load_hand(name) for name in self.hands or (spec.hand or "",)}
        if nameless := [scene.name for scene in scenes if scene.object is None]:
            raise GraspRefineError(f"scene {nameless[0]} does not name the object to grasp: name it in its file")
        if spec.arm is not None:
            read_pose(self.stand, "--stand")
            arm = load_hand(spec.arm)
            for hand in hands.values():
                mount(arm, hand)
        for name, hand in hands.items():
            for scene in scenes:
                base = spec.base
                if spec.arm is not None and base is None:
                    place = read_pose(self.stand, "--stand")[:3, 3] + scene.T_world_object[:3, 3]
                    base = ",".join([*map(repr, place.tolist()), *self.stand.split(",")[3:]])
                case = replace(spec, hand=name, scene=str(scene.source), grasps=self._sampled, base=base)
                for source in (SAMPLED, UNAWARE)[: 1 + self.unaware]:
                    yield Case(case, hand.name, source, ObjectCase(scene.name, "", 1.0))


def _check(option: str, wanted: list[str] | tuple[str, ...], known: Mapping[str, object]) -> None:
    """Refuse a name that is not known.

    Raises:
        GraspRefineError: names it, and all that are known.
    """
    if unknown := [name for name in wanted if name not in known]:
        raise GraspRefineError(f"--{option} {unknown[0]}: there are {', '.join(known)}")


def _number_of(text: str, files: Mapping[str, Path]) -> tuple[str, int | None]:
    """Return the name and the number of grasps of NAME:N; other texts are names without one."""
    name, _, number = text.rpartition(":")
    return (name, int(number)) if name in files and number.isdecimal() and int(number) else (text, None)


def _evenly(count: int, number: int) -> np.ndarray:
    """Return at most `number` of the first `count` integers, at equal distances."""
    return np.unique(np.linspace(0, count - 1, min(number, count)).round().astype(int))


def load_case(case: Case, seed: int, cache: InputCache, *, shrink: bool = False) -> tuple[Problem, float]:
    """Load the grasps of a case, without targets; return them, and the factor by which the object was scaled besides.

    Args:
        case: The case.
        seed: Seed of sampled grasps.
        cache: Cache of inputs.
        shrink: Whether an object on which no grasp is found is scaled until one is, down to `MIN_SCALE`.

    Raises:
        GraspRefineError: an input cannot be used, or no grasp is found.
    """
    if case.spec.arm is not None and str(case.spec.grasps).startswith(SAMPLE) and case.spec.scene is not None:
        return _on_arm(case, seed), 1.0
    factor = 1.0
    while True:
        spec = case.spec if factor == 1.0 else replace(case.spec, scale=case.spec.scale * factor)
        try:
            problem = load_problem(spec, cache, seed=seed)
            break
        except GraspRefineError:
            factor *= SHRINKING
            if not (shrink and case.source == SAMPLED) or factor < MIN_SCALE:
                raise
    groups = []
    for group in problem.groups:
        rows, scene = np.arange(len(group.rows))[: case.count], replace(group.scene, target_link=None)
        groups.append(replace(group, scene=replace(scene, target_object=None)).select(rows))
    return placed(problem, groups), factor


def _on_arm(case: Case, seed: int) -> Problem:
    """Sample grasps of the hand alone, within reach of its arm or not, and put the hand on the arm.

    Raises:
        GraspRefineError: no grasp is found.
    """
    spec = case.spec
    hand, task = load_hand(spec.hand or ""), spec.read_task()
    whole = mount(load_hand(spec.arm or ""), hand)
    assert task.environment is not None  # cases of arms are in scenes
    obj = task.environment.load_object()
    if case.source == UNAWARE:
        task = Task(base=task.T_object_base)
    grasps = sample_grasps(hand, obj, int(str(spec.grasps).removeprefix(SAMPLE)), task=task, seed=seed)
    return problem_of(replace(whole, actuator=model_of(whole).actuator), obj, grasps, task=task)


def placed(problem: Problem, groups: list[Group]) -> Problem:
    """Return the problem of some groups of grasps, one after the other."""
    ends = np.cumsum([len(group.rows) for group in groups])
    groups = [
        replace(group, place=np.arange(end - len(group.rows), end)) for group, end in zip(groups, ends, strict=True)
    ]
    return replace(problem, groups=tuple(groups))


def perturbed(group: Group, seed: int) -> Group:
    """Return grasps moved by `moved_at_random`."""
    scene = group.scene
    T = moved_at_random(scene.hand, scene.T_world_root, [seed, crc32(scene.object.name.encode())])
    grasps = replace(group.grasps, hand_pose=pose_from_transform(T), pregrasp=None, squeeze=None)
    return replace(group, scene=replace(scene, T_world_root=T), grasps=grasps)


def moved_at_random(
    hand: Hand, T_world_root: Float[np.ndarray, "N 4 4"], seed: list[int]
) -> Float[np.ndarray, "N 4 4"]:
    """Return poses (N, 4, 4) moved by `SHIFT_M` and turned by `TURN_RAD` about the middle of the fingers, at random."""
    rng = np.random.default_rng(seed)
    T, center = T_world_root.copy(), closure_frame(hand).center
    for row in range(len(T)):
        direction, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        middle, R = T[row, :3, :3] @ center + T[row, :3, 3], exp_so3(TURN_RAD * axis)
        T[row] = transform(R @ T[row, :3, :3], middle + R @ (T[row, :3, 3] - middle) + SHIFT_M * direction)
    return T
