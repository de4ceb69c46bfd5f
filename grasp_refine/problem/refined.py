"""Refined grasps of a problem: printed as a table, shown in a notebook, saved as a result file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.machine import machine
from grasp_refine.core.plurals import count_text
from grasp_refine.core.short_repr import labels, tallied
from grasp_refine.core.versions import versions
from grasp_refine.forces.squeeze_forces import ContactForces
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.problem.problem import Problem, aim
from grasp_refine.problem.recorded_objects import object_entries
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.console import html_of, text_of
from grasp_refine.results.document import settings
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.result_files import fingerprint, refined_set, result_paths, save_results
from grasp_refine.results.result_numbers import number_entries
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.results.table import grasp_table
from grasp_refine.results.validation_document import TABLE_SUFFIXES, check_table, save_table
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import TASK, task_entry


@dataclass(frozen=True, eq=False)
class RefinedGrasps:
    """N grasps before and after their refinement, in the requested order."""

    problem: Problem
    """Hand, objects and input grasps."""
    config: Config
    """Settings of the refinement."""
    outcome: Outcome
    """Poses, joint values and measures, before and after."""
    simulated: SimulatedGrasps | None = None
    """Grasps in simulation, before and after; None: not simulated."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.outcome)

    @property
    def task(self) -> Task:
        """Task that the grasps were refined for."""
        return self.problem.task

    @property
    def status(self) -> np.ndarray:
        """Status of the refinement of each grasp (N,), in words."""
        return labels(Status, self.outcome.status)

    @property
    def change(self) -> np.ndarray:
        """Change of each grasp (N,), a `Change` in words; empty where it was not refined at all."""
        return self.outcome.change

    @property
    def quality(self) -> np.ndarray:
        """Estimated quality (N, 2) before and after, from 0 to 1; NaN where there are no contacts."""
        return self.outcome.quality

    @property
    def before(self) -> GraspSet:
        """Input grasps, joint values in the order of the hand."""
        hand, outcome = self.problem.hand, self.outcome
        pose, q = outcome.hand_pose_before, outcome.q_before
        return GraspSet(
            hand.name, hand.base_link, hand.joint_names, outcome.object, outcome.scale, pose, q, labels=outcome.labels
        )

    @property
    def after(self) -> GraspSet:
        """Refined grasps, with their targets, pregrasps and squeezes."""
        return refined_set(self.problem.hand, self.problem.groups[0].scene.links, self.outcome)

    @property
    def pregrasp(self) -> Stage:
        """Open hand before each refined grasp: poses (N, 7) and joint values (N, n)."""
        return self._stage("pregrasp")

    @property
    def squeeze(self) -> Stage:
        """Set points of position actuators with which the hand presses: poses (N, 7) and joint values (N, n)."""
        return self._stage("squeeze")

    @property
    def forces(self) -> ContactForces:
        """Forces on the object with which the squeezes are planned to press, at all contact points.

        An actuator that ends before them (`Actuator.force_limit`) presses with less.

        Raises:
            GraspRefineError: they are not known.
        """
        if self.outcome.forces is None:
            raise GraspRefineError("the forces of these squeezes are not known")
        return self.outcome.forces.flat()

    def columns(self) -> dict[str, np.ndarray]:
        """Return one column (N,) per number or name of the grasps, as for `pandas.DataFrame(refined.columns())`.

        They are the columns of `after`, the texts on the refinement (status, change), and all measures, SI units, by
        their names in result files.
        """
        return {**self.after.columns(), **self.outcome.texts(), **self.outcome.entries()}

    def as_problem(self) -> Problem:
        """Return the refined grasps as a problem on the same objects, with their targets, pregrasps and squeezes."""
        after, hand = self.after, self.problem.hand
        groups = []
        for group in self.problem.groups:
            part = self.outcome.select(group.place)
            moved = replace(part.posed(group.scene), direction=None, contact_gap=part.contact_gap)
            grasps = after.select(group.place)
            targets = aim(hand, grasps.targets)
            scene = replace(moved, target_link=targets[0], target_object=targets[1])
            groups.append(replace(group, scene=scene, grasps=grasps))
        return replace(self.problem, files=(), groups=tuple(groups))

    def table(self, *, verbose: bool = False) -> RenderableType:
        """Return the table of `refine-grasp run`, for a console of rich; `verbose` lists all of many grasps."""
        return grasp_table(self.outcome, self.problem.hand.name, self.config, self.simulated, verbose=verbose)

    def save(self, path: str | Path, *, overwrite: bool = False) -> tuple[Path, ...]:
        """Write a result file, or, of grasps on several objects, a folder with one for each; return the paths.

        `refine-grasp validate`, `refine-grasp view` and `load_grasps` read them. A table has the `columns` alone, of
        all objects.

        Args:
            path: The file, .npz; for several objects a folder; or a table, .csv or .parquet.
            overwrite: Whether existing files are replaced.

        Raises:
            GraspRefineError: there are no grasps, a file exists or cannot be written, or has another ending.
        """
        if not len(self.outcome):
            raise GraspRefineError(f"{path}: there are no grasps to save")
        path, names = Path(path), list(dict.fromkeys(self.outcome.object.tolist()))
        if path.suffix.lower() in TABLE_SUFFIXES:
            check_table(path)
            check_writable(path, overwrite=overwrite)
            columns = self.columns()
            rows = zip(*(values.tolist() for values in columns.values()), strict=True)
            save_table(path, [dict(zip(columns, row, strict=True)) for row in rows])
            return (path,)
        one = len(names) == 1
        if one != (path.suffix.lower() == ".npz"):
            tables = " or ".join(TABLE_SUFFIXES)
            results = "of one object end with .npz" if one else f"of {len(names)} objects go into a folder"
            raise GraspRefineError(f"{path}: results {results}; tables end with {tables}")
        paths = {names[0]: path} if one else result_paths(path, self.problem.hand.name, tuple(names))
        check_writable(*paths.values(), overwrite=overwrite, inside=None if one else path)
        if not one:
            path.mkdir(exist_ok=True)
        self.write(paths)
        return tuple(paths.values())

    def export(self, to: str, folder: str | Path) -> tuple[Path, ...]:
        """Write the refined grasps for another program into a new folder, of several objects into one for each.

        Args:
            to: Name of the program or format, one of `export.targets.TARGETS`, such as "mjcf" or "ros2".
            folder: New folder.

        Returns:
            The folders, each with a README.

        Raises:
            GraspRefineError: there is no such target, the folder exists or cannot be written, or the program cannot
                take these grasps.
        """
        from grasp_refine.export.targets import export
        from grasp_refine.problem.exports import exported_grasps

        outcome = self.outcome
        forces = None if outcome.forces is None else outcome.forces.flat()
        entries = outcome.entries()
        values = {
            name.replace("_after", ""): entries[entry] for name, entry in number_entries().items() if entry in entries
        }
        parts = exported_grasps(self.as_problem(), closing="file", forces=forces, values={**outcome.texts(), **values})
        return export(parts, to, folder)

    def write(self, paths: Mapping[str, Path], provenance: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        """Write the result file of each object.

        Args:
            paths: Name of the object -> file.
            provenance: Name of the object -> further entries of the provenance of its file.

        Raises:
            GraspFileError: a file cannot be written.
        """
        problem = self.problem
        source: dict[str, Any] = {"memory": True}
        if problem.files:
            source = fingerprint(problem.files[0])
            # Which grasps were sampled depends on the hand, the object and the seed.
            source = {"sampled": problem.sampled, "hand": source} if problem.sampled else source
        common = {
            "versions": versions(),
            "machine": machine(),
            "seed": self.config.seed,
            "config": {"refine": settings(self.config)},
            "source": source,
            "urdf": fingerprint(problem.hand.urdf),
            TASK: task_entry(problem.task),
        }
        for name, path in paths.items():
            rows = np.flatnonzero(self.outcome.object == name)
            of_object = common | {"objects": object_entries(group for group in problem.groups if group.object == name)}
            of_object |= {} if provenance is None else provenance[name]
            simulated = None if self.simulated is None else self.simulated.select(rows)
            links, outcome = problem.groups[0].scene.links, self.outcome.select(rows)
            save_results(path, problem.hand, links, outcome, of_object, simulated, problem.task)

    def __repr__(self) -> str:
        return f"RefinedGrasps({count_text(len(self), 'grasp')} of {self.problem.hand.name}: {tallied(self.status)})"

    def __str__(self) -> str:
        return text_of(self.table())

    def _repr_html_(self) -> str:
        """Return the table as HTML, for a notebook."""
        return html_of(self.table())

    def _stage(self, name: str) -> Stage:
        at = STAGES.index(name)
        return Stage(self.outcome.stage_pose[:, at], self.outcome.stage_q[:, at])
