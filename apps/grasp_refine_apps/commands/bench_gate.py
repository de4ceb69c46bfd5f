"""`refine-grasp bench --gate`: compare speed and accuracy of the program with a committed baseline."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from tyro.conf import DisallowNone, arg

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import SCHEMA, check_writable, save_json
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.versions import versions
from grasp_refine_apps.bench.gate.baseline import BASELINE, judged, load_baseline, updated
from grasp_refine_apps.bench.gate.measures import measure
from grasp_refine_apps.bench.gate.ratios import Group
from grasp_refine_apps.bench.gate.table import gate_table
from grasp_refine_apps.bench.timing import machine
from grasp_refine_apps.commands.benchmark import progress_bar
from grasp_refine_apps.commands.options import Overwrite
from grasp_refine_apps.report.screen import screen

GOT_WORSE = 1
"""Exit code when a ratio got worse."""


@dataclass(frozen=True)
class BenchGate:
    """Check that nothing got slower or worse: some twenty ratios of one run, against those of a baseline.

    Ratios, not times, so that the check is valid on any machine: our query against coal's, a batch against single
    grasps, the number of queries per grasp and of solved grasps. Exit code 1: a ratio is beyond its limit.
    """

    baseline: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: the one that comes along)")
    ] = None
    """Baseline to compare with."""
    update: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Compare with nothing, but write the ratios measured now as a new baseline; the entries of other collision engines
    in this file are kept."""
    json: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
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
            with _Bar() as bar:
                now = {name: value for group in get_args(Group) for name, value in bar.measured(group).items()}
            save_json(self.update, updated(self.update, engine, now, {"versions": versions(), "machine": machine()}))
            rows, worse, baseline = [{"name": name, "now": value} for name, value in now.items()], [], None
            message = f"wrote {len(rows)} ratios to {self.update}"
        else:
            baseline = self.baseline or BASELINE
            known = load_baseline(baseline, engine)
            with _Bar() as bar:
                verdicts = judged(known, bar.measured)
            console.print(gate_table(verdicts))
            rows, worse = [one.row() for one in verdicts], [one.ratio.name for one in verdicts if one.ok is False]
            message = f"worse than allowed: {', '.join(worse)}" if worse else "nothing is worse than allowed"
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        if self.json is not None:
            document = {
                "schema": SCHEMA,
                "command": "bench --gate",
                "versions": versions(),
                "machine": machine(),
                "engine": engine,
                "baseline": baseline,
                "ok": not worse,
                "wall_s": wall,
                "cpu_s": cpu,
                "rows": rows,
            }
            save_json(self.json, document)
            message += f"; wrote {self.json}"
        console.print(f"{message}\n{engine} engine, {wall:.1f} s, {cpu:.1f} s of CPU", soft_wrap=True, markup=False)
        return GOT_WORSE if worse else 0

    def _check(self) -> None:
        """Refuse options that do not go together.

        Raises:
            GraspRefineError: names them.
        """
        if self.update is not None and self.baseline is not None:
            raise GraspRefineError("--update compares with nothing: leave out --baseline")
        # An update keeps the baseline's entries of other engines.
        check_writable(self.update, self.json, overwrite=True)
        check_writable(self.json, overwrite=self.overwrite)


class _Bar:
    """Progress bar over all groups."""

    def __init__(self) -> None:
        self._bar = progress_bar(screen(stderr=True))
        self._begun: list[Group] = []

    def __enter__(self) -> _Bar:
        self._bar.__enter__()
        self._task = self._bar.add_task("loading", total=len(get_args(Group)))
        return self

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)

    def measured(self, group: Group) -> dict[str, float]:
        """Measure the ratios of a group."""
        again = group in self._begun
        before, what = len(set(self._begun)) - again, f"{group}, once more" if again else group
        self._begun.append(group)

        def progress(share: float) -> None:
            self._bar.update(self._task, completed=before + share, description=what)

        progress(0.0)
        return measure(group, progress)
