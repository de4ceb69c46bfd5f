"""Common frame of all benchmarks: checks before the study, a progress bar, and the results as files and tables."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, ClassVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

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
from grasp_refine_apps.commands.options import NOTHING_USABLE, check_numbers
from grasp_refine_apps.report.command_line import flag, invocation
from grasp_refine_apps.report.screen import screen

SOMETHING_WRONG = 1
"""Exit code when a study found something wrong, or a job failed."""


class BenchCommand:
    """A command that runs the study which its options define.

    The options common to all, in the command or in its field `options`, are `preset`, `seed`, `json`, `html` and
    `overwrite`.
    """

    command: ClassVar[str]
    """Words of the command, such as "bench align"."""
    compared: ClassVar[tuple[str, ...]] = ()
    """Options that choose the comparison; a preset excludes them."""

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
        options: Any = getattr(self, "options", self)
        check_numbers(options)
        check_comparison(options, self.compared)
        return run_benchmark(self.command, self, self.study())


def check_comparison(options: Any, compared: Sequence[str]) -> None:
    """Refuse options without a value, and beside a preset options that choose the comparison.

    Raises:
        GraspRefineError: names the option.
    """
    for option in fields(options):
        if getattr(options, option.name) == ():
            raise GraspRefineError(f"{flag(option.name)} needs at least one value")
    if options.preset is not None:
        for name in compared:
            if getattr(options, name) is not None:
                raise GraspRefineError(
                    f"--preset {options.preset} defines the comparison itself: leave out {flag(name)}"
                )


def given(options: Any, study: type) -> dict[str, Any]:
    """Return the options that are given, not None, and are fields of a class; each value of a tuple once."""
    return {
        field.name: tuple(dict.fromkeys(value)) if isinstance(value, tuple) else value
        for field in fields(study)
        if (value := getattr(options, field.name, None)) is not None
    }


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


def benchmark_document(command: str, invoked: Any, *, preset: str | None, seed: int, **entries: Any) -> dict[str, Any]:
    """Return the JSON document of a benchmark: how and where it ran, its settings, and other entries."""
    return {
        "schema": SCHEMA,
        "command": command,
        "invocation": invocation(command, invoked),
        "versions": versions(),
        "machine": machine(),
        "engine": chosen("auto"),
        "preset": preset,
        "config": settings(invoked),
        "seed": seed,
        **entries,
    }


def run_benchmark(command: str, invoked: Any, study: Study) -> int:
    """Run a study, write and show its results, and return the exit code.

    Args:
        command: Words of the command, such as "bench align".
        invoked: Dataclass of the command; it, or its field `options`, has the options common to all benchmarks.
        study: The study.

    Raises:
        GraspRefineError: files that cannot be written, or inputs that the study cannot use.
    """
    wall, cpu = time.perf_counter(), cpu_seconds()
    options: Any = getattr(invoked, "options", invoked)
    # Where results are written says nothing about them.
    silent = replace(options, json=None, html=None, overwrite=False)
    invoked = silent if invoked is options else replace(invoked, options=silent)
    files = [path for path in (options.json, options.html) if path is not None]
    check_writable(*files, overwrite=options.overwrite)
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
    document = benchmark_document(
        command,
        invoked,
        preset=options.preset,
        seed=options.seed,
        wall_s=time.perf_counter() - wall,
        cpu_s=cpu_seconds() - cpu,
        problems=problems,
        rows=rows,
    )
    console = screen()
    for problem in problems:
        screen(stderr=True).print(problem, style="red", markup=False, soft_wrap=True)
    if not rows:
        console.print("no usable results; nothing was written")
        return INTERRUPTED if interrupted else NOTHING_USABLE
    report = study.report(rows, errors)
    if options.json is not None:
        save_json(options.json, document)
    if options.html is not None:
        save_text(options.html, report.page(document))
    for part in report.printed():
        console.print(part)
    wrote = f"; wrote {', '.join(map(str, files))}" if files else ""
    console.print(f"{document['wall_s']:.1f} s, {document['cpu_s']:.1f} s of CPU{wrote}", soft_wrap=True, markup=False)
    if interrupted:
        return INTERRUPTED
    return SOMETHING_WRONG if report.failed or errors else 0
