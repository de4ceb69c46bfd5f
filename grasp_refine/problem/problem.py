"""Problem: requested grasps with their hand and objects, grouped by object and scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.closing.motion import Motion, closing_motion, motion_of
from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet, Targets
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, UncutObject
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.scene import Scene, links_of

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
    """Numbers of the grasps (N,) among those of their object."""
    place: np.ndarray
    """Positions of the grasps (N,) among all requested ones."""

    def motion(self, source: StageSource = "auto") -> Motion:
        """Return the motion that closes the hand to the grasps.

        Args:
            source: "file": pregrasps and squeezes of the file; "own": our own, which close open hands first; "auto":
                stage by stage, those of the file where it has them.

        Raises:
            GraspFileError: the source is "file", and the file lacks some.
        """
        if source == "own" or (source == "auto" and not self.grasps.other_stages):
            return closing_motion(self.scene)
        complete = source == "file" or (self.grasps.pregrasp is not None and self.grasps.squeeze is not None)
        return motion_of(self.grasps, self.scene.hand, None if complete else closing_motion(self.scene))


@dataclass(frozen=True, eq=False)
class UncutGroup:
    """N grasps on one object at one scale, before the object is cut; the fields are those of `Group`."""

    object: str
    """Name of the object, as `Group.object`."""
    scale: float
    """Factor that takes the object's mesh to metres, as `Group.scale`."""
    uncut: UncutObject
    """The object."""
    file_scale: float
    """Scale of the grasps in their file."""
    rows: np.ndarray
    """Rows of the grasps in their file, as `Group.rows`; empty for grasps to be sampled."""
    index: np.ndarray
    """Numbers of the grasps, as `Group.index`."""
    place: np.ndarray
    """Positions of the grasps, as `Group.place`."""

    @property
    def key(self) -> tuple[str, float]:
        """Name and scale of the object in the grasp file."""
        return self.object, self.file_scale


@dataclass(frozen=True, eq=False)
class Draft:
    """All requested grasps, when everything is read and checked and no object is decomposed yet."""

    hand: Hand
    """The hand, as `Problem.hand`."""
    files: tuple[Path, ...]
    """Input files, as `Problem.files`."""
    names: tuple[str, ...]
    """Name of each grasp's object, in the requested order; one name for grasps to be sampled."""
    aimed: bool
    """Whether links have targets."""
    groups: tuple[UncutGroup, ...]
    """The grasps, by object and scale."""
    finish: Callable[[Sequence[Object]], Problem]
    """Function that returns the problem, given the decomposed objects of the groups."""
    sampled: str = ""
    """Request of sampled grasps, as `Problem.sampled`."""
    environment: Environment | None = None
    """Bodies around the objects, as `Scene.environment`."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Problem of refinement or validation: all requested grasps."""

    hand: Hand
    """The hand, below the base link of the grasp file."""
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

    def closing(self, source: StageSource = "auto") -> dict[str, str]:
        """Return the source of pregrasps and squeezes of `Group.motion`: stage -> "file" or "own"."""
        grasps = self.groups[0].grasps
        given = () if source == "own" else grasps.other_stages
        return {name: "file" if name in given else "own" for name in OTHER_STAGES}

    @property
    def order(self) -> np.ndarray:
        """Rows (N,) that bring the grasps from group after group into the requested order."""
        return np.argsort(np.concatenate([group.place for group in self.groups]))


def recorded_gaps(hand: Hand, grasps: GraspSet) -> np.ndarray | None:
    """Return `contact_gap` of a scene of some grasps; None: no contact links are recorded."""
    return None if grasps.contact_links is None else grasps.contact_links.on(links_of(hand))


def aim(hand: Hand, targets: Targets | None, rows: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return `target_link` and `target_object` of a scene with some rows of a grasp file; None each without targets.

    Raises:
        GraspFileError: a link has no target column.
    """
    if targets is None:
        return None, None
    links = links_of(hand)
    columns = list(links)
    points = np.full((2, len(rows), len(columns), 3), np.nan)
    for k, link in enumerate(targets.links):
        if link not in columns:
            raise GraspFileError(
                f"target link '{link}' is no link with collision geometry of hand '{hand.name}', or is listed more "
                f"often than it has contact points; there are {', '.join(links)}"
            )
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at], points[1, :, at] = targets.point_link[rows, k], targets.point_object[rows, k]
    return points[0], points[1]
