"""What a batch consists of: the grasps of each job, by object, in shards of a size that fits into memory."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.apps.batch.shard import Shard
from grasp_refine.commands.digests import Digests
from grasp_refine.commands.inputs import SAMPLE, Inputs
from grasp_refine.commands.job_list import Job
from grasp_refine.commands.kept import Kept, KeptInputs
from grasp_refine.commands.object_source import chosen_object
from grasp_refine.commands.sources import on_disk
from grasp_refine.errors import GraspRefineError
from grasp_refine.grasps import choose_rows
from grasp_refine.hand_source import check_known

_PLAIN = re.compile(r"[^\w.,=+-]+")
"""What no name of a file has."""


@dataclass(frozen=True, eq=False)
class Task:
    """What a worker needs to know of a shard."""

    batch: str
    """Tells batches apart: what is kept in memory for one may not be used for another."""
    job: str
    """Name of the job."""
    inputs: Inputs
    """The inputs of the job."""
    source: dict[str, Any]
    """The grasp file, or the hand of sampled grasps, and its hash."""
    object: str
    """The object, as the grasp file calls it."""
    rows: np.ndarray
    """Rows in the grasp file (n,); empty where grasps are sampled."""
    index: np.ndarray
    """Their numbers among the grasps of the object (n,)."""
    sampled: tuple[int, int] | None = None
    """How many grasps are sampled, and in the how manieth draw."""


@dataclass(frozen=True)
class Refused:
    """A job that cannot be done at all."""

    job: str
    """Its name."""
    message: str
    """Why, in one line."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All shards of a batch, those of one hand and object after each other."""

    shards: tuple[Shard, ...]
    """The shards; a shard's `number` is its place."""
    refused: tuple[Refused, ...]
    """Jobs that cannot be done."""
    files: tuple[Path, ...]
    """All files that are read, none of which may be overwritten."""


@dataclass(frozen=True)
class Planner:
    """How jobs are cut into shards."""

    out: Path
    """Folder of the results."""
    size: int
    """Most grasps of a shard."""
    batch: str
    """What `Task.batch` will be."""
    depends: dict[str, Any]
    """All settings that results depend on."""
    seed: int
    """Of everything that is drawn."""

    def plan(self, jobs: list[Job], say: Callable[[str], None], progress: Callable[[int, str], None]) -> Plan:
        """The shards of all jobs.

        Args:
            jobs: What is refined.
            say: Hears what is fetched.
            progress: Hears how many jobs are planned, and which one is next.
        """
        digests, files = Digests(), []
        shards: list[Shard] = []
        refused: list[Refused] = []
        for number, job in enumerate(jobs):
            progress(number, job.name)
            # A folder of jobs is read one after the other: only the last one is needed.
            inputs = KeptInputs.of(job.inputs, Kept())
            try:
                found = list(self._shards(job, inputs, digests, say))
            except GraspRefineError as error:
                refused.append(Refused(job.name, " ".join(str(error).split())))
                continue
            shards += found
            files += [path for path in (job.inputs.grasps, job.inputs.object, job.inputs.urdf) if path is not None]
        # What shares a hand and an object is done together; else jobs stay in order.
        first: dict[str, int] = {}
        for place, shard in enumerate(shards):
            first.setdefault(shard.group, place)
        shards.sort(key=lambda shard: first[shard.group])
        paths = _distinct([shard.path for shard in shards])
        numbered = [
            replace(shard, number=n, path=path) for n, (shard, path) in enumerate(zip(shards, paths, strict=True))
        ]
        return Plan(tuple(numbered), tuple(refused), tuple(Path(path) for path in files))

    def _shards(self, job: Job, inputs: KeptInputs, digests: Digests, say: Callable[[str], None]) -> Iterator[Shard]:
        """The shards of a job, still without numbers.

        Raises:
            GraspRefineError: the job cannot be done.
        """
        if str(inputs.grasps).startswith(SAMPLE):
            yield from self._sampled(job, inputs, digests, say)
            return
        path = on_disk(inputs.grasps, say)
        read = inputs.read(path, say)
        if inputs.hand is None:
            check_known(read.grasps.hand, path)
        hand, hand_digest = digests.hand(inputs.hand or read.grasps.hand, inputs, say)
        source = digests.file(path)
        for name, where in inputs.named_objects(read.grasps, path, say).items():
            object_digest = digests.object(where)
            rows = choose_rows(read.grasps, object_name=name, index=None)
            # Grasps on objects of one size are refined at once.
            order = np.argsort(read.grasps.scale[rows], kind="stable")
            for number, start in enumerate(range(0, len(rows), self.size)):
                index = order[start : start + self.size]
                task = Task(self.batch, job.name, job.inputs, source, name, rows[index], index)
                yield self._shard(task, hand, hand_digest, object_digest, number, digests)

    def _sampled(self, job: Job, inputs: KeptInputs, digests: Digests, say: Callable[[str], None]) -> Iterator[Shard]:
        """The shards of a job whose grasps are drawn, each in a draw of its own."""
        count = inputs.sample_count()
        hand, hand_digest = digests.hand(inputs.hand, inputs, say)
        where = chosen_object(inputs.object, say)
        object_digest = digests.object(where)
        name = where.asset.name if where.asset is not None else Path(str(where.source)).stem
        for number, start in enumerate(range(0, count, self.size)):
            size, nothing = min(self.size, count - start), np.zeros(0, dtype=np.int64)
            source = {"sampled": f"{SAMPLE}{size}", "draw": number, "hand": hand_digest}
            task = Task(self.batch, job.name, job.inputs, source, name, nothing, nothing, (size, number))
            yield self._shard(task, hand, hand_digest, object_digest, number, digests)

    def _shard(
        self, task: Task, hand: str, hand_digest: str, object_digest: str, number: int, digests: Digests
    ) -> Shard:
        stamp = digests.stamp(
            task.inputs,
            **self.depends,
            seed=self.seed,
            source=task.source.get("sha256", task.source),
            hand=hand_digest,
            object=[task.object, object_digest],
            rows=task.rows,
            sampled=task.sampled,
        )
        stem = f"{_plain(hand)}_{_plain(task.object)}"
        folder = self.out.joinpath(*(_plain(part) for part in task.job.split("/")))
        size = task.sampled[0] if task.sampled is not None else len(task.rows)
        return Shard(
            number=-1,
            group=f"{hand_digest} {task.object} {object_digest}",
            name=f"{task.job}: {hand}, {task.object}, part {number}",
            size=size,
            path=folder / f"{stem}_{number:05d}.npz",
            stamp=stamp,
            task=task,
        )


def part_of(shards: tuple[Shard, ...], part: int, parts: int) -> tuple[Shard, ...]:
    """The shards of one of several parts (from 1 on) of a batch: a run of them, with about as many grasps as others."""
    sizes = np.array([shard.size for shard in shards])
    middles = np.cumsum(sizes) - 0.5 * sizes
    place = (middles * parts / sizes.sum()).astype(int)
    return tuple(shard for shard, at in zip(shards, place.tolist(), strict=True) if at == part - 1)


def _distinct(paths: list[Path]) -> list[Path]:
    """The paths, those that came before with another name: what differs in a name may be what no file can have."""
    taken: set[Path] = set()
    for place, path in enumerate(paths):
        while path in taken:
            path = path.with_stem(f"{path.stem}_")
        taken.add(path)
        paths[place] = path
    return paths


def _plain(name: str) -> str:
    """The name with only what any file system takes; never a folder above."""
    return _PLAIN.sub("_", name).lstrip(".") or "_"
