"""The work on a shard of a batch: from its inputs to its result file, and to nothing else."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.names import is_folder
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.versions import versions
from grasp_refine.pipeline.problem import Problem
from grasp_refine.pipeline.recorded_objects import object_entries
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import most_iterations
from grasp_refine.results.document import settings
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.result_files import fingerprint, save_results
from grasp_refine.results.verdict import advice, should_hold
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.trials import Trials
from grasp_refine_apps.batch.attempt import message_of, traceback_of
from grasp_refine_apps.batch.shard import Beat, Done, Failed, Shard
from grasp_refine_apps.commands.digests import Digests
from grasp_refine_apps.commands.input_cache import Kept, KeptInputs, kept_for
from grasp_refine_apps.commands.inputs import AUTO, NEAREST, Inputs
from grasp_refine_apps.commands.invocation import words
from grasp_refine_apps.commands.refining import proved, refined
from grasp_refine_apps.commands.shard_plan import Task
from grasp_refine_apps.commands.sources import on_disk


@dataclass(frozen=True)
class ShardWork:
    """Refines the grasps of a shard, simulates them if asked, and writes the result file."""

    config: Config
    """How grasps are refined."""
    protocol: Protocol | None
    """How they are simulated; None: not at all."""
    described: dict[str, Any]
    """All settings, for provenance."""
    profile: bool = False
    """Whether it is told where the time goes."""

    def __call__(self, shard: Shard, beat: Beat) -> Done:
        """Do it.

        Raises:
            GraspRefineError: something cannot be used, or the file cannot be written.
        """
        # It takes a second to load, which only workers need.
        import torch

        # Each worker has a core of its own.
        torch.set_num_threads(1)
        if not self.profile:
            return self._done(shard, beat)
        with Stopwatch() as watch:
            done = self._done(shard, beat)
        profile: dict[str, tuple[float, float, int]] = {}
        profile |= {name: (one.cpu_s, one.wall_s, one.calls) for name, one in watch.spent.items()}
        return replace(done, profile=profile)

    def _done(self, shard: Shard, beat: Beat) -> Done:
        wall, cpu = time.perf_counter(), time.process_time()
        task, kept = shard.task, kept_for(shard.task.batch)
        problem = problem_of(task, self.config.seed, kept, beat)
        parts, trials = [], []
        share = _Share(beat, len(problem), self._most(), proves=self.protocol is not None)
        for group in problem.groups:
            share.group(len(group.rows))
            prepared = kept.get("prepared", (problem.hand, group.scene.object), partial(HandObject.of, group.scene))
            parts.append(refined(group, self.config, share.refining, prepared))
            if self.protocol is not None:
                world = kept.get(
                    "world",
                    (problem.hand, group.scene.object, self.protocol, group.scene.table),
                    partial(_world, kept, problem.hand, group.scene.object, self.protocol, group.scene.table),
                )
                trials.append(proved(group, parts[-1], world, share.proving, threads=1))
        outcome = Outcome.join(parts).select(problem.order)
        proof = None
        if trials:
            before, after = (Trials.join(side).select(problem.order) for side in zip(*trials, strict=True))
            proof = before, after
        if task.sampled is None:
            # The rows of the whole file, of which the problem has only some.
            outcome = replace(outcome, row=task.rows[outcome.row], index=task.index[outcome.index])
        beat("writing", 1.0, len(outcome))
        self._save(shard, problem, outcome, proof)
        good = should_hold(outcome.quality[:, 0]), should_hold(outcome.quality[:, 1])
        return Done(
            number=shard.number,
            grasps=len(outcome),
            usable=int(outcome.usable.sum()),
            good=(int(good[0].sum()), int(good[1].sum())),
            held=None if proof is None else (int(proof[0].success.sum()), int(proof[1].success.sum())),
            wall_s=time.perf_counter() - wall,
            cpu_s=time.process_time() - cpu,
            peak_bytes=peak_bytes(),
            notes=tuple(note for note in problem.notes if note not in problem.convention_notes),
            convention_notes=problem.convention_notes,
        )

    def _most(self) -> int:
        """Most iterations of a grasp, to tell how far it is."""
        return most_iterations(self.config) if self.config.holds else self.config.solver.iterations

    def _save(self, shard: Shard, problem: Problem, outcome: Outcome, proof: tuple[Trials, Trials] | None) -> None:
        task = shard.task
        provenance = {
            "versions": versions(),
            "seed": self.config.seed,
            "config": self.described | {"inputs": settings(task.inputs)},
            "source": task.source,
            "urdf": fingerprint(problem.hand.urdf),
            "objects": object_entries(problem.groups),
            "batch": {"stamp": shard.stamp, "job": task.job, "look": _look(task.inputs)},
            "advice": advice(outcome, self.config),
        }
        save_results(shard.path, problem.hand, problem.groups[0].scene.links, outcome, provenance, proof)


@dataclass
class _Share:
    """Tells what share of a shard is done while its groups are worked on."""

    beat: Beat
    """Who is told."""
    total: int
    """Grasps of the shard."""
    most: int
    """Most iterations of a grasp."""
    proves: bool
    """Whether grasps are simulated, which counts for half."""
    before: int = 0
    """Grasps of the groups that are done."""
    count: int = 0
    """Grasps of the present group."""
    share: float = 0.0
    """What was told last."""
    refined: int = 0
    """How many grasps were refined at most when it was told."""

    def group(self, count: int) -> None:
        """The next group begins."""
        self.before, self.count = self.before + self.count, count

    def refining(self, finished: int, iteration: int, mean_loss: float) -> None:
        """As the `progress` of `refine`."""
        # Most grasps finish late: those that run count by how far they are.
        done = finished + (self.count - finished) * min(iteration / self.most, 1.0)
        self._tell("refining", 0.5 * done if self.proves else done, finished)

    def proving(self, what: str, done: float) -> None:
        """As the `tell` of `proved`."""
        self._tell(what, 0.75 * self.count, self.count)

    def _tell(self, what: str, done: float, finished: int) -> None:
        # Another start may take up grasps that were finished.
        self.share = max(self.share, (self.before + done) / max(self.total, 1))
        self.refined = max(self.refined, self.before + finished)
        self.beat(what, self.share, self.refined)


def problem_of(task: Task, seed: int, kept: Kept, beat: Beat) -> Problem:
    """The grasps of a shard with hand and objects; rows and numbers count within the shard."""

    def say(line: str) -> None:
        beat(line, 0.0)

    inputs = KeptInputs.of(task.inputs, kept)
    beat("loading", 0.0)
    if task.sampled is not None:
        count, draw = task.sampled
        return inputs.cut(inputs.draft_sampled(count, seed, say, say, draw), seed, say)
    assert inputs.grasps is not None  # a task that is not sampled has a file
    path = on_disk(inputs.grasps, say)
    read = inputs.read(path, say)
    planned = (task.source["sha256"], *task.hand, task.object, task.object_digest)
    kept.get("unchanged", (inputs, *planned), lambda: _check_unchanged(task, inputs, path, say))
    some = replace(read, grasps=read.grasps.select(task.rows))
    # Targets were read with the file.
    targets = NEAREST if inputs.targets == NEAREST else AUTO
    return replace(inputs, object_name=task.object, targets=targets).load_read(some, path, seed, say)


def unusable_objects(shards: Sequence[Shard], progress: Callable[[int], None]) -> list[Failed]:
    """Those of the shards whose object is a mesh that cannot be read or used; found before any mesh is cut.

    Folders of pieces are left to the workers: they need not be cut. `progress` hears how many shards are looked at.
    """
    kept, failed = Kept(), []
    for number, shard in enumerate(shards):
        progress(number)
        task = shard.task
        if is_folder(Path(task.object_source.source)):
            continue
        try:
            for scale in task.scales:
                KeptInputs.of(task.inputs, kept).read_object(task.object_source, scale)
        except Exception as error:
            failed.append(Failed(shard.number, "error", message_of(error), traceback_of(error), tries=1))
    return failed


def _check_unchanged(task: Task, inputs: KeptInputs, path: Path, say: Callable[[str], None]) -> None:
    """Nothing, when grasps, hand and object are still those that the shard was planned with.

    Raises:
        GraspRefineError: they are not, so that the stamp would not be true.
    """
    digests, (source, hand) = Digests(), task.hand
    where = replace(inputs, object_name=task.object).named_objects(inputs.read(path, say).grasps, path, say)
    for what, planned, now in (
        (str(path), task.source["sha256"], digests.file(path)["sha256"]),
        (f"hand {source}", hand, digests.hand(source, inputs, say)[1]),
        (f"object {task.object}", task.object_digest, digests.object(where[task.object])),
    ):
        if now != planned:
            raise GraspRefineError(f"{what}: changed since the batch was planned; give the same command again")


def _look(inputs: Inputs) -> list[str]:
    """The options that `refine-grasp view` needs to show the result, whose scale takes the mesh to metres."""
    other = ("grasps", "targets", "scale", "unit", "format", "object_name", "index", "other_object")
    return list(words(replace(inputs, **{name: getattr(Inputs, name) for name in other})))


def _world(kept: Kept, hand: Any, obj: Any, protocol: Protocol, table: Any) -> Any:
    """Hand and object for MuJoCo; the hand's model is made once."""
    from grasp_refine.validation.validate import model_of
    from grasp_refine.validation.world import build_world

    return build_world(kept.get("model", hand, lambda: model_of(hand)), obj, protocol, table)


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
