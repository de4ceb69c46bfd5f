"""What all benchmarks do around their study: checks before it, a progress bar, and the results as files and tables."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

from rich.console import Console, RenderableType

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import SCHEMA, check_writable, save_json, save_text
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.versions import versions
from grasp_refine.results.document import settings
from grasp_refine_apps.bench.bar import progress_bar
from grasp_refine_apps.bench.machine import machine
from grasp_refine_apps.commands.ending import NOTHING_USABLE
from grasp_refine_apps.commands.invocation import invocation
from grasp_refine_apps.commands.options import flag
from grasp_refine_apps.report.screen import screen


@runtime_checkable
class Options(Protocol):
    """Options that every benchmark has."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def preset(self) -> str | None:
        """The experiment, one of those that are known by name."""
        ...

    @property
    def seed(self) -> int:
        """Seed of everything that is drawn."""
        ...

    @property
    def json(self) -> Path | None:
        """Where results go as JSON."""
        ...

    @property
    def html(self) -> Path | None:
        """Where the report goes."""
        ...

    @property
    def overwrite(self) -> bool:
        """Whether files that exist may be replaced."""
        ...


@runtime_checkable
class Outcome(Protocol):
    """What comes out of every study."""

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The entries of the tables."""
        ...

    @property
    def problems(self) -> list[str]:
        """What went wrong."""
        ...


Found = TypeVar("Found", bound=Outcome)


def check_asked(options: Options, compared: Sequence[str]) -> None:
    """Refuse options without a value, and beside a preset those that say what is compared.

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
                    f"--preset {options.preset} says itself what is compared: leave out {flag(name)}"
                )


def run_benchmark(
    command: str,
    asked: Any,
    options: Options,
    run: Callable[[Console, Callable[[float, str], None]], Found],
    tables: Callable[[Found], Iterable[RenderableType]],
    page: Callable[[dict[str, Any], Found], str],
    also: Sequence[Path] = (),
) -> int:
    """Run a study, write and show what came out; returns the exit code.

    Args:
        command: Words of the command, such as "bench align".
        asked: Its dataclass.
        options: The part of it with the options that every benchmark has.
        run: Does the study; gets the console of the progress bar, and what takes the share of the work that is done.
        tables: What is printed of the results.
        page: The HTML report of the JSON document and the results.
        also: Further files that `run` writes.

    Raises:
        GraspRefineError: files that cannot be written, or what `run` raises.
    """
    wall, cpu = time.perf_counter(), cpu_seconds()
    files = [path for path in (options.json, options.html, *also) if path is not None]
    check_writable(*files, overwrite=options.overwrite)
    with progress_bar(screen(stderr=True)) as bar:
        task = bar.add_task("loading", total=1.0)

        def progress(share: float, what: str) -> None:
            bar.update(task, completed=share, description=what)

        outcome = run(bar.console, progress)
    document = {
        "schema": SCHEMA,
        "command": command,
        "invocation": invocation(command, asked),
        "versions": versions(),
        "machine": machine(),
        "engine": chosen("auto"),
        "preset": options.preset,
        "config": settings(asked),
        "seed": options.seed,
        "wall_s": time.perf_counter() - wall,
        "cpu_s": cpu_seconds() - cpu,
        "problems": outcome.problems,
        "rows": outcome.rows,
    }
    console = screen()
    for problem in outcome.problems:
        screen(stderr=True).print(problem, style="red", markup=False, soft_wrap=True)
    if not outcome.rows:
        console.print("nothing usable came out; nothing was written")
        return NOTHING_USABLE
    if options.json is not None:
        save_json(options.json, document)
    if options.html is not None:
        save_text(options.html, page(document, outcome))
    for table in tables(outcome):
        console.print(table)
    wrote = f"; wrote {', '.join(map(str, files))}" if files else ""
    console.print(f"{document['wall_s']:.1f} s, {document['cpu_s']:.1f} s of CPU{wrote}", soft_wrap=True, markup=False)
    return 0
