"""`refine-grasp run`: refine the grasps of a hand, compare them before and after, and write them to files."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import arg

from grasp_refine.collision.engine import chosen
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_no_input, check_writable, save_json, save_text
from grasp_refine.core.profiling import Stopwatch, cpu_seconds
from grasp_refine.motion.plan import TrajectoryOptions
from grasp_refine.motion.trajectory_files import check_trajectory_file
from grasp_refine.objects.region_spec import is_of_file
from grasp_refine.problem.load import Loader
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.recorded_objects import pieces_digest, surface_digest
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.spec import NEAREST, SAMPLE, ProblemSpec
from grasp_refine.problem.trajectories import follow_trajectories, plan_trajectories
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import most_iterations
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.results.document import run_document, settings
from grasp_refine.results.profile import profile_table
from grasp_refine.results.result_files import is_same_refinement, result_paths
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import links_of
from grasp_refine.scene.task_file import TASK, task_entry
from grasp_refine_apps.batch.digests import Digests
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.simulation_options import ValidationOptions
from grasp_refine_apps.grasp_page.page import page
from grasp_refine_apps.grasp_page.sheet import Sheet
from grasp_refine_apps.processes.torch_threads import limit_torch_threads
from grasp_refine_apps.report.command_line import invocation, view_options
from grasp_refine_apps.report.progress import Reporter
from grasp_refine_apps.report.screen import screen


@dataclass(frozen=True)
class Output:
    """Outputs of a refinement."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("output", "Files, tables, the viewer."),)

    out: Path = Path("grasp-refine-results")
    """Folder for the refined grasps, <hand>_<object>.npz."""
    json: OptionalFile = None
    """Write the measures of each grasp to this file, in SI units."""
    html: OptionalFile = None
    """Write a page to this file: a card for each grasp with pictures as given and refined, and what changed most."""
    overwrite: Overwrite = False
    verbose: bool = False
    """List all grasps, even if there are more than 40."""
    profile: bool = False
    """Show the time of each stage, also in the --json file."""
    view: bool = False
    """Show the refined grasps in a browser, as `refine-grasp view` does."""


@dataclass(frozen=True)
class OutputWithTrajectory(Output):
    """Outputs of the command."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("output", "Files, tables, trajectories, the viewer."),)

    trajectory: OptionalFile = None
    """Plan the trajectory of each grasp, approach, pregrasp, grasp, squeeze and lift, report obstacles, and write
    waypoints and set points over time to this file, .json or .npz. With --validate and a protocol that lifts, MuJoCo
    follows each free trajectory, and reports objects held, hit and pushed."""
    approach: float = TrajectoryOptions.approach
    """Length (metres) of the straight approach to the pregrasp, with --trajectory."""
    lift: float = TrajectoryOptions.lift
    """Height (metres) of the lift, with --trajectory."""
    start: Annotated[str | None, arg(name="from", metavar="JOINTS")] = None
    """Joint values of the arm (radians, or metres of slides) with commas between them, from which it comes to the
    approach, straight in its joints, with --trajectory. By default the trajectory begins with the approach."""


@dataclass(frozen=True)
class Run:
    """Refine grasps of a hand on an object, and compare them before and after.

    Without options, the example grasps of the embedded hand on the embedded mug. Your own: `refine-grasp run --hand
    leap --grasps mine.npz`. New ones: `refine-grasp run --hand leap --object cup.stl --unit mm --grasps sample:16`.
    With --validate, grasps are simulated before and after; with --geometry-only, they only move into contact.
    """

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    validation: Annotated[ValidationOptions, arg(name="")] = field(default_factory=ValidationOptions)
    output: Annotated[OutputWithTrajectory, arg(name="")] = field(default_factory=OutputWithTrajectory)

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        wall, cpu = time.perf_counter(), cpu_seconds()
        config = self.settings.config(nearest=self.inputs.targets == NEAREST)
        named = self.inputs.with_named_task()
        if named.table is None and config.weights.table != Weights.table:
            raise GraspRefineError("--weights.table needs a --table")
        if not named.in_scene and config.weights.environment != Weights.environment:
            raise GraspRefineError("--weights.environment needs a --scene")
        if not self._has_regions() and config.weights.region != Weights.region:
            raise GraspRefineError("--weights.region needs a region: give --touch or --avoid")
        described = {
            "inputs": settings(self.inputs),
            "refine": settings(config),
            "validation": settings(self.validation),
        }
        limit_torch_threads(config)
        watch = Stopwatch() if self.output.profile else None
        with watch or nullcontext(), Reporter(screen(stderr=True)) as reporter:
            options = self._trajectory_options()
            check_writable(
                self.output.json,
                self.output.html,
                self.output.trajectory,
                overwrite=self.output.overwrite,
                inside=self.output.out,
            )
            loader = Loader(self.inputs, config.seed, reporter.say, reporter.wait)
            problem = loader.problem()
            engines = self.validation.engines
            protocol = problem.task.test(patches=problem.hand.patches) if engines else None
            described |= {"protocol": settings(protocol), TASK: task_entry(problem.task)}
            self._check_applicable(problem, config)
            stamps = self._stamps(problem, loader.spec, described["refine"])
            paths = self._paths(problem, stamps, protocol)
            problem = loader.prepare(problem)
            for note in problem.notes:
                reporter.note(note)
            most = most_iterations(config, aimed=problem.aimed)
            reporter.start(problem.hand.name, len(problem), most, config.starts if config.holds else 0)
            objects = {name: {"config": described, "stamp": stamp} for name, stamp in stamps.items()}

            def write(refined: RefinedGrasps) -> None:
                if refined.outcome.usable.any():
                    refined.write(paths, objects)

            # Before the simulation, too, so that whatever happens in it loses no refined grasps.
            refined = refine_problem(problem, config, engines=engines, listener=reporter, on_refined=write)
            planned = None if options is None else plan_trajectories(refined, options)
            if planned is not None and protocol is not None and protocol.tabletop:
                planned = follow_trajectories(refined, planned)
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        profile = None if watch is None else watch.profile
        outcome = refined.outcome
        if refined.simulated is not None:
            write(refined)
        if self.output.json is not None:
            document = run_document(
                outcome, config, refined.simulated, config=described, wall_s=wall, cpu_s=cpu, profile=profile
            )
            if planned is not None:
                for number, entry in enumerate(document["grasps"]):
                    entry["trajectory"] = planned.entry(number)
            save_json(self.output.json, document)
        if self.output.html is not None and outcome.usable.any():
            sheet = Sheet.of_refined(refined, paths)
            look, called = view_options(self.inputs), invocation("run", self)
            save_text(self.output.html, page([(sheet, look)], self.output.html, invocation=called))
        if planned is not None and self.output.trajectory is not None:
            planned.save(self.output.trajectory)
        console = screen()
        console.print(refined.table(verbose=self.output.verbose))
        for line in () if planned is None else planned.lines():
            console.print(line, soft_wrap=True, markup=False)
        if planned is not None and protocol is not None and planned.executions is None:
            console.print(
                f"trajectories are not followed in simulation: {protocol.name} pushes; --protocol scene lifts",
                soft_wrap=True,
            )
        elif planned is not None and protocol is not None and _floats(problem):
            console.print(
                "the simulation puts a table under the object, unknown to refinement and trajectories: give --table",
                style="yellow",
                soft_wrap=True,
            )
        if profile is not None:
            console.print(profile_table(profile))
        if not outcome.usable.any():
            console.print("no usable results; no grasps were written")
            return NOTHING_USABLE
        written = [*paths.values(), *filter(None, (self.output.json, self.output.html, self.output.trajectory))]
        between = " " if len(written) == 1 else "\n  "
        console.print(f"{wall:.1f} s; wrote", *written, sep=between, soft_wrap=True, markup=False)
        return self._show_result(paths) if self.output.view else 0

    def _has_regions(self) -> bool:
        """Return whether regions are given, or may be by a scene or by results of an earlier refinement."""
        inputs = self.inputs.with_named_task()
        read = inputs.grasps is not None and not str(inputs.grasps).startswith(SAMPLE)
        return bool(inputs.touch or inputs.avoid or read or inputs.in_scene)

    def _trajectory_options(self) -> TrajectoryOptions | None:
        """Return the lengths of the trajectories; None where none are planned.

        Raises:
            GraspRefineError: a length is not one, or there is no --trajectory that it is for, or that is no such file.
        """
        out = self.output
        if out.trajectory is None:
            for name in ("approach", "lift"):
                if getattr(out, name) != getattr(TrajectoryOptions, name):
                    raise GraspRefineError(f"--{name} needs --trajectory, which plans the trajectory of the grasps")
            if out.start is not None:
                raise GraspRefineError(
                    f"--from {out.start}: needs --trajectory, which plans the trajectory of the grasps"
                )
            return None
        check_trajectory_file(out.trajectory)
        return TrajectoryOptions(out.approach, out.lift, None if out.start is None else _joint_values(out.start))

    def _show_result(self, paths: dict[str, Path]) -> int:
        """Show the result of the first object until interrupted."""
        from grasp_refine_apps.commands.view import Serving, View

        first, path = next(iter(paths.items()))
        if len(paths) > 1:
            screen().print(f"showing {first}; refine-grasp view {self.output.out} shows all", soft_wrap=True)
        # The scale in the result is the factor from the mesh to metres.
        other = ("index", "targets", "scale", "unit", "format", "other_object")
        inputs = replace(self.inputs, grasps=path, **{name: getattr(Inputs, name) for name in other})
        # Any free port, so that this does not fail at the end.
        return View(inputs=inputs, settings=self.settings, serving=Serving(port=0)).execute()

    def _check_applicable(self, problem: Problem, config: Config) -> None:
        """Refuse options that have no effect for these grasps.

        Raises:
            GraspRefineError: names them.
        """
        touching = config.contact_selection
        touching.named(problem.hand, links_of(problem.hand))
        Frozen.of(problem.hand, config.freeze)
        if touching != ContactSelection() and problem.aimed and not config.holds:
            raise GraspRefineError(
                "--contacts, --reach and --other-link-distance have no effect here: without force balance, the targets "
                "alone choose the contact links"
            )

    def _stamps(self, problem: Problem, spec: ProblemSpec, refine: Any) -> dict[str, str]:
        """Object name -> hash of everything that its refined grasps depend on, apart from the simulation."""
        digests = Digests()
        _, hand = digests.hand(spec.hand or problem.hand.name, spec, lambda line: None)
        source = problem.sampled or digests.file(problem.files[0])["sha256"]
        around = problem.task.environment
        regions = (*spec.touch, *spec.avoid, *(() if around is None else (*around.touch, *around.avoid)))
        # Colours and the order of faces are no part of a surface.
        reads_faces = any(is_of_file(str(region)) for region in regions)

        def stamp(groups: Iterable[Group]) -> str:
            return digests.stamp(
                spec,
                refine=refine,
                engine=chosen("auto"),
                source=source,
                hand=hand,
                objects=[(group.key, surface_digest(group.scene.object.mesh)) for group in groups],
                pieces=[pieces_digest(group.scene.object.supplied) for group in groups],
                rows=[group.rows for group in groups],
                **({} if around is None else {"scene": around.digest}),
                **({"files": [_file_digest(group, digests) for group in groups]} if reads_faces else {}),
            )

        names = dict.fromkeys(group.object for group in problem.groups)
        return {name: stamp([group for group in problem.groups if group.object == name]) for name in names}

    def _paths(self, problem: Problem, stamps: Mapping[str, str], protocol: Protocol | None) -> dict[str, Path]:
        """Object name -> result file, which may overwrite no input, and only the same result.

        Raises:
            GraspRefineError: names the file.
        """
        out = self.output
        paths = result_paths(out.out, problem.hand.name, tuple(stamps))
        for path in filter(None, (*paths.values(), out.json, out.html, out.trajectory)):
            check_no_input(
                path,
                problem.files,
                "the results would overwrite an input; give another --out, --json, --html or --trajectory",
            )
        for name, path in paths.items():
            again = is_same_refinement(path, stamps[name], settings(protocol))
            check_writable(path, overwrite=out.overwrite or again, inside=out.out)
        check_writable(*paths.values(), out.json, out.html, overwrite=True, inside=out.out)
        return paths


def _joint_values(text: str) -> tuple[float, ...]:
    """Return the numbers of --from.

    Raises:
        GraspRefineError: the text is not numbers with commas between them.
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise GraspRefineError(
            f"--from {text}: must be the joint values of the arm, as in 0,-1.57,1.57,-1.57,-1.57,0"
        ) from None


def _file_digest(group: Group, digests: Digests) -> str:
    """Return the hash of the file of an object's mesh; empty: it is of none."""
    file = group.scene.object.file
    return "" if file is None else str(digests.file(file[0])["sha256"])


def _floats(problem: Problem) -> bool:
    """Return whether an object of a problem has nothing around it."""
    scenes = [group.scene for group in problem.groups]
    return any(scene.table is None and scene.environment is None for scene in scenes)
