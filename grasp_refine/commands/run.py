"""`refine-grasp run`: refine the grasps of a hand, say before and after what changed, and write them to files."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from tyro.conf import DisallowNone, arg

from grasp_refine.commands.ending import NOTHING_USABLE, cpu_seconds
from grasp_refine.commands.inputs import NEAREST, Inputs, Problem
from grasp_refine.commands.settings import Settings
from grasp_refine.config import Config
from grasp_refine.errors import GraspRefineError
from grasp_refine.losses import Weights
from grasp_refine.refine import refine
from grasp_refine.report.document import run_document, settings
from grasp_refine.report.outcome import Outcome, compare
from grasp_refine.report.progress import Reporter
from grasp_refine.report.results import fingerprint, result_paths, save_results
from grasp_refine.report.screen import screen
from grasp_refine.report.table import grasp_table
from grasp_refine.report.writing import check_writable, save_json
from grasp_refine.targets import Touching
from grasp_refine.versions import versions


@dataclass(frozen=True)
class Output:
    """What is told."""

    out: Path = Path("grasp-refine-results")
    """Folder for the refined grasps, <hand>_<object>.npz."""
    json: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write what was measured of each grasp to this file, in SI units."""
    verbose: bool = False
    """List all grasps, also when there are more than 40."""


@dataclass(frozen=True)
class Run:
    """Refine grasps of a hand on an object, and say before and after what changed.

    Without options, the example grasps of the embedded hand on the embedded mug.
    """

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)

    def execute(self) -> int:
        """Do it; returns the exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        wall, cpu = time.perf_counter(), cpu_seconds()
        config = self.settings.config(nearest=self.inputs.targets == NEAREST)
        if self.inputs.table is None and config.weights.table != Weights.table:
            raise GraspRefineError("--weights.table needs a --table")
        # The tensors of a batch of grasps are small.
        torch.set_num_threads(1)
        with Reporter(screen(stderr=True)) as reporter:
            if self.output.json is not None:
                check_writable(self.output.json)
            problem = self.inputs.load(config.seed, reporter.say)
            self._check_used(problem, config)
            paths = self._paths(problem)
            for note in problem.notes:
                reporter.say(f"note: {note}")
            reporter.start(problem.hand.name, len(problem), config.solver.iterations)
            outcome = _refined(problem, config, reporter)
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        described = {"inputs": settings(self.inputs), "refine": settings(config)}
        if outcome.usable.any():
            self._save(problem, outcome, paths, {"seed": config.seed, "config": described})
        if self.output.json is not None:
            save_json(
                self.output.json,
                run_document(outcome, config=described, seed=config.seed, wall_s=wall, cpu_s=cpu),
            )
        console = screen()
        console.print(grasp_table(outcome, problem.hand.name, verbose=self.output.verbose))
        if not outcome.usable.any():
            console.print("nothing usable came out; no grasps were written")
            return NOTHING_USABLE
        written = [*paths.values(), *([self.output.json] if self.output.json else [])]
        between = " " if len(written) == 1 else "\n  "
        console.print(f"{wall:.1f} s; wrote", *written, sep=between, soft_wrap=True, markup=False)
        return 0

    def _check_used(self, problem: Problem, config: Config) -> None:
        """Refuse options that would mean nothing for these grasps.

        Raises:
            GraspRefineError: names them.
        """
        touching = config.touching
        touching.check(problem.hand, problem.groups[0].scene.links)
        if touching != Touching() and any(group.scene.target_link is not None for group in problem.groups):
            raise GraspRefineError(
                "--contacts, --reach and --reach-others are for grasps without targets: the targets say what touches"
            )

    def _paths(self, problem: Problem) -> dict[str, Path]:
        """Object name -> result file; nothing that is written takes the place of an input."""
        names = tuple(dict.fromkeys(group.object for group in problem.groups))
        paths = result_paths(self.output.out, problem.hand.name, names)
        for path in paths.values():
            check_writable(path)
        for path in [*paths.values(), *([self.output.json] if self.output.json else [])]:
            if path.exists() and any(path.samefile(file) for file in problem.files):
                raise GraspRefineError(f"{path}: the results would overwrite an input; give another --out or --json")
        return paths

    def _save(self, problem: Problem, outcome: Outcome, paths: dict[str, Path], provenance: dict[str, object]) -> None:
        provenance = {"versions": versions(), **provenance, "source": fingerprint(problem.files[0])}
        links = problem.groups[0].scene.links
        for name, path in paths.items():
            rows = np.flatnonzero(outcome.object == name)
            save_results(path, problem.hand, links, outcome.select(rows), provenance)


def _refined(problem: Problem, config: Config, reporter: Reporter) -> Outcome:
    """All grasps of the problem before and after, in the order in which they were asked for."""
    parts = []
    for group in problem.groups:
        refinement = refine(group.scene, config, reporter.group(group.object, len(group.rows)))
        parts.append(
            compare(
                group.scene,
                refinement,
                margin=config.margin,
                name=group.object,
                scale=group.scale,
                row=group.rows,
                index=group.index,
            )
        )
    return Outcome.join(parts).select(np.argsort(np.concatenate([group.place for group in problem.groups])))
