"""Common frame of all benchmarks: checks before the study, a progress bar, and the results as files and tables."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from tyro.conf import arg

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.interruption import INTERRUPTED
from grasp_refine.core.json_files import SCHEMA, check_writable, save_json, save_text
from grasp_refine.core.machine import machine
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.versions import versions
from grasp_refine.results.document import settings
from grasp_refine_apps.bench.jobs import run_jobs
from grasp_refine_apps.bench.study import Study
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite, check_numbers
from grasp_refine_apps.report.command_line import flag, invocation
from grasp_refine_apps.report.screen import screen

SOMETHING_WRONG = 1
"""Exit code when a study found something wrong, or a job failed."""


@dataclass(frozen=True)
class Outputs:
    """Options of the run and its outputs, common to all benchmarks."""

    seed: int = 0
    """Seed of all random numbers."""
    workers: int = 1
    """Number of processes. CPU times are least disturbed with 1."""
    json: OptionalFile = None
    """Write all rows to this file, in SI units unless the key names another."""
    html: OptionalFile = None
    """Write a report with charts to this file."""
    markdown: OptionalFile = None
    """Write the tables of the report as Markdown to this file."""
    overwrite: Overwrite = False

    @property
    def files(self) -> list[Path]:
        """The files to write."""
        return [path for path in (self.json, self.html, self.markdown) if path is not None]


class BenchCommand:
    """A command that runs the study which its options define; it has fields `preset` and `outputs`."""

    command: ClassVar[str]
    """Words of the command, such as "bench align"."""
    compared: ClassVar[tuple[str, ...]] = ()
    """Options that choose the comparison; a preset excludes them."""
    outputs: Annotated[Outputs, arg(name="")]
    preset: Any

    def study(self) -> Study:
        """Return the study that the options define; their numbers were checked.

        Raises:
            GraspRefineError: options that do not go together, or something that is not available.
        """
        raise NotImplementedError

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: a number out of its range, as `study`, or inputs that cannot be used.
        """
        options: Any = self
        check_numbers(self)
        check_numbers(self.outputs)
        for option in fields(options):
            if getattr(self, option.name) == ():
                raise GraspRefineError(f"{flag(option.name)} needs at least one value")
        for name in self.compared if self.preset is not None else ():
            if getattr(self, name) is not None:
                raise GraspRefineError(f"--preset {self.preset} defines the comparison itself: leave out {flag(name)}")
        return run_benchmark(self.command, self, self.study())

    def given(self, kind: type) -> dict[str, Any]:
        """Return the options that are given, not None, and are fields of a class; each value of a tuple once."""
        found = {}
        for option in fields(kind):
            value = getattr(self, option.name, getattr(self.outputs, option.name, None))
            if value is not None:
                found[option.name] = tuple(dict.fromkeys(value)) if isinstance(value, tuple) else value
        return found


def progress_bar(console: Console) -> Progress:
    """Make a bar that disappears at the end, and is shown only in a terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def run_benchmark(command: str, invoked: Any, study: Study) -> int:
    """Run a study, write and show its results, and return the exit code.

    Args:
        command: Words of the command, such as "bench align".
        invoked: Dataclass of the command, with fields `preset` and `outputs`.
        study: The study.

    Raises:
        GraspRefineError: files that cannot be written, or inputs that the study cannot use.
    """
    wall, cpu = time.perf_counter(), cpu_seconds()
    outputs: Outputs = invoked.outputs
    files = outputs.files
    check_writable(*files, overwrite=outputs.overwrite)
    # Where results are written says nothing about them.
    invoked = replace(invoked, outputs=Outputs(outputs.seed, outputs.workers))
    with progress_bar(screen(stderr=True)) as bar:
        task = bar.add_task("loading", total=1.0)

        def progress(share: float, what: str) -> None:
            bar.update(task, completed=share, description=what)

        def say(line: str) -> None:
            bar.console.print(escape(line), style="dim", soft_wrap=True)

        todo = study.jobs(say)
        done, errors, interrupted = run_jobs(todo, study.workers, progress)
    problems = [*errors, *([f"interrupted: {len(done)} of {len(todo)} jobs were done"] if interrupted else [])]
    rows = study.rows(done)
    document = {
        "schema": SCHEMA,
        "command": command,
        "invocation": invocation(command, invoked),
        "versions": versions(),
        "machine": machine(),
        "engine": chosen("auto"),
        "preset": invoked.preset,
        "config": settings(invoked),
        "seed": outputs.seed,
        "wall_s": time.perf_counter() - wall,
        "cpu_s": cpu_seconds() - cpu,
        "problems": problems,
        "rows": rows,
    }
    console = screen()
    for problem in problems:
        screen(stderr=True).print(problem, style="red", markup=False, soft_wrap=True)
    if not rows:
        console.print("no usable results; nothing was written")
        return INTERRUPTED if interrupted else NOTHING_USABLE
    report = study.report(rows, errors)
    if outputs.json is not None:
        save_json(outputs.json, document)
    if outputs.html is not None:
        save_text(outputs.html, report.page(document))
    if outputs.markdown is not None:
        save_text(outputs.markdown, report.markdown(document))
    for part in report.printed():
        console.print(part)
    wrote = f"; wrote {', '.join(map(str, files))}" if files else ""
    console.print(f"{document['wall_s']:.1f} s, {document['cpu_s']:.1f} s of CPU{wrote}", soft_wrap=True, markup=False)
    if interrupted:
        return INTERRUPTED
    return SOMETHING_WRONG if report.failed or errors else 0
