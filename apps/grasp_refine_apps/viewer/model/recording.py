"""Recordings of a hand and an object: frames that are shown one by one, played and filmed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.motion.sweep import Obstruction
from grasp_refine_apps.viewer.model.pose import Pose


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """T frames of a refinement, a simulation or a trajectory, in the frame that the object has in the first of them."""

    title: str
    """Description in a few words, such as "simulation, +x, held"."""
    T_root: Float[np.ndarray, "T 4 4"]
    """Poses of the hand's base link (T, 4, 4), metres."""
    q: Float[np.ndarray, "T n"]
    """Joint values (T, n) in `Hand.joint_names` order."""
    time: Float[np.ndarray, " T"]
    """Time of each frame in seconds (T,)."""
    texts: tuple[str, ...] = ()
    """Description of each frame in one line (T,)."""
    T_object: Float[np.ndarray, "T 4 4"] | None = None
    """Poses of the object (T, 4, 4); None: it stays."""
    T_bodies: Mapping[str, Float[np.ndarray, "T 4 4"]] = field(default_factory=dict)
    """Poses (T, 4, 4) of the movable bodies around the object, by name."""
    lost: Bool[np.ndarray, " T"] | None = None
    """True in frames (T,) from the loss of the object on, or from where something is in the way; None: in none."""
    pushed: Bool[np.ndarray, " T"] | None = None
    """True in frames (T,) in which `force` acts; None: in none."""
    force: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    """Push at the object's centre of mass, or at `pulled`, (3,), newtons."""
    pulled: Float[np.ndarray, " 3"] | None = None
    """Point of the object (3,) that is dragged, object frame; None: none is."""
    contacts: tuple[Float[np.ndarray, "_ 3"], ...] = ()
    """Points where the object touches the hand or the table in each of T frames, (k, 3); empty: not known."""
    obstruction: Obstruction | None = None
    """Obstacle in the way in lost frames; None: there is none."""
    summary: str = ""
    """All of it in one line; empty: the frames say it."""
    travels: bool = False
    """Whether the hand goes somewhere else than to the grasp, so that cameras show both ends."""
    succeeds: bool = True
    """Whether the object is held, or the trajectory is free."""
    live: bool = False
    """Whether it is one frame of a simulation that runs."""
    carries: bool = False
    """Whether the object stays with the hand to the end."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.T_root)

    def pose(self, frame: int) -> Pose:
        """Return the pose of the hand in a frame."""
        return Pose(self.T_root[frame], self.q[frame])

    def object_pose(self, frame: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of the object (4, 4) in a frame."""
        return np.eye(4) if self.T_object is None else self.T_object[frame]

    def text(self, frame: int) -> str:
        """Return the description of a frame in one line."""
        return self.texts[frame]

    def is_lost(self, frame: int) -> bool:
        """Return whether the object is lost in a frame, or something is in the way."""
        return self.lost is not None and bool(self.lost[frame])

    def is_pushed(self, frame: int) -> bool:
        """Return whether a push acts in a frame."""
        return self.pushed is not None and bool(self.pushed[frame])

    def obstruction_at(self, frame: int) -> Obstruction | None:
        """Return the obstacle in the way in a frame; None: nothing yet."""
        return self.obstruction if self.is_lost(frame) else None


def subsample(count: int, limit: int) -> Int[np.ndarray, " k"]:
    """Return at most `limit` of `count` indices from 0, evenly spaced, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, limit)).round().astype(int))
