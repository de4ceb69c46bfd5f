"""Work on shards of a batch: from their inputs to their result files alone."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.names import is_folder
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.load import Loader
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refine import Listener, refine_groups, refine_problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.spec import AUTO, NEAREST
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import most_iterations
from grasp_refine.refinement.solvers.iterate import Progress
from grasp_refine.results.document import settings
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.verdict import advice, should_hold
from grasp_refine.validation.engine_table import EngineChoice
from grasp_refine_apps.batch.bundle import Bundle
from grasp_refine_apps.batch.digests import Digests
from grasp_refine_apps.batch.plan import ShardTask, task_digest
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.processes.task import Failed, Heartbeat
from grasp_refine_apps.processes.torch_threads import limit_torch_threads
from grasp_refine_apps.report.command_line import view_options

Result = TypeVar("Result")


@dataclass(frozen=True)
class BundleWork:
    """Work function that refines the grasps of shards, simulates them if enabled, and writes the result files."""

    config: Config
    """Settings of the refinement."""
    engines: tuple[EngineChoice, ...]
    """Engines that simulate the task of each grasp; none: nothing is simulated."""
    described: dict[str, Any]
    """All settings, for provenance."""
    profile: bool = False
    """Whether the time of each stage is measured."""

    def __call__(self, bundle: Bundle, heartbeat: Heartbeat) -> tuple[Done | Failed, ...]:
        """Work on the shards of a bundle; return the result of each: an exception fails its own shard only."""
        limit_torch_threads(self.config)
        if not self.profile:
            return self._results(bundle, heartbeat)
        with Stopwatch() as watch:
            found = self._results(bundle, heartbeat)
        profile: dict[str, tuple[float, float, int]] = {}
        profile |= {name: (one.cpu_s, one.wall_s, one.calls) for name, one in watch.spent.items()}
        # The stages of a bundle are counted once, with its first result.
        first = next((k for k, one in enumerate(found) if isinstance(one, Done)), None)
        return tuple(
            replace(one, profile=profile) if k == first and isinstance(one, Done) else one
            for k, one in enumerate(found)
        )

    def _results(self, bundle: Bundle, heartbeat: Heartbeat) -> tuple[Done | Failed, ...]:
        """Refine all shards that can be loaded in one batch, then write the result of each."""
        progress = _BundleProgress(heartbeat, bundle.size, most_iterations(self.config), simulates=bool(self.engines))
        costs = [Cost() for _ in bundle.shards]
        problems = [
            _attempt(cost, partial(self._load, shard, heartbeat))
            for shard, cost in zip(bundle.shards, costs, strict=True)
        ]
        loaded = [one for one in problems if isinstance(one, Problem)]
        parts: list[Outcome] | Failed | None = None
        if len(loaded) > 1:
            groups, together = [group for one in loaded for group in one.groups], Cost()
            parts = _attempt(together, partial(refine_groups, groups, self.config, progress))
            for problem, cost in zip(problems, costs, strict=True):
                if isinstance(problem, Problem):
                    cost.add(together, len(problem) / sum(map(len, loaded)))
        results: list[Done | Failed] = []
        for shard, problem, cost in zip(bundle.shards, problems, costs, strict=True):
            if isinstance(problem, Failed):
                results.append(problem)
                continue
            own = None
            if isinstance(parts, list):
                # Where they fail together, each shard is refined, and fails, alone.
                own, parts = parts[: len(problem.groups)], parts[len(problem.groups) :]
            results.append(self._result(shard, problem, own, cost, progress))
        return tuple(results)

    def _load(self, shard: Shard, heartbeat: Heartbeat) -> Problem:
        return problem_of(shard.task, self.config.seed, cache_of(shard.task.batch), heartbeat)

    def _result(
        self, shard: Shard, problem: Problem, parts: list[Outcome] | None, cost: Cost, progress: _BundleProgress
    ) -> Done | Failed:
        """Refine the grasps of a shard unless there are `parts`, write its file, and return what it took in all."""
        done = _attempt(cost, partial(self._written, shard, problem, parts, progress))
        return done if isinstance(done, Failed) else replace(done, wall_s=cost.wall_s, cpu_s=cost.cpu_s)

    def _written(self, shard: Shard, problem: Problem, parts: list[Outcome] | None, progress: _BundleProgress) -> Done:
        task, cache = shard.task, cache_of(shard.task.batch)
        refined = refine_problem(
            problem, self.config, engines=self.engines, listener=progress, cache=cache, threads=1, parts=parts
        )
        outcome, simulated = refined.outcome, refined.simulated
        if task.sampled is None:
            # Rows of the whole file; the problem contains only some of them.
            outcome = replace(outcome, row=task.rows[outcome.row], index=task.index[outcome.index])
        progress.heartbeat("writing", 1.0, progress.total)
        self._save(shard, replace(refined, outcome=outcome))
        good = should_hold(outcome.quality[:, 0]), should_hold(outcome.quality[:, 1])
        return Done(
            grasps=len(outcome),
            usable=int(outcome.usable.sum()),
            good=(int(good[0].sum()), int(good[1].sum())),
            held=None if simulated is None else (int(simulated.held[:, 0].sum()), int(simulated.held[:, 1].sum())),
            wall_s=0.0,
            cpu_s=0.0,
            peak_bytes=peak_bytes(),
            notes=tuple(note for note in problem.notes if note not in problem.convention_notes),
            convention_notes=problem.convention_notes,
        )

    def _save(self, shard: Shard, refined: RefinedGrasps) -> None:
        task = shard.task
        provenance = {
            "config": self.described
            | {"inputs": settings(task.inputs)}
            | ({} if refined.simulated is None else {"protocol": settings(refined.simulated.protocol)}),
            "source": task.source,
            "batch": {"stamp": shard.stamp, "job": task.job, "look": view_options(task.inputs)},
            "advice": advice(refined.outcome, self.config),
        }
        name = str(refined.outcome.object[0])
        refined.write({name: shard.path}, {name: provenance})


@dataclass
class Cost:
    """Time spent on a shard, seconds."""

    wall_s: float = 0.0
    cpu_s: float = 0.0

    def add(self, other: Cost, share: float) -> None:
        """Add a share of another cost."""
        self.wall_s += share * other.wall_s
        self.cpu_s += share * other.cpu_s


def _attempt(cost: Cost, work: Callable[[], Result]) -> Result | Failed:
    """Return the result of some work, or its failure, and count its time."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        return work()
    except Exception as error:
        return Failed.of(error)
    finally:
        cost.add(Cost(time.perf_counter() - wall, time.process_time() - cpu), 1.0)


@lru_cache(maxsize=1)
def cache_of(batch: str) -> InputCache:
    """Return the cache of this process for one batch; for another one files may have changed."""
    return InputCache()


@dataclass
class _BundleProgress(Listener):
    """Listener that reports the share of a bundle that is done."""

    heartbeat: Heartbeat
    """Receiver of the share."""
    total: int
    """Number of grasps of the bundle."""
    most: int
    """Maximum iterations of a grasp."""
    simulates: bool
    """Whether grasps are simulated, which counts for half."""
    share: float = 0.0
    """Largest share so far."""
    refined: int = 0
    """Largest number of refined grasps so far."""
    counted: int = 0
    """Number of grasps of the groups refined before."""
    simulated: int = 0
    """Number of grasps of the groups simulated before."""

    def refining(self, groups: Sequence[Group]) -> Progress:
        """Return the progress callback of `refine` for groups."""
        before, count = self.counted, sum(len(group.rows) for group in groups)
        self.counted += count

        def progress(finished: int, iteration: int, mean_loss: float) -> None:
            # Most grasps finish late: running grasps count by their share of iterations.
            done = before + finished + (count - finished) * min(iteration / self.most, 1.0)
            self._report("refining", 0.5 * done if self.simulates else done, before + finished)

        return progress

    def simulating(self, group: Group) -> Callable[[str, float], None]:
        """Return the callback of the simulation of a group."""
        before, count = self.simulated, len(group.rows)
        self.simulated += count
        return lambda what, done: self._report(what, 0.5 * (self.total + before + 0.5 * count), self.total)

    def _report(self, what: str, done: float, refined: int) -> None:
        # Another start may resume finished grasps.
        self.share = max(self.share, done / max(self.total, 1))
        self.refined = max(self.refined, refined)
        self.heartbeat(what, self.share, self.refined)


def problem_of(task: ShardTask, seed: int, cache: InputCache, heartbeat: Heartbeat) -> Problem:
    """Load the grasps of a shard with hand and objects; rows and indices count within the shard."""

    def say(line: str) -> None:
        heartbeat(line, 0.0)

    inputs = task.inputs
    loader = Loader(inputs, seed, say, say, cache)
    heartbeat("loading", 0.0)
    path = loader.grasp_path() if task.sampled is None else None
    planned = (task.source.get("sha256"), *task.hand, task.object, task.object_digest, task.task_digest)
    cache.get("unchanged", (inputs, *planned), lambda: check_unchanged(task, loader, path))
    if task.sampled is not None:
        count, draw = task.sampled
        return loader.prepare(loader.to_sample(count), draw=draw)
    assert path is not None
    read = loader.read(path)
    some = replace(read, grasps=read.grasps.select(task.rows))
    # Targets were read with the file.
    targets = NEAREST if inputs.targets == NEAREST else AUTO
    aimed = replace(loader, spec=replace(inputs, object_name=task.object, targets=targets))
    return aimed.prepare(aimed.of_grasps(some, path))


def unusable_objects(shards: Sequence[Shard], progress: Callable[[int], None]) -> dict[int, Failed]:
    """Return failures, by number, of shards whose object is an unusable mesh; found before any mesh is cut.

    Folders of pieces are left to the workers: they need not be cut. `progress` is called with the number of shards
    checked so far.
    """
    cache, failed = InputCache(), {}
    for count, shard in enumerate(shards):
        progress(count)
        task = shard.task
        if is_folder(Path(task.object_source.source)):
            continue
        try:
            for scale in task.scales:
                Loader(task.inputs, cache=cache).read_object(task.object_source, scale)
        except Exception as error:
            failed[shard.number] = Failed.of(error)
    return failed


def check_unchanged(task: ShardTask, loader: Loader, path: Path | None) -> None:
    """Refuse inputs that changed since the shard was planned; `path` is that of its grasps, None if they are sampled.

    Raises:
        GraspRefineError: names the changed input; the stamp would be wrong.
    """
    digests, (source, hand), where = Digests(), task.hand, task.object_source
    if path is not None:
        named = replace(loader, spec=replace(loader.spec, object_name=task.object))
        where = named.named_objects(loader.read(path).grasps, path)[task.object]
    for what, planned, now in (
        (str(path), task.source.get("sha256"), None if path is None else digests.file(path)["sha256"]),
        (f"hand {source}", hand, digests.hand(source, loader.spec, loader.on_message)[1]),
        (f"object {task.object}", task.object_digest, digests.object(where)),
        ("scene, protocol, regions or targets", task.task_digest, task_digest(loader, digests)),
    ):
        if now != planned:
            raise GraspRefineError(f"{what}: changed since the batch was planned; give the same command again")


def peak_bytes() -> int:
    """Largest resident memory of this process so far, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
