"""`refine-grasp bench --gate`: compare speed and accuracy of the program with a committed baseline."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from tyro.conf import DisallowNone

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, save_json
from grasp_refine.core.machine import machine
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.versions import versions
from grasp_refine_apps.bench.gate.baseline import BASELINE, Group, Verdict, judged, load_baseline, updated
from grasp_refine_apps.bench.gate.measures import measure
from grasp_refine_apps.bench.report import Column, Table
from grasp_refine_apps.commands.benchmark import progress_bar
from grasp_refine_apps.commands.options import OptionalFile, Overwrite, default
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

WORDS = {True: "ok", False: "FAIL", None: "not available"}

GOT_WORSE = 1
"""Exit code when a ratio got worse."""


@dataclass(frozen=True)
class BenchGate:
    """Check that speed and accuracy did not get worse: some twenty ratios of one run, against a baseline.

    Ratios, not times, so that the check is valid on any machine: our query against coal's, a batch against single
    grasps, the number of queries per grasp and of solved grasps. Exit code 1: a ratio is beyond its limit.
    """

    baseline: Annotated[DisallowNone[Path | None], default("the baseline of the program", metavar="FILE")] = None
    """Baseline to compare with."""
    update: OptionalFile = None
    """Write the measured ratios as a new baseline, without a comparison; entries of other collision engines in this
    file are kept."""
    json: OptionalFile = None
    """Write all ratios to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: a baseline that cannot be used, or a file that cannot be written.
        """
        wall, cpu = time.perf_counter(), cpu_seconds()
        self._check()
        engine, console = chosen("auto"), screen()
        if self.update is not None:
            with _progress() as measured:
                now = {name: value for group in get_args(Group) for name, value in measured(group).items()}
            save_json(self.update, updated(self.update, engine, now, {"versions": versions(), "machine": machine()}))
            rows, worse, baseline = [{"name": name, "now": value} for name, value in now.items()], [], None
            message = f"wrote {len(rows)} ratios to {self.update}"
        else:
            baseline = self.baseline or BASELINE
            known = load_baseline(baseline, engine)
            with _progress() as measured:
                verdicts = judged(known, measured)
            console.print(gate_table(verdicts).printed())
            rows, worse = [one.row() for one in verdicts], [one.ratio.name for one in verdicts if one.ok is False]
            message = f"worse than allowed: {', '.join(worse)}" if worse else "nothing is worse than allowed"
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        entries = {"machine": machine(), "engine": engine, "baseline": baseline, "ok": not worse}
        save_document(self.json, "bench --gate", {**entries, "wall_s": wall, "cpu_s": cpu, "rows": rows})
        message += f"; wrote {self.json}" if self.json is not None else ""
        console.print(f"{message}\n{engine} engine, {wall:.1f} s, {cpu:.1f} s of CPU", soft_wrap=True, markup=False)
        return GOT_WORSE if worse else 0

    def _check(self) -> None:
        """Refuse options that do not go together.

        Raises:
            GraspRefineError: names the options.
        """
        if self.update is not None and self.baseline is not None:
            raise GraspRefineError("--update compares with nothing: leave out --baseline")
        # An update keeps the baseline's entries of other engines.
        check_writable(self.update, self.json, overwrite=True)
        check_writable(self.json, overwrite=self.overwrite)


@contextmanager
def _progress() -> Iterator[Callable[[Group], dict[str, float]]]:
    """Yield the function that measures the ratios of a group, with a progress bar over all groups."""
    with progress_bar(screen(stderr=True)) as bar:
        task = bar.add_task("loading", total=len(get_args(Group)))
        begun: dict[Group, str] = {}

        def measured(group: Group) -> dict[str, float]:
            label = f"{group}, once more" if group in begun else group
            begun[group] = label

            def progress(share: float) -> None:
                bar.update(task, completed=len(begun) - 1 + share, description=label)

            progress(0.0)
            return measure(group, progress)

        yield measured


def gate_table(verdicts: Sequence[Verdict]) -> Table:
    """Make a table with a line for each ratio: now, before, limit and meaning."""
    lines = []
    for one in verdicts:
        notes = " (measured twice)" if one.again else ""
        if one.ok is False and one.ratio.own:
            notes += ", or its reference got faster"
        bound = "" if one.known is None else f"{'≥' if one.ratio.higher else '≤'} {one.known.limit:.3g}"
        lines.append({**one.row(), "bound": bound, "word": WORDS[one.ok], "meaning": one.ratio.what + notes})
    return Table("", COLUMNS, lines)


COLUMNS = (
    Column("name", "ratio"),
    Column("now", "now"),
    Column("baseline", "before"),
    Column("bound", "allowed"),
    Column("word", ""),
    Column("meaning", "meaning"),
)
