"""Sheet of a page: the grasps of a file on one side, or before and after."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.core.short_repr import labels
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.measures import COMPARED, QUALITY, SIDES
from grasp_refine.objects.object import Object
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.results.changed import Changed
from grasp_refine.results.fidelity_lines import fidelity_lines
from grasp_refine.results.verdict import BAR, should_hold
from grasp_refine.validation.trials import Reason, Trials
from grasp_refine.validation.validate import Validated
from grasp_refine_apps.batch.headline import Tile, Verdict, headline_tiles
from grasp_refine_apps.batch.histogram import Histogram
from grasp_refine_apps.batch.pictures import Picture
from grasp_refine_apps.batch.thumbnail import thumbnail
from grasp_refine_apps.batch.worst import Case
from grasp_refine_apps.report.skeleton import Skeleton

MAX_CARDS = 48
"""Largest number of grasps with a card; of more, the worst ones have one."""


@dataclass(frozen=True, eq=False)
class Side:
    """N grasps at their poses."""

    hand: Hand
    """The hand."""
    T_world_root: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of its base link, world frame."""
    q: Float[np.ndarray, "N n"]
    """Joint values (N, n)."""

    @classmethod
    def of(cls, problem: Problem) -> Side:
        """Return the grasps of a problem, in the requested order."""
        scenes, order = [group.scene for group in problem.groups], problem.order
        T, q = (np.concatenate([getattr(each, name) for each in scenes])[order] for name in ("T_world_root", "q"))
        return cls(problem.hand, T, q)


@dataclass(frozen=True, eq=False)
class Sheet:
    """N grasps on S sides: one, or before and after."""

    title: str
    """Name for people; empty where the page has one sheet."""
    problem: Problem
    """Hand and objects."""
    sides: tuple[Side, ...]
    """The grasps on each side (S)."""
    files: tuple[Path, ...]
    """File of each grasp (N)."""
    rows: tuple[int, ...]
    """Number of each grasp (N) in its file, among those on its object."""
    measures: Mapping[str, Float[np.ndarray, "S N"]]
    """Name of a measure of `COMPARED` -> its values (S, N), SI units."""
    held: Bool[np.ndarray, "S N"] | None
    """True where a grasp held in simulation (S, N); None: not simulated."""
    trials: Trials | None
    """Trials of the last side; None: not simulated."""
    words: tuple[str, ...]
    """Text on each grasp (N)."""
    lines: tuple[str, ...] = ()
    """Lines above the cards."""

    @classmethod
    def of_refined(cls, refined: RefinedGrasps, paths: Mapping[str, Path]) -> Sheet:
        """Return the sheet of a refinement, whose results are in files: name of the object -> path."""
        outcome, simulated, problem = refined.outcome, refined.simulated, refined.problem
        names, rows = outcome.object.tolist(), np.zeros(len(outcome), dtype=np.int64)
        for name in paths:
            at = outcome.object == name
            rows[at] = np.arange(at.sum())
        changed = np.where(outcome.fidelity == "", outcome.change, outcome.fidelity)
        lines = fidelity_lines(outcome) or Changed.of(outcome, refined.config.confidence).lines()
        poses = (outcome.hand_pose_before, outcome.q_before), (outcome.hand_pose, outcome.q)
        return cls(
            "",
            problem,
            tuple(Side(problem.hand, transform_from_pose(pose), q) for pose, q in poses),
            tuple(paths[name] for name in names),
            tuple(rows.tolist()),
            {one.name: outcome[one.name].T for one in COMPARED if one.name in outcome.measures},
            None if simulated is None else simulated.held.T,
            None if simulated is None else simulated.after,
            tuple(
                f"{status}, {change}".removesuffix(", ") for status, change in zip(refined.status, changed, strict=True)
            ),
            tuple(line.plain.strip() for line in lines),
        )

    @classmethod
    def of_validated(cls, title: str, files: Sequence[tuple[Path, Problem, Validated]]) -> Sheet:
        """Return the sheet of a validated file, or of two files with the same grasps."""
        path, problem, last = files[-1]
        known = [one.name for one in COMPARED if all(one.name in found.metrics.values for *_, found in files)]
        return cls(
            title,
            problem,
            tuple(Side.of(each) for _, each, _ in files),
            (path,) * len(last),
            tuple(last.index.tolist()),
            {name: np.stack([found.metrics.values[name] for *_, found in files]) for name in known},
            None if last.trials is None else np.stack([found.success for *_, found in files]),
            last.trials,
            ("",) * len(last),
        )

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.rows)

    def tiles(self) -> list[Tile]:
        """Return the tiles: the largest change, and the verdicts."""
        good = tuple(int(should_hold(values).sum()) for values in self.measures[QUALITY.name])
        verdicts = [Verdict(f"quality {BAR} (an estimate)", good, len(self))]
        if self.held is not None:
            verdicts.insert(0, Verdict("held in simulation", tuple(self.held.sum(axis=1).tolist()), len(self)))
        distributions, medians = dict[str, Histogram](), dict[str, float]()
        for measure in COMPARED:
            for side, values in zip(SIDES, self.measures.get(measure.name, ()), strict=False):
                entry, known = measure.entries[side], values[np.isfinite(values)]
                distributions[entry] = Histogram.of(measure.unit)
                distributions[entry].add(known)
                medians[entry] = float(np.median(known)) if len(known) else nan
        return headline_tiles(verdicts, distributions, medians)

    def pictures(self, folder: Path, look: tuple[str, ...]) -> Iterator[Picture]:
        """Draw the grasps, of more than `MAX_CARDS` the worst.

        Args:
            folder: Folder of the page, from which links to files begin.
            look: Options of `refine-grasp view`, beside file and row, to show a grasp.
        """
        groups = {int(place): group for group in self.problem.groups for place in group.place}
        cases = [self._case(i, groups[i], folder, look) for i in range(len(self))]
        shown = list(range(len(self)))
        if len(self) > MAX_CARDS:
            shown = sorted(shown, key=lambda i: cases[i].badness, reverse=True)[:MAX_CARDS]
        skeleton = Skeleton.of(self.problem.hand, visual=True)
        for i in shown:
            try:
                drawn = self._drawn(i, groups[i].scene.object, skeleton)
                yield Picture(cases[i], drawn[0] if len(drawn) > 1 else b"", drawn[-1])
            # A fault of one grasp costs its picture, not the page.
            except (GraspRefineError, ValueError) as error:
                yield Picture(cases[i], problem=f"not drawn: {' '.join(str(error).split())}")

    def _drawn(self, i: int, obj: Object, skeleton: Skeleton) -> list[bytes]:
        """Return the pictures of a grasp on all sides.

        Raises:
            GraspRefineError: the sides are of different hands.
            ValueError: a pose is not finite.
        """
        if len({side.hand.joint_names for side in self.sides}) > 1:
            raise GraspRefineError("the files are of different hands")
        T, q = (np.stack([getattr(side, name)[i] for side in self.sides]) for name in ("T_world_root", "q"))
        return thumbnail(skeleton, obj, T, q)

    def _case(self, i: int, group: Group, folder: Path, look: tuple[str, ...]) -> Case:
        """Return the facts about a grasp."""
        held = None if self.held is None else bool(self.held[-1, i])
        reason = "" if self.trials is None or held else str(labels(Reason, self.trials.outcome[[i]])[0])
        sides = [] if self.held is None else ["yes" if each else "no" for each in self.held[:, i]]
        both = f"held: {' → '.join(sides)}" if len(sides) > 1 else ""
        nothing = (nan,) * len(self.sides)
        measures = {one.name: self.measures.get(one.name) for one in COMPARED}
        several = {each.object for each in self.problem.groups} > {group.object} and len(set(self.files)) == 1
        return Case(
            shard=0,
            file=Path(os.path.relpath(self.files[i], folder)),
            row=self.rows[i],
            hand=self.problem.hand.name,
            object=group.object,
            scale=group.scale,
            source="",
            source_row=None,
            status=" · ".join(filter(None, (self.words[i], both))),
            measures={
                name: nothing if known is None else tuple(known[:, i].tolist()) for name, known in measures.items()
            },
            held=held,
            reason=reason,
            look=(*look, *(("--object-name", group.object) if several else ())),
        )
