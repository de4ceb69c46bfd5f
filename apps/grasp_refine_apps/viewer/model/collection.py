"""Grasps open in the viewer, of one hand on one or several objects, with their measures and marks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Bool, Float, Int, Shaped
from grasp_refine.core.se3 import tangents, transform_from_pose
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.model.columns import (
    FAILED_TEXT,
    HELD,
    HELD_TEXT,
    OF_REFINEMENT,
    REASON,
    VERDICTS,
    Column,
    numeric_columns,
)
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.marks import Mark, Marks, marks_path
from grasp_refine_apps.viewer.model.names import shortened
from grasp_refine_apps.viewer.model.pose import Pose, targets_of
from grasp_refine_apps.viewer.model.recorded import read_records
from grasp_refine_apps.viewer.model.validated import TrialResult
from grasp_refine_apps.viewer.model.work import Work


@dataclass(frozen=True, eq=False)
class Collection:
    """N grasps, numbered in the requested order."""

    problem: Problem
    """The grasps, by object and scale."""
    group_of: Int[np.ndarray, " N"]
    """Number of each grasp's group (N,)."""
    member: Int[np.ndarray, " N"]
    """Row of each grasp in its group (N,)."""
    files: tuple[Path, ...]
    """Files of the grasps: one, or a folder's; empty if they were sampled."""
    file_of: Int[np.ndarray, " N"]
    """Number of each grasp's file in `files` (N,)."""
    row: Int[np.ndarray, " N"]
    """Row of each grasp in its file (N,)."""
    T_initial: Float[np.ndarray, "N 4 4"]
    """Poses of the base link before refinement (N, 4, 4), object frame; the present pose where none is recorded."""
    q_initial: Float[np.ndarray, "N n"]
    """Joint values before refinement (N, n)."""
    columns: Mapping[str, Column]
    """Measures of the grasps: key -> column."""
    marks: tuple[Marks, ...]
    """User marks of the grasps of each of `files`; without files, one entry for all grasps."""
    stand_ins: frozenset[str] = frozenset()
    """Names of the objects whose meshes are not known: their grasps are shown on another object."""
    trials: Mapping[int, TrialResult] = field(default_factory=dict)
    """Simulation results of the grasps as in their file, by number, where known."""
    asked: tuple[Protocol | None, ...] | None = None
    """Protocols of the groups' tasks as they were opened, once another one is chosen; None: they are as opened."""

    @staticmethod
    def of(problem: Problem, stand_ins: frozenset[str] = frozenset()) -> Collection:
        """Return the grasps of a problem, with recorded measures and marks; `stand_ins` as the field.

        Raises:
            GraspFileError: a result file, or the file of marks beside it, is damaged.
        """
        groups, order = problem.groups, problem.order
        group_of = np.repeat(np.arange(len(groups)), [len(group.rows) for group in groups])[order]
        member = np.concatenate([np.arange(len(group.rows)) for group in groups])[order]
        rows = np.concatenate([group.rows for group in groups])[order]
        T = np.concatenate([group.scene.T_world_root for group in groups])[order]
        q = np.concatenate([group.scene.q for group in groups])[order]
        found = read_records(problem)
        first = problem.files[:1] if not problem.sampled else ()
        files, file_of, row = first, np.zeros(len(problem), dtype=int), rows
        columns: dict[str, Column] = {}
        if found is not None:
            files, file_of, row = found.files, found.file[rows], found.row[rows]
            refined = ~np.isnan(found.q[rows]).any(axis=1) & ~np.isnan(found.T[rows]).any(axis=(1, 2))
            T = np.where(refined[:, None, None], found.T[rows], T)
            q = np.where(refined[:, None], found.q[rows], q)
            columns = {
                column.key: column.with_values(found.columns[column.key][rows])
                for column in (*numeric_columns(), *OF_REFINEMENT, *VERDICTS)
            }
            columns = {key: column for key, column in columns.items() if column.known.any()}
        marks = tuple(Marks.read(marks_path(path)) for path in files) or (Marks(None),)
        return Collection(problem, group_of, member, files, file_of, row, T, q, columns, marks, stand_ins)

    @staticmethod
    def of_refined(refined: RefinedGrasps) -> Collection:
        """Return refined grasps with what they were before, their measures and texts, as of their result file."""
        collection, outcome = Collection.of(refined.as_problem()), refined.outcome
        T, q = transform_from_pose(outcome.hand_pose_before), outcome.q_before
        known = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(q).all(axis=1)
        recorded = {**outcome.entries(), **outcome.texts()}
        every = (*numeric_columns(), *OF_REFINEMENT)
        columns = [one.with_values(recorded[one.key]) for one in every if one.key in recorded]
        return replace(
            collection,
            T_initial=np.where(known[:, None, None], T, collection.T_initial),
            q_initial=np.where(known[:, None], q, collection.q_initial),
            columns={column.key: column for column in columns if column.known.any()},
        )

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.row)

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.problem.hand

    @property
    def objects(self) -> Shaped[np.ndarray, " N"]:
        """The name of each grasp's object (N,)."""
        return np.array([group.object for group in self.problem.groups])[self.group_of]

    @cached_property
    def posed(self) -> Bool[np.ndarray, " N"]:
        """True for the grasps (N,) that can be drawn as in their file."""
        return posed_in(self.problem)

    @property
    def first(self) -> int:
        """Number of the first grasp that can be drawn; 0 if none can."""
        return int(self.posed.argmax())

    def undrawn(self, number: int) -> str:
        """Return why a grasp as in its file cannot be drawn; empty if it can."""
        if self.posed[number]:
            return ""
        group, row = self.group(number), self.member[number]
        scene = group.scene
        status = Status.INVALID if scene.finite[row] else Status.NOT_FINITE
        status = Status.OUT_OF_REACH if scene.out_of_reach[row] else status
        # Notes on arms say by how much.
        for name in (self.name(number), group.index[row]):
            for note in self.problem.notes:
                if note.startswith(f"grasp {name} {status.label}: "):
                    return note.removeprefix(f"grasp {name} ")
        return f"{status.label}: {status.advice}"

    def find(self, text: str) -> int | None:
        """Return the number of the grasp that a link names, "mug 3" or its number; None: there is none."""
        if text.isascii() and text.isdigit():
            return int(text[:9]) if int(text[:9]) < len(self) else None
        name, _, index = text.rpartition(" ")
        named = np.flatnonzero(self.objects == name)
        return next((n for n in named.tolist() if str(self.group(n).index[self.member[n]]) == index), None)

    @property
    def rough(self) -> Mapping[int, Object]:
        """Number of a group whose object is only a convex hull yet -> the object, whose decomposition takes long."""
        objects = [group.scene.object for group in self.problem.groups]
        return {at: obj.whole for at, obj in enumerate(objects) if obj.whole is not None}

    def same_grasps(self, other: Collection) -> bool:
        """Return whether another collection has the same grasps, perhaps with more known of them."""
        return self.row is other.row

    def with_object(self, at: int, obj: Object) -> Collection:
        """Return the collection with the object of group `at`, which is decomposed now."""
        problem = self.problem
        groups = (*problem.groups[:at], problem.groups[at].on(obj), *problem.groups[at + 1 :])
        return replace(self, problem=replace(problem, groups=groups))

    def with_regions(self, at: int, regions: ContactRegions) -> Collection:
        """Return the collection with other regions of the object of group `at`."""
        problem, group = self.problem, self.problem.groups[at]
        scene = replace(group.scene, task=replace(group.scene.task, touch=regions.touch, avoid=regions.avoid))
        groups = (*problem.groups[:at], replace(group, scene=scene), *problem.groups[at + 1 :])
        return replace(self, problem=replace(problem, groups=groups))

    def with_protocol(self, protocol: Protocol | None) -> Collection:
        """Return the collection with tasks of another protocol; None: of those as opened."""
        problem = self.problem
        opened = self.asked or tuple(_protocol(group) for group in problem.groups)
        groups = tuple(
            replace(group, scene=replace(group.scene, task=replace(group.scene.task, protocol=protocol or own)))
            for group, own in zip(problem.groups, opened, strict=True)
        )
        return replace(self, problem=replace(problem, groups=groups), asked=None if protocol is None else opened)

    @property
    def title(self) -> str:
        """Hand, objects and source for users, in one line."""
        objects = list(dict.fromkeys(group.object for group in self.problem.groups))
        named = shortened(objects[0]) if len(objects) == 1 else f"{len(objects)} objects"
        # Grasps made in Python come from no file.
        source = self.problem.sampled or ", ".join(path.name for path in self.problem.files[:1])
        return f"{self.hand.name} on {named}{f', {source}' if source else ''}"

    def group(self, number: int) -> Group:
        """The group of a grasp."""
        return self.problem.groups[self.group_of[number]]

    def label(self, number: int) -> str:
        """Label of a grasp for users, such as "mug 3"; hashes are cut to their beginnings."""
        return shortened(self.name(number))

    def name(self, number: int) -> str:
        """Name of a grasp, such as "mug 3": its object, and its number within the object."""
        group = self.group(number)
        return f"{group.object} {group.index[self.member[number]]}"

    def scene(self, number: int) -> Scene:
        """Scene of this grasp alone, as in its file, with its targets and the table."""
        scene, rows = self.group(number).scene, self.member[number : number + 1]
        return replace(
            scene,
            T_world_root=scene.T_world_root[rows],
            q=scene.q[rows],
            target_link=take(scene.target_link, rows),
            target_object=take(scene.target_object, rows),
            direction=take(scene.direction, rows),
            contact_gap=take(scene.contact_gap, rows),
        )

    def initial(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) of the base link in the object's frame and joint values (n,) of a grasp before refinement."""
        return self.T_initial[number], self.q_initial[number]

    def pose(self, number: int) -> Pose:
        """Pose of the hand in a grasp as in its file."""
        scene, row = self.group(number).scene, self.member[number]
        return Pose(scene.T_world_root[row], scene.q[row])

    def work(self, number: int) -> Work:
        """Return a grasp as in its file, with its simulation result if that is known."""
        targets, pose = targets_of(self.scene(number)), self.pose(number)
        T = self.T_world_object(number)
        return Work(pose, targets, T, counted=self.recorded(number), trial=self.trials.get(number), of_file=pose)

    def recorded(self, number: int) -> Counted | None:
        """Return the contact links that are recorded with a grasp in its file; None: none are."""
        gap = self.group(number).scene.contact_gap
        gap = None if gap is None else gap[self.member[number]]
        return None if gap is None or np.isnan(gap).all() else Counted(gap)

    def T_world_object(self, number: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose (4, 4) in which the object is shown at first: up in a scene, or on a table, is up there."""
        T, scene = np.eye(4), self.group(number).scene
        if scene.environment is not None:
            T[:3, :3] = scene.environment.T_world_object[:3, :3]
        elif scene.table is not None:
            normal = np.array(scene.table.normal)
            T[:3, :3] = np.column_stack([tangents(normal), normal]).T
        return T

    def with_columns(self, *columns: Column) -> Collection:
        """Return the collection with additional or replaced columns."""
        return replace(self, columns={**self.columns, **{column.key: column for column in columns}})

    def mark(self, number: int) -> Mark:
        """Mark of a grasp."""
        return self.marks[self.file_of[number]].of(int(self.row[number]))

    def with_mark(self, number: int, mark: Mark) -> Collection:
        """Return the collection with one grasp marked; nothing is written, see `save_marks`."""
        at, group = self.file_of[number], self.group(number)
        index = int(group.index[self.member[number]])
        marks = self.marks[at].with_mark(int(self.row[number]), mark, object=group.object, index=index)
        return replace(self, marks=(*self.marks[:at], marks, *self.marks[at + 1 :]))

    def save_marks(self, number: int) -> None:
        """Write the marks of a grasp's file beside that file.

        Raises:
            GraspFileError: they cannot be written there; they stay in memory.
        """
        self.marks[self.file_of[number]].save()

    def with_trials(self, changes: Mapping[int, TrialResult | None]) -> Collection:
        """Return the collection with simulation results of some grasps, by number, and columns of them; None: none."""
        if not changes:
            return self
        trials = {number: trial for number, trial in {**self.trials, **changes}.items() if trial is not None}
        verdict, reason = np.full((2, len(self)), "", dtype=object)
        for number, trial in trials.items():
            verdict[number] = HELD_TEXT if trial.held else FAILED_TEXT
            if not trial.held:
                lost = (one.reason for one in trial.results if not one.held)
                reason[number] = next(lost, Reason.OFF_CENTRE).label
        columns = (HELD.with_values(verdict.astype(str)), REASON.with_values(reason.astype(str)))
        known = trials or HELD.key in self.columns
        return replace(self.with_columns(*columns), trials=trials) if known else self


def posed_in(problem: Problem) -> Bool[np.ndarray, " N"]:
    """Return a mask (N,) of the grasps of a problem that can be drawn, in the requested order."""
    return np.concatenate([group.scene.posed for group in problem.groups])[problem.order]


def _protocol(group: Group) -> Protocol | None:
    """Protocol of the task of a group; None: the default one."""
    protocol = group.scene.task.protocol
    return protocol if isinstance(protocol, Protocol) else None
