"""The grasps that a command was asked for, with hand and objects, by object and scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet, Targets
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, UncutObject
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.validation.motion import Motion, closing, motion_of

StageSource = Literal["auto", "file", "own"]
"""Where pregrasps and squeezes come from."""


@dataclass(frozen=True, eq=False)
class Group:
    """N grasps on one object at one scale."""

    object: str
    """Name of the object, as the grasp file says it."""
    scale: float
    """Factor that takes the object's mesh to metres."""
    scene: Scene
    """Hand, object and grasps."""
    grasps: GraspSet
    """The same grasps as the file has them, pregrasps and squeezes too."""
    rows: np.ndarray
    """Rows of the grasps (N,) in their file."""
    index: np.ndarray
    """Numbers of the grasps (N,) among those of their object."""
    place: np.ndarray
    """Where the grasps (N,) stand among all that were asked for."""

    def motion(self, source: StageSource = "auto") -> Motion:
        """How the hand closes to the grasps.

        Args:
            source: Pregrasps and squeezes are those of the file, our own, or, stage by stage, those of the file where
                it has them.

        Raises:
            GraspFileError: they are to be those of the file, which lacks some.
        """
        if source == "own":
            return closing(self.scene)
        whole = source == "file" or (self.grasps.pregrasp is not None and self.grasps.squeeze is not None)
        return motion_of(self.grasps, self.scene.hand, None if whole else closing(self.scene))


@dataclass(frozen=True, eq=False)
class UncutGroup:
    """N grasps on one object at one scale, before the object is cut; the fields are those of `Group`."""

    object: str
    """As `Group.object`."""
    scale: float
    """As `Group.scale`."""
    uncut: UncutObject
    """The object."""
    file_scale: float
    """Scale of the grasps in their file."""
    rows: np.ndarray
    """As `Group.rows`; of grasps to be sampled, none."""
    index: np.ndarray
    """As `Group.index`."""
    place: np.ndarray
    """As `Group.place`."""

    @property
    def key(self) -> tuple[str, float]:
        """Name and scale of the object as the grasp file says them."""
        return self.object, self.file_scale


@dataclass(frozen=True, eq=False)
class Draft:
    """All grasps that were asked for, when everything is read and checked and no object is cut yet."""

    hand: Hand
    """As `Problem.hand`."""
    files: tuple[Path, ...]
    """As `Problem.files`."""
    names: tuple[str, ...]
    """Name of each grasp's object, in the order in which they were asked for; of grasps to be sampled, one."""
    aimed: bool
    """Whether links have targets."""
    groups: tuple[UncutGroup, ...]
    """The grasps, by object and scale."""
    finish: Callable[[Sequence[Object]], Problem]
    """Gives the problem, once the objects of the groups are cut."""
    sampled: str = ""
    """As `Problem.sampled`."""


@dataclass(frozen=True, eq=False)
class Problem:
    """All grasps that were asked for."""

    hand: Hand
    """The hand, below the base link that the grasp file names."""
    files: tuple[Path, ...]
    """The grasp file, or the folder and its files, and the file of the targets if it is another; of sampled grasps, the
    hand's."""
    groups: tuple[Group, ...]
    """The grasps, by object and scale."""
    notes: tuple[str, ...]
    """What a user should know about how hand, objects and grasps were read."""
    sampled: str = ""
    """What was asked for where the grasps were drawn and not read, such as sample:32."""
    convention_notes: tuple[str, ...] = ()
    """Those of `notes` that say that the file most likely means something else than what was read."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return sum(len(group.rows) for group in self.groups)

    def closing(self, source: StageSource = "auto") -> dict[str, str]:
        """Whose pregrasps and squeezes `Group.motion` takes: stage -> "file" or "own"."""
        grasps = self.groups[0].grasps
        return {name: "own" if source == "own" or getattr(grasps, name) is None else "file" for name in OTHER_STAGES}

    @property
    def order(self) -> np.ndarray:
        """Takes the grasps from group after group to the order in which they were asked for."""
        return np.argsort(np.concatenate([group.place for group in self.groups]))


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
                f"target link '{link}' is no link with collision geometry of hand '{hand.name}', or comes more "
                f"often than its contact points; there are {', '.join(links)}"
            )
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at], points[1, :, at] = targets.point_link[rows, k], targets.point_object[rows, k]
    return points[0], points[1]
