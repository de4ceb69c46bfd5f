"""Problem: requested grasps with their hand and objects, grouped by object and scale."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.closing.motion import Motion, closing_motion, motion_of
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet, Targets
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import as_task
from grasp_refine.transfers.key_points import KeyPoints

StageSource = Literal["auto", "file", "own"]
"""Source of pregrasps and squeezes."""


@dataclass(frozen=True, eq=False)
class Group:
    """N grasps on one object at one scale."""

    object: str
    """Name of the object in the grasp file."""
    scale: float
    """Factor that takes the object's mesh to metres."""
    scene: Scene
    """Hand, object and grasps."""
    grasps: GraspSet
    """The grasps as in their file, with pregrasps and squeezes."""
    rows: np.ndarray
    """Rows of the grasps (N,) in their file."""
    index: np.ndarray
    """Numbers of the grasps (N,) within their object."""
    place: np.ndarray
    """Positions of the grasps (N,) among all requested ones."""
    source: Scene | KeyPoints | None = None
    """Grasps of another hand that these are to be transferred from; until then there are as many placeholders."""

    @property
    def key(self) -> tuple[str, float]:
        """Name and scale of the object in the grasp file."""
        return self.object, float(self.grasps.scale[0]) if len(self.grasps) else self.scale

    def select(self, rows: np.ndarray) -> Group:
        """Return the grasps `rows` of the group, in that order."""
        parts = {name: getattr(self, name)[rows] for name in ("rows", "index", "place")}
        return replace(self, scene=self.scene.select(rows), grasps=self.grasps.select(rows), **parts)

    def on(self, obj: Object) -> Group:
        """Return the grasps on another object."""
        return replace(self, scene=replace(self.scene, object=obj))

    def motion(self, source: StageSource = "auto") -> Motion:
        """Return the motion that closes the hand to the grasps.

        Args:
            source: "file": pregrasps and squeezes of the file; "own": our own, which close open hands first; "auto":
                stage by stage, the file's where it has them.

        Raises:
            GraspFileError: the source is "file", and the file lacks some.
        """
        if source == "own" or (source == "auto" and not self.grasps.other_stages):
            return closing_motion(self.scene)
        complete = source == "file" or (self.grasps.pregrasp is not None and self.grasps.squeeze is not None)
        return motion_of(self.grasps, self.scene.hand, None if complete else closing_motion(self.scene))


@dataclass(frozen=True, eq=False)
class Problem:
    """Problem of refinement or validation: all requested grasps.

    Until its objects are decomposed, grasps of a hand on an arm are grasps of the hand alone, and grasps to be sampled
    are none.
    """

    hand: Hand
    """The hand, below the base link of the grasp file, on its arm where there is one."""
    files: tuple[Path, ...]
    """Grasp file, or the folder and its files, and the file of the targets if it is another; for sampled grasps, the
    file of the hand."""
    groups: tuple[Group, ...]
    """The grasps, by object and scale."""
    notes: tuple[str, ...]
    """Notes for the user on hand, objects and grasps as they were read."""
    sampled: str = ""
    """Request of sampled grasps, such as sample:32; empty for grasps of a file."""
    convention_notes: tuple[str, ...] = ()
    """Notes, also in `notes`, that suspect another convention in the file than the one that was read."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return sum(len(group.rows) for group in self.groups)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each grasp's object, in the requested order."""
        each = [name for group in self.groups for name in [group.object] * len(group.rows)]
        return tuple(each[row] for row in self.order.tolist())

    @property
    def aimed(self) -> bool:
        """Whether links have targets."""
        return any(group.scene.target_link is not None for group in self.groups)

    @property
    def task(self) -> Task:
        """Task of the grasps, with the regions of the first object."""
        return next((group.scene.task for group in self.groups), Task())

    def for_task(self, task: Task | str | Path | None) -> Problem:
        """Return the problem for another task, which counts where it names something.

        Raises:
            GraspRefineError: there is no such task, or it has another base: the grasps stand on theirs already.
        """
        task = as_task(task)
        if task == Task():
            return self
        if task.base is not None:
            raise GraspRefineError("a problem has the base of its arm: give `base` where it is loaded")
        groups = [replace(g, scene=replace(g.scene, task=task.over(g.scene.task))) for g in self.groups]
        return replace(self, groups=tuple(groups))

    def closing(self, source: StageSource = "auto") -> dict[str, str]:
        """Return the source of pregrasps and squeezes of `Group.motion`: stage -> "file" or "own"."""
        grasps = self.groups[0].grasps
        stages = () if source == "own" else grasps.other_stages
        return {name: "file" if name in stages else "own" for name in OTHER_STAGES}

    @property
    def order(self) -> np.ndarray:
        """Rows (N,) that bring the grasps from group after group into the requested order."""
        return np.argsort(np.concatenate([group.place for group in self.groups]))


def scene_of(
    hand: Hand,
    obj: Object,
    grasps: GraspSet,
    q: Float[np.ndarray, "N n"],
    task: Task,
) -> Scene:
    """Return the scene of grasps of one object, with the targets and contact links of their file.

    Args:
        hand: The hand.
        obj: The object.
        grasps: The grasps.
        q: Their joint values (N, n) in the order of `hand.joint_names`.
        task: What they must do, and where.

    Raises:
        GraspFileError: a link with targets is none of the hand.
    """
    return Scene(
        hand,
        obj,
        transform_from_pose(grasps.hand_pose),
        q,
        *aim(hand, grasps.targets),
        contact_gap=None if grasps.contact_links is None else grasps.contact_links.on(links_of(hand)),
        task=task,
    )


def aim(hand: Hand, targets: Targets | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return `target_link` and `target_object` of a scene of grasps with targets; None each without targets.

    Raises:
        GraspFileError: a link has no target column.
    """
    if targets is None:
        return None, None
    links = links_of(hand)
    columns = list(links)
    points = np.full((2, len(targets.point_link), len(columns), 3), np.nan)
    for k, link in enumerate(targets.links):
        if link not in columns:
            raise GraspFileError(
                f"target link '{link}' is no link with collision geometry of hand '{hand.name}', or is listed more "
                f"often than it has contact points; there are {', '.join(links)}"
            )
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at], points[1, :, at] = targets.point_link[:, k], targets.point_object[:, k]
    return points[0], points[1]
