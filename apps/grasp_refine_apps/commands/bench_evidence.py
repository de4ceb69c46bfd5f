"""`refine-grasp bench evidence`: how many grasps hold, over many hands, objects, generators and protocols."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import date
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any
from uuid import uuid4

from rich.console import Console
from tyro.conf import DisallowNone, arg

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, save_json, save_text
from grasp_refine.core.plurals import count_text
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.validation.engine_choice import EngineName, check_engine
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.batch.outputs import load_case
from grasp_refine_apps.batch.pictures import draw_cases
from grasp_refine_apps.batch.plan import Planner
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import State, state_of
from grasp_refine_apps.batch.session import Session
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.evidence.cases import Cases, EvidenceCase, save_jobs, with_file
from grasp_refine_apps.bench.evidence.report import failures, markdown, report, tables
from grasp_refine_apps.bench.evidence.results import Block, read_blocks, refinement_cpu_s
from grasp_refine_apps.bench.evidence.sampling import SamplingWork
from grasp_refine_apps.bench.evidence.trials import GEOMETRY, REFINED, Trial, TrialsWork, folder_of, trials_shards
from grasp_refine_apps.bench.report import Table
from grasp_refine_apps.commands.batch import Batch, Output
from grasp_refine_apps.commands.benchmark import benchmark_document
from grasp_refine_apps.commands.options import NOTHING_USABLE, check_numbers
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.sharding import Sharding
from grasp_refine_apps.processes.local import LocalPool
from grasp_refine_apps.report.screen import screen

Names = Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]", help_behavior_hint="(default: all)")]

PATIENCE_S = 300.0
"""CPU time after which no further picture is begun, seconds."""


@dataclass(frozen=True)
class BenchEvidence:
    """Measure how many grasps hold as given, refined by geometry only, and refined, over whole folders of assets.

    The folder of assets has hands/NAME/*.urdf, hands/NAME_mjcf/*.xml, objects/NAME.obj, objects.csv (name,
    suggested_scale, diag, convexity) and grasps/normalised/*.npz, as a generator makes them. Each hand, and those that
    come with the program, gets sampled grasps on each object; grasps of generators are taken with their own hand.

    Everything is done in four steps, each resumed by the same command after an interruption: sampling, both
    refinements, as `refine-grasp batch` does them, and the trials of all grasps under each protocol. Results of other
    settings are computed again. The exit code is 0 on success, 1 when something failed, 130 when interrupted.
    """

    assets: Path = Path("assets")
    """Folder of hands, objects and grasps."""
    out: Path = Path("grasp-refine-evidence")
    """Folder of the results, and of evidence.md, evidence.html and evidence.json."""
    grasps: int = 1
    """Number of sampled grasps of each hand on each object."""
    every: int = 1
    """Sample grasps of each hand on every n-th object only, of each hand on others: 1/n of the time."""
    generated: int = 20
    """Largest number of grasps of each generator on each object, taken evenly from its file."""
    hands: Names = ()
    """Hands: folders of hands, NAME_mjcf/MODEL, and embedded/NAME."""
    objects: Names = ()
    """Objects: names in objects.csv."""
    generators: Names = ()
    """Generators: sampled, and names of grasp files."""
    protocols: Annotated[tuple[str, ...], arg(metavar="NAME|FILE.toml [...]")] = tuple(PROTOCOLS)
    """Protocols of the simulation: names, and TOML files."""
    engines: Annotated[tuple[EngineName, ...], arg(metavar="mujoco|drake [...]")] = ("mujoco",)
    """Engines of the simulation: with both, every grasp is tried in each, and a table tells how far they agree; drake
    needs the extra `drake`, and several times as long."""
    seed: int = 0
    """Random seed."""
    workers: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: the cores of this machine)")] = None
    """Number of processes."""

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used at all.
        """
        check_numbers(self)
        if not self.protocols:
            raise GraspRefineError(f"--protocols needs at least one of {', '.join(PROTOCOLS)}")
        if not self.engines:
            raise GraspRefineError("--engines needs at least one of mujoco, drake")
        protocols = [load_protocol(name) for name in dict.fromkeys(self.protocols)]
        if len({protocol.name for protocol in protocols}) < len(protocols):
            those = ", ".join(protocol.name for protocol in protocols)
            raise GraspRefineError(f"--protocols: two of them have one name: {those}")
        for engine in self.engines:
            check_engine(engine)
        # Of a shard, the trials under one protocol follow each other: they share its world.
        trials = [Trial(protocol, engine) for protocol in protocols for engine in dict.fromkeys(self.engines)]
        began, out = time.perf_counter(), self.out.absolute()
        written = [out / f"evidence.{suffix}" for suffix in ("md", "html", "json")]
        check_writable(*written, overwrite=True, inside=out)
        choice = self.hands, self.objects, self.generators, self.grasps, self.every, self.generated
        cases = Cases(self.assets, *choice).write(out)
        console = screen(stderr=True)
        console.print("1 of 4: sampling", style="bold")
        sampling = self._sample(cases, out, console)
        file_of = {shard.task.job: shard.path for shard in sampling.complete_shards}
        listing = out / "jobs.csv"
        save_jobs(listing, [with_file(case, file_of) for case in cases if case.job in file_of or not case.is_sampled])
        sessions = {"sampling": sampling}
        for number, method in enumerate((GEOMETRY, REFINED), 2):
            console.print(f"{number} of 4: {method}", style="bold")
            sessions[method] = self._batch(method, listing, out).refine().session
        console.print("4 of 4: trials", style="bold")
        refined = {method: sessions[method].complete_shards for method in (GEOMETRY, REFINED)}
        shards = trials_shards(refined, trials, out)
        simulated = self._run(TrialsWork(self.seed), Session(tuple(shards), (), _complete(shards)), console)
        blocks = read_blocks(cases, refined, simulated.complete_shards, trials, out)
        if not blocks:
            raise GraspRefineError("no grasps could be refined: " + _failed(cases, blocks, sessions)[0]["reason"])
        failed = _failed(cases, blocks, {**sessions, "trials": simulated})
        found = self._write(blocks, failed, trials, refined[REFINED], out)
        terminal = screen()
        for table in takewhile(lambda table: not table.folded, found):
            terminal.print(table.printed())
        if failed:
            terminal.print(f"{count_text(len(failed), 'job')} failed: see evidence.md", style="red")
        terminal.print(f"{time.perf_counter() - began:.1f} s; wrote", *written, soft_wrap=True, markup=False)
        return NOTHING_USABLE if failed else 0

    def _batch(self, method: str, listing: Path, out: Path) -> Batch:
        """Return the batch of one of the refinements."""
        return Batch(
            jobs=(str(listing),),
            settings=Settings(geometry_only=method == GEOMETRY, seed=self.seed),
            sharding=Sharding(workers=self.workers),
            output=Output(out=folder_of(method, out), report=False),
        )

    def _sample(self, cases: Sequence[EvidenceCase], out: Path, console: Console) -> Session:
        """Sample the grasps that are missing."""
        sampled = [case for case in cases if case.is_sampled]
        if not sampled:
            return Session((), (), set())
        listing = out / "sampling.csv"
        save_jobs(listing, sampled)
        planner = Planner(out / "grasps", self.grasps, uuid4().hex, {"engine": chosen("auto")}, self.seed)
        with Progress(console, (), 1) as progress:
            plan = planner.plan(
                read_jobs([str(listing)], ProblemSpec()), progress.say, lambda number, name: progress.wait(name)
            )
        for refused in plan.refused:
            console.print(f"{refused.job} cannot be done: {refused.message}", style="dim", markup=False, soft_wrap=True)
        session = Session(plan.shards, plan.refused, _complete(plan.shards))
        return self._run(SamplingWork(self.seed), session, console)

    def _run(self, work: SamplingWork | TrialsWork, session: Session, console: Console) -> Session:
        """Do the shards that are missing, and return the session.

        Raises:
            KeyboardInterrupt: raised again; shards complete by then are kept.
        """
        todo, sharding = session.left, Sharding(workers=self.workers)
        if not todo:
            return session
        workers = sharding.num_workers(len(todo))
        with (
            Progress(console, todo, workers, session.skipped, verdict=False, work=work.words) as progress,
            closing(LocalPool(work, workers, sharding.patience)) as pool,
        ):
            session.run(todo, pool, progress, tries=sharding.tries, patience_s=sharding.patience)
        return session

    def _write(
        self,
        blocks: Sequence[Block],
        failed: Sequence[Row],
        trials: Sequence[Trial],
        refined: Sequence[Shard],
        out: Path,
    ) -> list[Table]:
        """Write tables, page and document, and return the tables."""
        names = [trial.label for trial in trials]
        found = tables(blocks, failed, names, _pairs(trials))
        document = benchmark_document(
            "bench evidence",
            self,
            preset=None,
            seed=self.seed,
            cpu_s=refinement_cpu_s(blocks) + sum(block.simulation_cpu_s for block in blocks),
            problems=[],
            tables={table.title: list(table.rows) for table in found},
        )
        shards = {shard.number: shard for shard in refined}
        load = partial(load_case, shards, InputCache(), self.seed)
        with Progress(screen(stderr=True), (), 1) as progress:
            pictures = {
                what: draw_cases(
                    cases, out, load, patience_s=PATIENCE_S, progress=lambda what, share: progress.wait(what)
                )
                for what, cases in failures(blocks, names).items()
            }
        save_json(out / "evidence.json", document)
        save_text(out / "evidence.md", markdown(found, _about(document)))
        save_text(out / "evidence.html", report(found, pictures).page(document))
        return found


def _complete(shards: Sequence[Shard]) -> set[int]:
    """Numbers of the shards with result files of the same inputs and settings."""
    return {shard.number for shard in shards if state_of(shard) is State.COMPLETE}


def _pairs(trials: Sequence[Trial]) -> dict[str, tuple[str, str]]:
    """Name of each protocol that is tried in MuJoCo and in Drake -> its labels in both."""
    labels = {(trial.protocol.name, trial.engine): trial.label for trial in trials}
    return {
        name: (label, labels[name, "drake"])
        for (name, engine), label in labels.items()
        if engine == "mujoco" and (name, "drake") in labels
    }


def _about(document: Mapping[str, Any]) -> list[str]:
    """Paragraphs on how the tables were made."""
    host = document["machine"]
    return [
        f"`{document['invocation']}`, {date.today().isoformat()}, version {document['versions']['grasp-refine']}: "
        f"{document['cpu_s'] / 60:.1f} minutes of CPU time for refining and simulating, on {host['cpus']} x "
        f"{host['cpu']}."
    ]


def _failed(cases: Sequence[EvidenceCase], blocks: Sequence[Block], sessions: Mapping[str, Session]) -> list[Row]:
    """Jobs with fewer grasps in the results than requested, or without all trials: job, missing and reason."""
    reasons: dict[str, str] = {}
    of_shard = {str(shard.name): shard.task for session in sessions.values() for shard in session.shards}
    for step, session in sessions.items():
        for failure in session.failures():
            task = of_shard.get(failure["name"])
            job = failure["name"] if task is None else getattr(task, "task", task).job
            reasons.setdefault(job, f"{step}: {failure['message']}")
    count: dict[str, int] = {}
    for block in blocks:
        count[block.case.job] = count.get(block.case.job, 0) + len(block)
    return [
        {
            "job": case.job,
            "missing": case.count - count.get(case.job, 0),
            "reason": reasons.get(case.job, "fewer grasps were found"),
        }
        for case in cases
        if case.job in reasons or count.get(case.job, 0) < case.count
    ]
