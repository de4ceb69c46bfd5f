"""State of the viewer as one frozen value: the controller makes new ones, the view draws them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.pose import Pose, Target
from grasp_refine_apps.viewer.trace import Trace

if TYPE_CHECKING:
    from grasp_refine_apps.viewer.shown_motion import ShownMotion
    from grasp_refine_apps.viewer.validated import TrialResult

JobKind = Literal["load", "measure", "targets", "refine", "validate", "replay", "export"]
Gizmo = Literal["none", "hand", "object"]


@dataclass(frozen=True)
class Job:
    """Long job of the worker."""

    kind: JobKind
    """Kind of the job."""
    what: str
    """Description of the job for users."""
    share: float | None = None
    """Completed share, 0 to 1; None: unknown."""
    paused: bool = False
    """Whether it waits for the user."""


@dataclass(frozen=True)
class Notice:
    """Message that the user is shown once."""

    number: int
    """Running number, so that the same text can be shown twice."""
    text: str
    """Text of the message."""
    bad: bool = False
    """Whether something went wrong."""


@dataclass(frozen=True)
class DisplayOptions:
    """Display options of the scene."""

    hand: Literal["visual", "collision"] = "visual"
    """Its visual meshes, or the convex pieces that collide."""
    object: Literal["mesh", "pieces", "wireframe"] = "mesh"
    """Its surface, its convex pieces in colours, or its edges."""
    transparent: bool = True
    """See through the object, to contacts behind it."""
    input_hand: bool = True
    """A pale copy of the hand before refinement."""
    contacts: bool = True
    """Points where links and object are nearest or deepest, and lines between them."""
    forces: bool = False
    """The contact forces that balance best, and friction cones."""
    frames: bool = False
    """Axes of the base link and of the object: x red, y green, z blue."""
    table: bool = True
    """The table, where there is one."""


@dataclass(frozen=True, eq=False)
class EditSnapshot:
    """Snapshot of what a user can edit."""

    pose: Pose
    """Pose of the hand, object frame."""
    targets: tuple[Target, ...]
    """Target points of links on the object."""
    T_world_object: Float[np.ndarray, "4 4"]
    """Pose of the object (4, 4), world frame."""


@dataclass(frozen=True, eq=False)
class State:
    """State of the viewer: the open grasps, and all that is shown of one of them."""

    collection: Collection
    """Open grasps."""
    number: int
    """Number of the shown grasp."""
    scene: Scene
    """Hand, object and table, and this grasp alone as in its file."""
    initial: Pose
    """Pose of the hand in the input grasp, before any refinement."""
    pose: Pose
    """Present pose of the hand: as in the file, edited, or refined."""
    settings: Any
    """Options of refinement: a dataclass with `config` for a `Config`, and `unused` for unused fields."""
    targets: tuple[Target, ...] = ()
    """Target points of links on the object; empty: links touch anywhere."""
    T_world_object: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose of the object (4, 4), world frame; all else is in the object's frame and moves with it."""
    trace: Trace | None = None
    """The iterations of the last refinement."""
    frame: int | None = None
    """Number of the shown iteration; None: `pose` is shown."""
    outcome: Outcome | None = None
    """Outcome of the last refinement that ended, one row."""
    job: Job | None = None
    """Running job."""
    gizmo: Gizmo = "none"
    """Body that can be dragged."""
    picking: bool = False
    """Whether clicks on links and on the object set targets."""
    picked: tuple[str, Float[np.ndarray, " 3"]] | None = None
    """Clicked link, and the point on it (3,), link frame, until a point on the object is clicked."""
    trial: TrialResult | None = None
    """Simulation result of the grasp."""
    motion: ShownMotion | None = None
    """Shown simulation."""
    motion_frame: int = 0
    """Number of its shown frame."""
    display: DisplayOptions = DisplayOptions()
    """Display options of the scene."""
    side_by_side: bool = False
    """Whether the input grasp is drawn beside, with its own object."""
    undo_steps: tuple[EditSnapshot, ...] = ()
    """Snapshots before the edits that can be undone, the last one last."""
    redo_steps: tuple[EditSnapshot, ...] = ()
    """Snapshots that were undone, the last one last."""
    notice: Notice | None = None
    """Last message to the user."""
    change: int = 0
    """Running number of the state."""

    @property
    def shown(self) -> Pose:
        """Drawn pose of the hand, in the object's frame; in a simulation, in that of the object at its start."""
        if self.motion is not None:
            return self.motion.pose(self.motion_frame)
        if self.frame is not None and self.trace is not None:
            return self.trace.pose(min(self.frame, len(self.trace) - 1))
        return self.pose

    @property
    def standing(self) -> Pose:
        """Pose of the hand for the next command: as shown, except in a simulation, which is only displayed."""
        return self.pose if self.motion is not None else self.shown

    @property
    def snapshot(self) -> EditSnapshot:
        """Snapshot of what a user can edit."""
        return EditSnapshot(self.standing, self.targets, self.T_world_object)

    @property
    def T_shown_object(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the object (4, 4) in the frame of `shown`: it moves in simulations only."""
        return np.eye(4) if self.motion is None else self.motion.T_object[self.motion_frame]
