"""`refine-grasp run`: refine the grasps of a hand, say before and after what changed, and write them to files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from tyro.conf import DisallowNone, arg

from grasp_refine.commands.ending import NOTHING_USABLE
from grasp_refine.commands.inputs import NEAREST, Inputs
from grasp_refine.commands.proving import Proving
from grasp_refine.commands.refining import proved, refined
from grasp_refine.commands.settings import Settings
from grasp_refine.config import Config
from grasp_refine.errors import GraspRefineError
from grasp_refine.hand_object import HandObject
from grasp_refine.holding import most_iterations
from grasp_refine.losses import Weights
from grasp_refine.problem import Problem
from grasp_refine.report.document import run_document, settings
from grasp_refine.report.outcome import Outcome
from grasp_refine.report.profile import profile_table
from grasp_refine.report.progress import Reporter
from grasp_refine.report.proof import Proof
from grasp_refine.report.results import fingerprint, result_paths, save_results
from grasp_refine.report.screen import screen
from grasp_refine.report.table import grasp_table
from grasp_refine.report.writing import check_no_input, check_writable, save_json
from grasp_refine.stopwatch import Stopwatch, cpu_seconds
from grasp_refine.targets import Touching
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.trials import Trials
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
    profile: bool = False
    """Show where the time went, by stage: also in the --json file."""
    view: bool = False
    """Show what came out in a browser, as `refine-grasp view` does."""


@dataclass(frozen=True)
class Run:
    """Refine grasps of a hand on an object, and say before and after what changed.

    Without options, the example grasps of the embedded hand on the embedded mug.
    """

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    proof: Annotated[Proving, arg(name="")] = field(default_factory=Proving)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)

    def execute(self) -> int:
        """Do it; returns the exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        wall, cpu = time.perf_counter(), cpu_seconds()
        config = self.settings.config(nearest=self.inputs.targets == NEAREST)
        protocol = self.proof.protocol()
        if self.inputs.table is None and config.weights.table != Weights.table:
            raise GraspRefineError("--weights.table needs a --table")
        # The tensors of a batch of grasps are small.
        torch.set_num_threads(1)
        watch = Stopwatch() if self.output.profile else None
        with watch or nullcontext(), Reporter(screen(stderr=True)) as reporter:
            if self.output.json is not None:
                check_writable(self.output.json)
            problem = self.inputs.load(config.seed, reporter.say, reporter.wait)
            self._check_used(problem, config)
            paths = self._paths(problem)
            for note in problem.notes:
                reporter.say(f"note: {note}")
            held = config.holds and not _aimed(problem, config)
            most = most_iterations(config) if held else config.solver.iterations
            reporter.start(problem.hand.name, len(problem), most, config.starts if held else 0)
            parts = [
                refined(group, config, reporter.group(group.object, len(group.rows)), HandObject.of(group.scene))
                for group in problem.groups
            ]
            proof = None if protocol is None else _proved(problem, parts, protocol, reporter)
            outcome = Outcome.join(parts).select(problem.order)
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        profile = None if watch is None else watch.profile
        described = {
            "inputs": settings(self.inputs),
            "refine": settings(config),
            "proof": settings(self.proof),
            "protocol": settings(protocol),
        }
        if outcome.usable.any():
            self._save(problem, outcome, paths, {"seed": config.seed, "config": described}, proof)
        if self.output.json is not None:
            save_json(
                self.output.json,
                run_document(outcome, config, proof, config=described, wall_s=wall, cpu_s=cpu, profile=profile),
            )
        console = screen()
        console.print(grasp_table(outcome, problem.hand.name, config, proof, verbose=self.output.verbose))
        if profile is not None:
            console.print(profile_table(profile))
        if not outcome.usable.any():
            console.print("nothing usable came out; no grasps were written")
            return NOTHING_USABLE
        written = [*paths.values(), *([self.output.json] if self.output.json else [])]
        between = " " if len(written) == 1 else "\n  "
        console.print(f"{wall:.1f} s; wrote", *written, sep=between, soft_wrap=True, markup=False)
        return self._viewed(paths) if self.output.view else 0

    def _viewed(self, paths: dict[str, Path]) -> int:
        """Show the result of the first object until interrupted."""
        from grasp_refine.commands.view import Serving, View

        first, path = next(iter(paths.items()))
        if len(paths) > 1:
            screen().print(f"showing {first}; refine-grasp view {self.output.out} shows all", soft_wrap=True)
        inputs = replace(self.inputs, grasps=path, index=(), targets=Inputs.targets, scale=1.0, format=None)
        # Not to fail now because some port is taken.
        return View(inputs=inputs, settings=self.settings, serving=Serving(port=0)).execute()

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
        if _aimed(problem, config):
            self.settings.check_aimed()

    def _paths(self, problem: Problem) -> dict[str, Path]:
        """Object name -> result file; nothing that is written takes the place of an input."""
        names = tuple(dict.fromkeys(group.object for group in problem.groups))
        paths = result_paths(self.output.out, problem.hand.name, names)
        for path in paths.values():
            check_writable(path)
        for path in [*paths.values(), *([self.output.json] if self.output.json else [])]:
            check_no_input(path, problem.files, "the results would overwrite an input; give another --out or --json")
        return paths

    def _save(
        self,
        problem: Problem,
        outcome: Outcome,
        paths: dict[str, Path],
        provenance: dict[str, object],
        proof: Proof | None,
    ) -> None:
        source: dict[str, Any] = fingerprint(problem.files[0])
        # Which grasps were drawn depends on the hand, the object and the seed.
        source = {"sampled": problem.sampled, "hand": source} if problem.sampled else source
        hand = fingerprint(problem.hand.urdf)
        provenance = {"versions": versions(), **provenance, "source": source, "urdf": hand}
        links = problem.groups[0].scene.links
        for name, path in paths.items():
            rows = np.flatnonzero(outcome.object == name)
            trials = None if proof is None else (proof.before.select(rows), proof.after.select(rows))
            save_results(path, problem.hand, links, outcome.select(rows), provenance, trials)


def _aimed(problem: Problem, config: Config) -> bool:
    """Whether links have targets."""
    return config.nearest or any(group.scene.target_link is not None for group in problem.groups)


def _proved(problem: Problem, parts: Sequence[Outcome], protocol: Protocol, reporter: Reporter) -> Proof:
    """What simulation says of all grasps before and after, in the order in which they were asked for."""
    from grasp_refine.validation.validate import model_of
    from grasp_refine.validation.world import build_world

    model = model_of(problem.hand)
    for note in model.notes:
        reporter.say(f"note: {note}")
    trials = []
    for group, part in zip(problem.groups, parts, strict=True):
        world = build_world(model, group.scene.object, protocol, group.scene.table)
        trials.append(proved(group, part, world, reporter.telling(group.object, len(part))))
    before, after = zip(*trials, strict=True)
    return Proof(
        protocol,
        Trials.join(before).select(problem.order),
        problem.closing(),
        Trials.join(after).select(problem.order),
    )
