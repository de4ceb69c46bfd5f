"""Plan of a batch: the grasps of each job, by object, in shards of a size that fits into memory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError, visible
from grasp_refine.core.names import is_valid
from grasp_refine.grasps.formats.folders import object_folder
from grasp_refine.grasps.rows import choose_rows
from grasp_refine.hands.files.source import check_known
from grasp_refine.objects.source import ObjectSource, chosen_object
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.load import Loader
from grasp_refine.problem.sampled import check_sampled
from grasp_refine.problem.spec import SAMPLE, ProblemSpec
from grasp_refine_apps.batch.digests import SCAN_FILES, Digests
from grasp_refine_apps.batch.jobs import Job
from grasp_refine_apps.batch.record import is_result
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.processes.task import message_of, traceback_of

INPUT_PATHS = (
    "grasps",
    "hand",
    "transfer_from",
    "arm",
    "urdf",
    "mjcf",
    "object",
    "objects",
    "targets",
    "task",
    "protocol",
    "scene",
    *SCAN_FILES,
)
"""ProblemSpec that may be files or folders."""

RESERVED = ("report.html", "index.csv", "index.parquet")
"""Names of files beside the folders of results."""

MAX_NAME_BYTES = 150
"""Maximum length of a name, bytes; suffixes of partial files and failure notes must also fit (255)."""


@dataclass(frozen=True, eq=False)
class ShardTask:
    """ProblemSpec of a shard for a worker."""

    batch: str
    """Unique id of the batch: a worker's cache for one batch must not be used for another."""
    job: str
    """Name of the job."""
    inputs: ProblemSpec
    """The inputs of the job."""
    source: dict[str, Any]
    """Grasp file and its hash, or number, draw and hand of sampled grasps."""
    hand: tuple[str, str]
    """Source of the hand, and hash of its files."""
    object: str
    """Name of the object in the grasp file."""
    object_digest: str
    """Hash of the object's files."""
    object_source: ObjectSource
    """Source of the object."""
    task_digest: str
    """Hash of the settings of the job, and of the files of its scene, protocol, regions and targets."""
    scales: tuple[float, ...]
    """Scales of the object, as `Sources.read_object` takes them."""
    rows: np.ndarray
    """Rows in the grasp file (n,); empty where grasps are sampled."""
    index: np.ndarray
    """Indices (n,) of the grasps within their object."""
    sampled: tuple[int, int] | None = None
    """Number of sampled grasps, and index of the draw; None: grasps are from a file."""


@dataclass(frozen=True)
class Refused:
    """A job that cannot be done."""

    job: str
    """Name of the job."""
    message: str
    """Reason, in one line."""
    traceback: str = ""
    """Traceback of Python."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All shards of a batch, grouped by hand and object."""

    shards: tuple[Shard, ...]
    """Shards; a shard's `number` is its index."""
    refused: tuple[Refused, ...]
    """Jobs that cannot be done."""
    files: tuple[Path, ...]
    """All input files and folders; none may be overwritten."""
    results: int
    """Number of files found that are results of a batch, and so not refined."""


@dataclass(frozen=True)
class Planner:
    """Planner that divides jobs into shards."""

    out: Path
    """Folder of the results."""
    size: int
    """Maximum number of grasps of a shard."""
    batch: str
    """Value of `ShardTask.batch`."""
    depends: dict[str, Any]
    """All settings that results depend on."""
    seed: int
    """Random seed."""

    def plan(self, jobs: list[Job], say: Callable[[str], None], progress: Callable[[int, str], None]) -> Plan:
        """Plan the shards of all jobs.

        Args:
            jobs: Jobs of the batch.
            say: Called with messages about fetched files.
            progress: Called with the number of planned jobs, and the name of the next one.
        """
        digests, cache, results = Digests(), InputCache(), 0
        shards: list[Shard] = []
        refused: list[Refused] = []
        for number, job in enumerate(jobs):
            progress(number, visible(job.name))
            loader = Loader(job.inputs, self.seed, say, cache=cache)
            try:
                if not is_valid(job.name):
                    raise GraspRefineError("the name of its file holds control characters; rename it")
                if not job.named and is_result(Path(str(job.inputs.grasps))):
                    results += 1
                    continue
                shards += list(self._shards(job, loader, digests))
            except Exception as error:
                refused.append(Refused(visible(job.name), message_of(error), traceback_of(error)))
        # Shards that share a hand and an object are done together; else jobs stay in order.
        first: dict[str, int] = {}
        for place, shard in enumerate(shards):
            first.setdefault(shard.group, place)
        shards.sort(key=lambda shard: first[shard.group])
        named = [getattr(job.inputs, name) for job in jobs for name in INPUT_PATHS]
        files = dict.fromkeys(Path(path) for path in named if path is not None)
        paths = _rename_duplicates([shard.path for shard in shards])
        numbered = [
            replace(shard, number=n, path=path) for n, (shard, path) in enumerate(zip(shards, paths, strict=True))
        ]
        return Plan(tuple(numbered), tuple(refused), tuple(files), results)

    def _shards(self, job: Job, loader: Loader, digests: Digests) -> Iterator[Shard]:
        """Yield the shards of a job, still without numbers.

        Raises:
            GraspRefineError: the job cannot be done.
        """
        inputs = loader.spec
        inputs.check()
        if str(inputs.grasps).startswith(SAMPLE):
            yield from self._sampled(job, loader, digests)
            return
        path = loader.grasp_path()
        read = loader.read(path)
        if inputs.grasp_hand is None:
            check_known(read.grasps.hand, path)
        named = inputs.hand or read.grasps.hand
        hand, digest = digests.hand(named, inputs, loader.on_message)
        of_job = partial(
            ShardTask,
            self.batch,
            job.name,
            job.inputs,
            source=digests.file(path),
            hand=(named, digest),
            task_digest=task_digest(loader, digests),
        )
        for name, where in loader.named_objects(read.grasps, path).items():
            of_object = partial(of_job, object=name, object_digest=digests.object(where), object_source=where)
            rows = choose_rows(read.grasps.object, object_name=name, index=None)
            scales = loader.scales(read.grasps, rows)
            # Grasps on objects of one size are refined at once.
            order = np.argsort(scales, kind="stable")
            for number, start in enumerate(range(0, len(rows), self.size)):
                index = order[start : start + self.size]
                some = tuple(np.unique(scales[index]).tolist())
                yield self._shard(of_object(rows=rows[index], index=index, scales=some), loader, hand, number, digests)

    def _sampled(self, job: Job, loader: Loader, digests: Digests) -> Iterator[Shard]:
        """Yield the shards of a job with sampled grasps, each from a separate draw."""
        inputs = loader.spec
        count = check_sampled(inputs)
        assert inputs.hand is not None and inputs.object is not None  # checked by `check_sampled`
        hand, digest = digests.hand(inputs.hand, inputs, loader.on_message)
        where = chosen_object(inputs.object, loader.on_message)
        name = where.asset.name if where.asset is not None else Path(str(where.source)).stem
        object_digest, of_task = digests.object(where), task_digest(loader, digests)
        for number, start in enumerate(range(0, count, self.size)):
            size, nothing = min(self.size, count - start), np.zeros(0, dtype=np.int64)
            task = ShardTask(
                self.batch,
                job.name,
                job.inputs,
                source={"sampled": f"{SAMPLE}{size}", "draw": number, "hand": digest},
                hand=(inputs.hand, digest),
                object=name,
                object_digest=object_digest,
                object_source=where,
                task_digest=of_task,
                scales=(inputs.scale * (1.0 if where.asset is None else where.asset.scale),),
                rows=nothing,
                index=nothing,
                sampled=(size, number),
            )
            yield self._shard(task, loader, hand, number, digests)

    def _shard(self, task: ShardTask, loader: Loader, hand: str, number: int, digests: Digests) -> Shard:
        stamp = digests.stamp(
            loader.spec,
            **self.depends,
            seed=self.seed,
            source=task.source.get("sha256", task.source),
            hand=task.hand[1],
            object=[task.object, task.object_digest],
            rows=task.rows,
            sampled=task.sampled,
            **_scene(loader),
        )
        stem = _shorten(f"{object_folder(hand)}_{object_folder(task.object)}")
        first, *rest = (_shorten(object_folder(part)) for part in task.job.split("/") if part)
        folder = self.out.joinpath(f"{first}_" if first in RESERVED else first, *rest)
        size = task.sampled[0] if task.sampled is not None else len(task.rows)
        return Shard(
            number=-1,
            group=f"{task.hand[1]} {task.object} {task.object_digest}",
            name=f"{task.job}: {hand}, {task.object}, part {number}",
            size=size,
            path=folder / f"{stem}_{number:05d}.npz",
            stamp=stamp,
            task=task,
        )


def task_digest(loader: Loader, digests: Digests) -> str:
    """Hash of `ShardTask.task_digest` as files are now."""
    return digests.stamp(loader.spec, **_scene(loader))


def _scene(loader: Loader) -> dict[str, str]:
    """Hash of the scene as an entry of a stamp; none where there is no scene."""
    environment = loader.environment()
    return {} if environment is None else {"scene": environment.digest}


def part_of(shards: tuple[Shard, ...], part: int, parts: int) -> tuple[Shard, ...]:
    """Shards of one of several parts (from 1 on) of a batch: consecutive ones, with about equal numbers of grasps."""
    sizes = np.array([shard.size for shard in shards])
    middles = np.cumsum(sizes) - 0.5 * sizes
    place = (middles * parts / sizes.sum()).astype(int)
    return tuple(shard for shard, at in zip(shards, place.tolist(), strict=True) if at == part - 1)


def _rename_duplicates(paths: list[Path]) -> list[Path]:
    """Rename duplicate paths: names may differ only in characters that no file name can have."""
    taken: set[Path] = set()
    for place, path in enumerate(paths):
        while path in taken:
            path = path.with_stem(f"{path.stem}_")
        taken.add(path)
        paths[place] = path
    return paths


def _shorten(name: str) -> str:
    """Shorten a name that is too long for a file, with a hash for uniqueness."""
    if len(name.encode()) <= MAX_NAME_BYTES:
        return name
    return (
        f"{name.encode()[: MAX_NAME_BYTES - 9].decode(errors='ignore')}_{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    )
