"""Trials of the grasps of a shard in simulation, in one way: as given, by geometry only, and refined."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from grasp_refine.closing.motion import Motion, motion_of
from grasp_refine.core.json_files import dumps
from grasp_refine.core.short_repr import labels
from grasp_refine.grasps.formats.folders import object_folder
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.results.document import settings
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation.engine_choice import EngineName, engine_of
from grasp_refine.validation.robustness import judge
from grasp_refine.validation.trials import Reason, Trials
from grasp_refine_apps.batch.digests import sha256_of
from grasp_refine_apps.batch.plan import ShardTask
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.batch.work import cache_of, peak_bytes, problem_of
from grasp_refine_apps.processes.task import Heartbeat

GIVEN, GEOMETRY, REFINED = "as given", "geometry only", "refined"
METHODS = (GIVEN, GEOMETRY, REFINED)
"""Names of what is compared: the grasps as they came, and after each of the two refinements."""

LAYOUT_VERSION = 1
"""Version of the layout of the files of trials; a new number makes all outdated."""


@dataclass(frozen=True)
class Trial:
    """Way to try grasps: a protocol, in an engine."""

    protocol: Protocol
    """Protocol of the simulation."""
    engine: EngineName = "mujoco"
    """Engine of the simulation."""

    @property
    def label(self) -> str:
        """Name for people: that of the protocol, with the engine where it is not MuJoCo."""
        name = self.protocol.name
        return name if self.engine == "mujoco" else f"{name} in {self.engine.capitalize()}"

    @property
    def folder(self) -> Path:
        """Folder of its files in that of the evidence."""
        return Path("trials", self.engine, object_folder(self.protocol.name))


@dataclass(frozen=True)
class TrialsTask:
    """Trials of the grasps of a shard that was refined in both ways."""

    task: ShardTask
    """Inputs of the shard."""
    files: Mapping[str, Path]
    """Result files of the two refinements by method."""
    trial: Trial
    """Way to try them."""


@dataclass(frozen=True)
class TrialsWork:
    """Work function that simulates the grasps of a shard in one way, and writes a file of trials."""

    words: ClassVar[tuple[str, str]] = ("simulating", "simulated")
    """Verb of its progress, and the participle."""
    seed: int
    """Random seed of the refinements."""

    def __call__(self, shard: Shard, heartbeat: Heartbeat) -> Done:
        """Work on a shard.

        The file holds, for each of `METHODS` as `key_of` writes it, the `Reason` of its outcome as text and the
        CPU time in seconds of each grasp (N,), in the order of the result files.

        Raises:
            GraspRefineError: an input cannot be used, or the file cannot be written.
        """
        wall, cpu = time.perf_counter(), time.process_time()
        task: TrialsTask = shard.task
        cache = cache_of(task.task.batch)
        # The trials of a shard in several ways follow each other.
        load = partial(problem_of, task.task, self.seed, cache, heartbeat)
        problem = cache.get("problem", task.files[REFINED], load)
        held: dict[str, np.ndarray] = {}
        entries: dict[str, np.ndarray] = {}
        for number, method in enumerate(METHODS):
            heartbeat(f"{task.trial.label}, {method}", number / len(METHODS))
            began = time.process_time()
            trials = _simulated(problem, _motions(task, problem, method), task.trial, cache)
            spent = time.process_time() - began
            held[method] = trials.success
            entries |= {
                f"{key_of(method)}_reason": labels(Reason, trials.outcome),
                f"{key_of(method)}_cpu_s": np.full(len(trials), spent / len(trials)),
            }
        provenance = {"batch": {"stamp": shard.stamp, "job": task.task.job}, **settings(task.trial)}
        save_npz(shard.path, {**entries, "provenance": np.array(dumps(provenance))})
        before, after = (int(held[method].sum()) for method in (GIVEN, REFINED))
        return Done(
            grasps=shard.size,
            usable=len(problem),
            good=(0, 0),
            held=(before, after),
            wall_s=time.perf_counter() - wall,
            cpu_s=time.process_time() - cpu,
            peak_bytes=peak_bytes(),
        )


def trials_shards(refined: Mapping[str, Sequence[Shard]], trials: Sequence[Trial], out: Path) -> list[Shard]:
    """Return the shards of the trials of all grasps that were refined in both ways, one for each way to try them.

    Args:
        refined: Method -> complete shards of its batch, in the folder of its name of `out`.
        trials: Ways to try them.
        out: Folder of the evidence.
    """
    found: list[Shard] = []
    for place, shards in refined_in_both(refined, out).items():
        first = shards[REFINED]
        files = {method: shard.path for method, shard in shards.items()}
        for trial in trials:
            found.append(
                Shard(
                    number=len(found),
                    group=first.group,
                    name=f"{first.name}, {trial.label}",
                    size=first.size,
                    path=out / trial.folder / place,
                    stamp=sha256_of([LAYOUT_VERSION, [shard.stamp for shard in shards.values()], settings(trial)]),
                    task=TrialsTask(first.task, files, trial),
                )
            )
    return found


def refined_in_both(refined: Mapping[str, Sequence[Shard]], out: Path) -> dict[Path, dict[str, Shard]]:
    """Return the shards that all batches completed: place in the folder of the batch -> method -> shard."""
    by_place = {
        method: {shard.path.relative_to(folder_of(method, out)): shard for shard in shards}
        for method, shards in refined.items()
    }
    return {
        place: {method: shards[place] for method, shards in by_place.items()}
        for place in by_place[REFINED]
        if all(place in shards for shards in by_place.values())
    }


def folder_of(method: str, out: Path) -> Path:
    """Folder of the results of a refinement in that of the evidence."""
    return out / method.replace(" ", "-")


def key_of(method: str) -> str:
    """Beginning of the entries of one of `METHODS` in files of trials."""
    return method.replace(" ", "_")


def _motions(task: TrialsTask, problem: Problem, method: str) -> list[Motion]:
    """Motion of each group that closes the hand; as given, with the stages of the grasp file where it has them."""
    if method == GIVEN:
        cache = cache_of(task.task.batch)
        return [cache.get("motion", (task.files[REFINED], group.scale), group.motion) for group in problem.groups]
    grasps = load_grasps(task.files[method])
    return [motion_of(grasps.select(group.place), problem.hand) for group in problem.groups]


def _simulated(problem: Problem, motions: Sequence[Motion], trial: Trial, cache: InputCache) -> Trials:
    """Trials of the grasps of a problem, in the requested order."""
    problem, parts = problem.for_task(Task(trial.protocol)), []
    for group, motion, world in zip(problem.groups, motions, worlds_of(problem, cache=cache), strict=True):
        engine = cache.get("engine", (trial.engine, world), partial(engine_of, trial.engine, world))
        parts.append(judge(world, motion, numbers=group.rows, threads=1, first_failure=True, engine=engine))
    return Trials.join(parts).select(problem.order)
