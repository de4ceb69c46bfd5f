"""`refine-grasp batch`: refine whole datasets of grasps, in processes or on a cluster, and resume where it stopped."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, fields, replace
from errno import ENOSPC
from pathlib import Path
from shutil import disk_usage
from typing import Annotated, Any, ClassVar
from uuid import uuid4

from rich.console import Console
from tyro.conf import Positional, arg

from grasp_refine.collision.engine import chosen
from grasp_refine.core.cores import usable_cores
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import SCHEMA
from grasp_refine.core.machine import machine
from grasp_refine.core.plurals import count_text
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.versions import versions
from grasp_refine.problem.spec import NEAREST, SAMPLE
from grasp_refine.refinement.config import Config
from grasp_refine.results.document import settings
from grasp_refine.results.profile import profile_entry, profile_table
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import default_protocol
from grasp_refine_apps.batch.bundle import Bundle, bundles_of
from grasp_refine_apps.batch.index import IndexKind, index_path
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.batch.lock import locked
from grasp_refine_apps.batch.outputs import Outputs
from grasp_refine_apps.batch.plan import Plan, Planner, part_of
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import State, clean, state_of
from grasp_refine_apps.batch.session import Session
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.table import batch_table
from grasp_refine_apps.batch.words import grasps, mebibytes
from grasp_refine_apps.batch.work import BundleWork, unusable_objects
from grasp_refine_apps.commands.inputs import Inputs, Sources
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.sharding import Sharding
from grasp_refine_apps.commands.simulation_options import ValidationOptions
from grasp_refine_apps.processes.dispatch import Pool
from grasp_refine_apps.processes.local import LocalPool
from grasp_refine_apps.processes.task import is_disk_full
from grasp_refine_apps.report.command_line import invocation
from grasp_refine_apps.report.screen import screen

MAX_NAMED = 10
"""Maximum number of damaged files listed."""


@dataclass(frozen=True)
class Defaults(Inputs):
    """Inputs of a job that it does not specify itself."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "Grasps of jobs that do not say otherwise.", ("targets", "format", "as_is")),
        *Sources.groups[1:],
    )

    def plain(self) -> Inputs:
        """Return these inputs as the inputs of one job."""
        return Inputs(**{option.name: getattr(self, option.name) for option in fields(Inputs)})


@dataclass(frozen=True)
class Output:
    """Files that are written."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("output"),)

    out: Path = Path("grasp-refine-batch")
    """Folder of the results: <job>/<hand>_<object>_<part>.npz, index.parquet or .csv, report.html."""
    index_format: IndexKind = "auto"
    """Format of the table of all grasps with all measures; auto: Parquet if pyarrow is installed, else CSV."""
    report: bool = True
    """Write report.html: distributions before and after, the worst cases with pictures, failures and their causes."""
    json: OptionalFile = None
    """Write a summary and the measures of each grasp to this file, in SI units."""
    profile: bool = False
    """Show the time of each stage: loading, kinematics, collision queries, derivatives, solver, simulation."""


@dataclass(frozen=True)
class Batched:
    """A batch after a run of the command."""

    document: dict[str, Any]
    """The JSON document, without the grasps."""
    session: Session
    """Complete and failed shards."""
    outputs: Outputs
    """Files that were written."""


@dataclass(frozen=True)
class Batch:
    """Refine whole datasets of grasps.

    JOBS are grasp files (any format that `run` reads), folders of them at any depth, patterns such as 'sets/*.npz',
    sample:N, or lists of jobs: a TOML file with a [[job]] table for each, or a CSV file with a line for each. A job
    names its grasps, and everything that differs from the options here: hand, object, objects, scale, name, ...

    After an interruption or a crash, the same command resumes: complete results are skipped, and results of other
    inputs or settings are computed again. The exit code is 0 on success, 1 when something failed (report.html and the
    summary name it; the rest is done), 2 for bad input, 130 when interrupted.
    """

    jobs: Annotated[Positional[tuple[str, ...]], arg(metavar="JOBS [JOBS ...]", help_behavior_hint="")] = ()
    """Grasps to refine."""
    inputs: Annotated[Defaults, arg(name="")] = field(default_factory=Defaults)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    validation: Annotated[ValidationOptions, arg(name="")] = field(default_factory=ValidationOptions)
    sharding: Annotated[Sharding, arg(name="")] = field(default_factory=Sharding)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used at all; then nothing is written.
        """
        try:
            batched = self.refine()
        except GraspRefineError as error:
            if not is_disk_full(error):
                raise
            screen(stderr=True).print(str(error), style="red", soft_wrap=True, markup=False)
            return NOTHING_USABLE
        self._show(batched)
        nothing = batched.session.shards and not batched.session.statistics.all.usable
        return NOTHING_USABLE if batched.document["failed"] or nothing else 0

    def refine(self) -> Batched:
        """Refine missing shards and write all outputs; nothing is printed but progress.

        Raises:
            GraspRefineError: as for `execute`.
        """
        wall, cpu = time.perf_counter(), cpu_seconds()
        config, protocol, part = self._read_settings()
        outputs = self._outputs()
        described = {
            "refine": settings(config),
            "validation": settings(self.validation),
            "protocol": settings(protocol if self.validation.validate else None),
            # Both engines agree up to rounding, but not to the last bit.
            "engine": chosen("auto"),
        }
        console = screen(stderr=True)
        with Progress(console, (), 1) as progress:
            plan = self._plan(outputs.out, described, config.seed, progress)
            outputs.check(plan)
        with locked(outputs.out, plan.shards, part):
            with Progress(console, (), 1) as progress:
                progress.wait("checking existing results")
                shards = part_of(plan.shards, *part)
                states = {shard.number: State.MISSING if self.sharding.again else state_of(shard) for shard in shards}
                _report_states(shards, states, progress)
            complete = {number for number, state in states.items() if state is State.COMPLETE}
            session = Session(shards, plan.refused, complete, statistics=Statistics.empty(config.confidence))
            self._run_shards(
                BundleWork(config, self.validation.engines, described, self.output.profile), session, console
            )
            with Progress(console, (), 1) as progress:
                outputs.read(session, progress)
                failed = session.failures()
                document = {
                    "schema": SCHEMA,
                    "command": "batch",
                    "invocation": invocation("batch", self),
                    "versions": versions(),
                    "machine": machine(),
                    "config": described
                    | {"inputs": settings(self.inputs.plain()), "sharding": settings(self.sharding)},
                    "seed": config.seed,
                    "failed": failed,
                    "jobs": session.jobs(),
                    "profile": profile_entry(session.profile or None),
                }

                def totals() -> dict[str, Any]:
                    """Return the totals with the costs of this run so far."""
                    return session.totals(failed, time.perf_counter() - wall, cpu_seconds() - cpu)

                outputs.write_report(document | {"totals": totals()}, session, progress)
                outputs.write_summary(document, totals, session, progress)
        return Batched(document | {"totals": totals()}, session, outputs)

    def _outputs(self) -> Outputs:
        """Return the files to write; a part of a batch has results and a summary only.

        Raises:
            GraspRefineError: the index cannot be written in the chosen format.
        """
        out = self.output.out.absolute()
        index = index_path(out, self.output.index_format)
        has_all_parts = self.sharding.shard is None
        return Outputs(out, index if has_all_parts else None, self.output.report and has_all_parts, self.output.json)

    def _show(self, batched: Batched) -> None:
        """Print the tables."""
        console, document, session, outputs = screen(), batched.document, batched.session, batched.outputs
        console.print(batch_table(document, session.statistics))
        if session.profile:
            console.print(profile_table(session.profile))
        if outputs.index is None:
            console.print("index and report are written by the same command without --shard, when all parts are done")
        written = outputs.files or (outputs.out,)
        console.print(f"{document['totals']['wall_s']:.1f} s; wrote", *written, soft_wrap=True, markup=False)

    def _read_settings(self) -> tuple[Config, Protocol, tuple[int, int]]:
        """Return the settings of refinement, the protocol of most jobs, and the part of the batch, as (part, parts).

        Raises:
            GraspRefineError: an invalid option.
        """
        if not self.jobs:
            raise GraspRefineError(
                "name the grasps to refine: grasp files, a folder, a pattern, sample:N, or a job list (.toml, .csv)"
            )
        part = self.sharding.part()
        config = self.settings.config(nearest=self.inputs.targets == NEAREST)
        named = self.inputs.with_named_task()
        named.check_task()
        return config, named.chosen_protocol(in_scene=named.in_scene) or default_protocol(in_scene=named.in_scene), part

    def _plan(self, out: Path, described: dict[str, Any], seed: int, progress: Progress) -> Plan:
        """Plan the shards of all jobs; jobs that cannot be done are reported.

        Raises:
            GraspRefineError: none can be done.
        """
        jobs = read_jobs(self.jobs, self.inputs.plain(), together=self.sharding.together)
        # Results of an earlier run may lie in the folder of the grasps.
        inside = out.resolve()
        jobs = [job for job in jobs if job.named or not Path(str(job.inputs.grasps)).resolve().is_relative_to(inside)]
        if not jobs:
            raise GraspRefineError(
                f"{', '.join(self.jobs)}: no jobs in it but the results in {out}; give another --out"
            )
        planner = Planner(out, self.sharding.size(simulated=self.validation.validate), uuid4().hex, described, seed)
        plan = planner.plan(
            jobs, progress.say, lambda number, name: progress.wait(f"planning {number + 1}/{len(jobs)}: {name}")
        )
        if not plan.shards and not plan.refused:
            raise GraspRefineError(f"{', '.join(self.jobs)}: no jobs in it but results of a batch")
        if not plan.shards:
            more = f" (and {count_text(len(plan.refused) - 1, 'more job')})" if len(plan.refused) > 1 else ""
            raise GraspRefineError(f"no job can be done: {plan.refused[0].job}: {plan.refused[0].message}{more}")
        if plan.results:
            files = count_text(plan.results, "file")
            progress.say(f"no grasps to refine but results of a batch: {files}; named, they would be refined")
        for refused in plan.refused:
            progress.say(f"{refused.job} cannot be done: {refused.message}")
        lists = (Path(source) for source in self.jobs if not source.startswith(SAMPLE))
        return replace(plan, files=(*plan.files, *lists))

    @contextmanager
    def _pool(self, work: BundleWork, workers: int) -> Iterator[Pool]:
        """Yield the workers: processes of this machine or of the cluster."""
        if self.sharding.dask is None:
            with closing(LocalPool(work, workers, self.sharding.patience)) as pool:
                yield pool
            return
        from grasp_refine_apps.processes.cluster import ClusterPool, connect

        with connect(self.sharding.dask) as client:
            yield ClusterPool(client, self.sharding.dask, work, self.output.out.absolute())

    def _run_shards(self, work: BundleWork, session: Session, console: Console) -> None:
        """Work on the shards that are left, and record the result of each.

        Raises:
            KeyboardInterrupt: raised again; shards complete by then are kept.
        """
        todo = session.left
        if not todo:
            return
        clean(shard.path for shard in todo)
        workers = min(self.sharding.workers or usable_cores(), len(todo))
        simulated = bool(work.engines)
        began = time.perf_counter()
        with Progress(console, todo, workers, session.skipped, simulated=simulated) as progress:
            if session.room_bytes > disk_usage(self.output.out).free:
                progress.say(f"note: the disk may become full: {_room_text(session, self.output.out)}")
            unusable = unusable_objects(
                todo, lambda number: progress.wait(f"reading objects, {number + 1} of {len(todo)} shards")
            )
            for shard in todo:
                if shard.number in unusable:
                    session.take(shard, unusable[shard.number], progress)
            usable = [shard for shard in todo if shard.number not in unusable]
            try:
                with self._pool(work, workers) as pool:
                    # Simulated grasps take so long that those refined together would not be faster.
                    bundles = [Bundle((shard,)) for shard in usable] if simulated else bundles_of(usable, workers)
                    tries, patience_s = self.sharding.tries, self.sharding.patience
                    session.run(bundles, pool, progress, tries=tries, patience_s=patience_s)
            except KeyboardInterrupt:
                there = f"{len(session.complete)} of {count_text(len(session.shards), 'shard')} complete"
                command = "without --again, the command" if self.sharding.again else "the same command"
                progress.say(f"{there}; {command} continues from there")
                raise
        session.wall_s = time.perf_counter() - began
        if session.disk_full:
            there = f"{len(session.complete)} of {count_text(len(session.shards), 'shard')} complete"
            raise GraspRefineError(
                f"{self.output.out}: the disk is full; stopped with {there}. {_room_text(session, self.output.out)}; "
                "make room, and the same command continues from there"
            ) from OSError(ENOSPC, os.strerror(ENOSPC))


def _room_text(session: Session, out: Path) -> str:
    """Return the room that the missing results need, and that there is."""
    free = mebibytes(disk_usage(out).free)
    return f"the {grasps(session.open_grasps)} left need about {mebibytes(session.room_bytes)}, {free} are free"


def _report_states(shards: Sequence[Shard], states: Mapping[int, State], progress: Progress) -> None:
    """Print the numbers of existing and of recomputed results."""
    count = Counter(states.values())
    if count[State.COMPLETE]:
        progress.say(f"{count[State.COMPLETE]} of {count_text(len(shards), 'shard')} complete and skipped")
    if count[State.CHANGED]:
        progress.say(f"of other inputs, settings or versions, and computed again: {count[State.CHANGED]}")
    damaged = [shard.path for shard in shards if states[shard.number] is State.DAMAGED]
    for path in damaged[:MAX_NAMED]:
        progress.say(f"{path} cannot be read and is computed again")
    if len(damaged) > MAX_NAMED:
        progress.say(f"and {count_text(len(damaged) - MAX_NAMED, 'more damaged file')}")
