"""`refine-grasp validate`: evaluate grasps of any file, by geometry and in simulation."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from rich.markup import escape
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_no_input, check_writable, save_json, save_text
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.hands.self_collision import ignored_overlaps
from grasp_refine.problem.load import Loader
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.spec import SourceSpec
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.refinement.closing import closing_notes
from grasp_refine.results.certificate import record_verdicts
from grasp_refine.results.document import settings
from grasp_refine.results.result_files import fingerprint
from grasp_refine.results.simulated import closing_line
from grasp_refine.results.validation_document import check_table, flat_rows, save_table, validate_document
from grasp_refine.results.validation_table import comparison_table, validation_table
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import default_protocol
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import TASK, task_entry
from grasp_refine.validation.engine_table import MUJOCO, chosen_engines
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.margins.margins import Margins, Worlds, margins, other_model_of
from grasp_refine.validation.set_points import clipping_note
from grasp_refine.validation.trials import Trials
from grasp_refine.validation.validate import Validated, validate
from grasp_refine_apps.commands.inputs import Sources
from grasp_refine_apps.commands.margins_options import (
    MarginsOptions,
    MeasuredFile,
    add_columns,
    add_margins,
    margins_page,
    show_margins,
)
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite, check_numbers
from grasp_refine_apps.commands.recording import Recording
from grasp_refine_apps.commands.simulation_options import Robustness, Simulation
from grasp_refine_apps.grasp_page.page import page
from grasp_refine_apps.grasp_page.sheet import Sheet
from grasp_refine_apps.report.command_line import flag, invocation, words
from grasp_refine_apps.report.progress import Reporter
from grasp_refine_apps.report.screen import screen


@dataclass(frozen=True)
class Output:
    """Comparisons, and outputs on screen and in files."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("output"),)

    compare: Annotated[
        DisallowNone[tuple[Path, Path] | None], arg(metavar="BEFORE AFTER", help_behavior_hint="(default: none)")
    ] = None
    """Two files with the same grasps, instead of FILE: show what became better and worse."""
    json: OptionalFile = None
    """Write all results of each grasp to this file, in SI units."""
    rows: OptionalFile = None
    """Write one row per grasp to this .csv or .parquet file."""
    html: OptionalFile = None
    """Write a page to this file: a card with a picture for each grasp, with --compare before and after; with --margins
    their charts."""
    record: bool = False
    """Write the verdict of each engine into FILE (our .npz): beside those of other engines, if protocol, task, closing
    and grasps are the same; else in place of them. `convert --where "held_mujoco=1"` and the viewer filter by them."""
    overwrite: Overwrite = False
    verbose: bool = False
    """List all grasps, even if there are more than 40."""


@dataclass(frozen=True)
class Validate:
    """Evaluate grasps: measure their geometry, and simulate whether they hold.

    Takes any grasp file, refined or not. The hand closes from the pregrasp over the grasp to the squeeze; then the
    object, without gravity, is pushed in six directions for two seconds each. A grasp holds if the object never moves
    by 5 cm or turns by 15 degrees (the protocol of DexGraspBench).
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE [FILE ...]", help_behavior_hint="")] = ()
    """Grasp files (.npz)."""
    sources: Annotated[Sources, arg(name="")] = field(default_factory=Sources)
    simulation: Annotated[Simulation, arg(name="")] = field(default_factory=Simulation)
    robustness: Annotated[Robustness, arg(name="")] = field(default_factory=Robustness)
    margins: Annotated[MarginsOptions, arg(name="")] = field(default_factory=MarginsOptions)
    recording: Annotated[Recording, arg(name="")] = field(default_factory=Recording)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        wall, cpu, started = time.perf_counter(), cpu_seconds(), time.process_time()
        check_numbers(self.simulation)
        named = self.sources.with_named_task()
        named.check_task()
        protocol = self._protocol(named, in_scene=False)
        files = self.output.compare or self.files
        self._check(protocol, files)
        with Reporter(screen(stderr=True)) as reporter:
            loaders = [Loader(self.sources.of(path), self.robustness.seed, reporter.say) for path in files]
            problems = [loader.problem() for loader in loaders]
            if self.output.compare is not None:
                _check_comparable(*problems)
            self.recording.check(protocol, files, problems, overwrite=self.output.overwrite)
            if protocol is not None and any(problem.task.environment is not None for problem in problems):
                protocol = self._protocol(named, in_scene=True)
            if protocol is not None:
                problems = [problem.for_task(Task(protocol)) for problem in problems]
                tests = {problem.task.test(patches=problem.hand.patches) for problem in problems}
                protocol = tests.pop() if len(tests) == 1 else protocol
            problems = [loader.prepare(problem) for loader, problem in zip(loaders, problems, strict=True)]
            for note in dict.fromkeys(note for problem in problems for note in problem.notes):
                reporter.note(note)
            examined = [self._examine(problem, protocol, reporter) for problem in problems]
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        found = [part.validated for part in examined]
        compiling = sum(part.compile_cpu_s for part in examined)
        times = {"wall_s": wall, "cpu_s": cpu, "start_cpu_s": started, "compile_cpu_s": compiling}
        self._show(files, examined, protocol, times)
        written = self._write(files, examined, protocol, times)
        console = screen()
        console.print(f"{wall:.1f} s" + ("; wrote" if written else ""), *written, soft_wrap=True, markup=False)
        # Last, so that a replay that cannot be written affects nothing else.
        for folder, part in zip(self.recording.folders(files), examined, strict=False):
            for trial in part.trials:
                for line in self.recording.record(*trial, part.problem.hand.name, folder):
                    console.print(line, soft_wrap=True, markup=False)
        if self.output.record:
            for path, part in zip(files, examined, strict=True):
                found_in, problem = part.validated, part.problem
                tested = problem.task.test(patches=problem.hand.patches)
                closing = problem.closing(self.simulation.closing)
                line = record_verdicts(path, found_in.row, found_in.engines, tested, problem.task, closing)
                console.print(line, soft_wrap=True, markup=False)
        known = any(np.isfinite(part.metrics.penetration_m).any() for part in found)
        return 0 if known else NOTHING_USABLE

    def _protocol(self, named: SourceSpec, *, in_scene: bool) -> Protocol | None:
        """Return the protocol of the options; None: nothing is simulated.

        Raises:
            GraspRefineError: it cannot be read, or an invalid duration.
        """
        chosen = named.chosen_protocol(in_scene=in_scene) or default_protocol(in_scene=in_scene)
        return self.simulation.changed(chosen) if self.simulation.simulate else None

    def _show(
        self,
        files: tuple[Path, ...],
        examined: Sequence[_Examined],
        protocol: Protocol | None,
        times: Mapping[str, float],
    ) -> None:
        """Print the tables."""
        console = screen()
        for path, part in zip(files, examined, strict=True):
            if len(files) > 1:
                console.print(f"[bold]{escape(str(path))}[/]\n", soft_wrap=True)
            frictions, verbose = self.robustness.frictions, self.output.verbose
            console.print(
                validation_table(part.validated, part.problem.hand.name, protocol, frictions, verbose=verbose)
            )
            if protocol is not None:
                console.print(closing_line(part.problem.closing(self.simulation.closing)))
            if len(files) > 1:
                console.print()
        if self.output.compare is not None:
            before, after = examined
            console.print(comparison_table(before.validated, after.validated, before.problem.hand.name, protocol))
        measured = _measured(files, examined)
        if measured:
            console.print()
            compared, verbose = self.output.compare is not None, self.output.verbose
            show_margins(console, measured, compared=compared, verbose=verbose)
        if protocol is not None:
            cost = np.concatenate([part.validated.cpu_s for part in examined])
            rest = times["cpu_s"] - times["compile_cpu_s"] - cost.sum()
            rest -= sum(each.margins.cpu_s.sum() for each in measured)
            console.print(
                f"CPU: {times['start_cpu_s']:.1f} s to load the program, {times['compile_cpu_s']:.2f} s to compile, "
                f"{cost.sum():.1f} s to simulate ({cost.mean() * 1e3:.0f} ms a grasp), {rest:.1f} s for the rest"
            )

    def _check(self, protocol: Protocol | None, files: tuple[Path, ...]) -> None:
        """Refuse invalid options, and options without effect.

        Raises:
            GraspRefineError: names them.
        """
        check_numbers(self.robustness)
        check_numbers(self.margins)
        self.margins.check(protocol)
        if self.output.compare is not None and self.files:
            raise GraspRefineError("--compare BEFORE AFTER replaces FILE: give one of them")
        if not files:
            raise GraspRefineError("name a grasp file: refine-grasp validate FILE, or --compare BEFORE AFTER")
        if protocol is None and (
            self.simulation != Simulation(simulate=False)
            or self.robustness != Robustness()
            or self.margins != MarginsOptions()
        ):
            raise GraspRefineError("with --no-simulate, options of the simulation have no effect: leave them out")
        if self.output.record and protocol is None:
            raise GraspRefineError("--record needs the simulation: leave out --no-simulate")
        for path in files if self.output.record else ():
            if not path.is_file() or "hand_pose" not in load_npz(path, only=("hand_pose",)).entries:
                raise GraspRefineError(f"--record writes into grasp files of our format (.npz), not {path}")
        engines = chosen_engines(self.simulation.engine, ())
        if MUJOCO not in engines and (self.recording.replays is not None or self.margins.margins):
            option = "--margins" if self.margins.margins else "--replays"
            raise GraspRefineError(f"{option} simulates in MuJoCo: name it in --engine, too")
        if 0 in self.robustness.frictions:
            raise GraspRefineError("--frictions must be above 0")
        if len(set(self.robustness.frictions)) < len(self.robustness.frictions):
            raise GraspRefineError("--frictions names a coefficient twice")
        if self.robustness.noise == 0:
            for option in ("noise_offset", "noise_degrees"):
                if getattr(self.robustness, option) != getattr(Robustness, option):
                    raise GraspRefineError(f"{flag(option)} needs --noise N")
        for path in filter(None, (self.output.json, self.output.rows, self.output.html)):
            check_no_input(path, files, "would overwrite an input; give another name")
        check_writable(
            self.output.json,
            self.output.rows,
            self.output.html,
            overwrite=self.output.overwrite,
            inside=self.recording.replays,
        )
        if self.output.rows is not None:
            check_table(self.output.rows)

    def _examine(self, problem: Problem, protocol: Protocol | None, reporter: Reporter) -> _Examined:
        """Validate all grasps of a file."""
        compiling = -time.process_time()
        worlds: Sequence[World | None] = [None] * len(problem.groups)
        if protocol is not None:
            worlds = worlds_of(problem, on_note=reporter.note)
        compiling += time.process_time()
        tested = [world for world in worlds if world is not None]
        engines = chosen_engines(self.simulation.engine, tested, reporter.note) if tested else ()
        checks = self.robustness.checks(self.simulation.threads)
        parts, tried = list[Validated](), list[Margins]()
        trials = list[tuple[Group, World, Motion, Trials]]()
        drawn = self.margins.drawn(self.robustness.seed)
        other = None if drawn is None else other_model_of(problem.hand)
        for group, world in zip(problem.groups, worlds, strict=True):
            scene, motion = group.scene, None if world is None else group.motion(self.simulation.closing)
            found = validate(
                scene,
                name=group.object,
                scale=group.scale,
                rows=group.rows,
                index=group.index,
                world=world,
                motion=motion,
                checks=checks,
                engines=engines,
                progress=reporter.simulating(group),
            )
            parts.append(found)
            if drawn is not None and world is not None and motion is not None:
                drawn_in, progress = Worlds.of(world.hand, scene.object, scene.task, other), reporter.simulating(group)
                tried.append(margins(drawn_in, motion, drawn, threads=checks.threads, progress=progress))
            if world is not None and motion is not None and found.trials is not None:
                # Replays are MuJoCo's.
                trials.append((group, world, motion, found.engines.get(MUJOCO, found.trials)))
        if clipped := clipping_note([world for _, world, *_ in trials], [motion for _, _, motion, _ in trials]):
            reporter.note(clipped)
        if ignored := ignored_overlaps(problem.hand, np.concatenate([group.scene.q for group in problem.groups])):
            reporter.note(ignored)
        validated = Validated.join(parts).select(problem.order)
        if validated.closed_m is not None:
            for note in closing_notes(validated.closed_m, problem.hand.has_two_fingers):
                reporter.note(note)
        joined = Margins.join(tried).select(problem.order) if tried else None
        return _Examined(problem, validated, tuple(trials), compiling, joined)

    def _write(
        self,
        files: tuple[Path, ...],
        examined: Sequence[_Examined],
        protocol: Protocol | None,
        times: Mapping[str, float],
    ) -> list[Path]:
        """Write the output files; return their paths."""
        frictions, written = self.robustness.frictions, []
        found = [part.validated for part in examined]
        measured, drawn = _measured(files, examined), self.margins.drawn(self.robustness.seed)
        if self.output.json is not None:
            described = {
                "files": [
                    {
                        **fingerprint(path),
                        "closing": part.problem.closing(self.simulation.closing),
                        TASK: task_entry(part.problem.task),
                    }
                    for path, part in zip(files, examined, strict=True)
                ],
                "inputs": settings(self.sources),
                "simulation": settings(self.simulation),
                "margins": settings(self.margins),
                "robustness": settings(self.robustness),
                "protocol": settings(protocol),
            }
            document = validate_document(
                found,
                files,
                protocol=protocol,
                frictions=frictions,
                config=described,
                seed=self.robustness.seed,
                times=times,
            )
            if drawn is not None:
                add_margins(document, measured, drawn)
            save_json(self.output.json, document)
            written.append(self.output.json)
        if self.output.rows is not None:
            rows = flat_rows(found, files, protocol, frictions)
            if measured:
                add_columns(rows, measured)
            save_table(self.output.rows, rows)
            written.append(self.output.rows)
        if self.output.html is not None:
            save_text(self.output.html, self._page(self.output.html, files, examined, measured))
            written.append(self.output.html)
        return written

    def _page(
        self, path: Path, files: tuple[Path, ...], examined: Sequence[_Examined], measured: Sequence[MeasuredFile]
    ) -> str:
        """Return the page for `path`."""
        parts = [(file, each.problem, each.validated) for file, each in zip(files, examined, strict=True)]
        compared, look = self.output.compare is not None, tuple(words(replace(self.sources, index=())))
        if compared:
            sheets = [Sheet.of_validated("", parts)]
        else:
            sheets = [Sheet.of_validated(str(part[0]) if len(parts) > 1 else "", [part]) for part in parts]
        margins = margins_page(measured, compared=compared, seed=self.robustness.seed)
        called = invocation("validate", self)
        return page([(sheet, look) for sheet in sheets], path, invocation=called, margins=margins)


@dataclass(frozen=True, eq=False)
class _Examined:
    """Grasps of one file, with their validation."""

    problem: Problem
    """Grasps of the file."""
    validated: Validated
    """Results of all grasps, in the order of the input."""
    trials: tuple[tuple[Group, World, Motion, Trials], ...]
    """Grasps, simulated world, closing motion and trials, by object and scale."""
    compile_cpu_s: float
    """CPU time of compiling models for MuJoCo, seconds."""
    margins: Margins | None
    """Margins of all grasps, in the order of the input; None: not requested."""


def _measured(files: Sequence[Path], examined: Sequence[_Examined]) -> list[MeasuredFile]:
    """Return the margins of the files; none where they were not requested."""
    return [
        MeasuredFile(path, part.problem.hand.name, part.validated, part.margins)
        for path, part in zip(files, examined, strict=True)
        if part.margins is not None
    ]


def _check_comparable(before: Problem, after: Problem) -> None:
    """Refuse two files that evidently hold different grasps.

    Raises:
        GraspRefineError: their numbers or objects differ.
    """
    counts = len(before.names), len(after.names)
    if counts[0] != counts[1]:
        raise GraspRefineError(f"--compare needs the same grasps in both files: {counts[0]} against {counts[1]}")
    if before.names != after.names:
        raise GraspRefineError("--compare needs the same grasps in both files: their objects differ")
