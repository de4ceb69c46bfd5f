"""What the viewer shows, as one frozen value: the controller makes a new one of it, the view draws it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.target import Target
from grasp_refine_apps.viewer.trace import Trace

if TYPE_CHECKING:
    from grasp_refine_apps.viewer.shown_motion import ShownMotion
    from grasp_refine_apps.viewer.validated import TrialResult

JobKind = Literal["load", "measure", "aim", "refine", "prove", "replay", "export"]
Gizmo = Literal["none", "hand", "object"]


@dataclass(frozen=True)
class Job:
    """Something that takes long."""

    kind: JobKind
    """What it is for."""
    what: str
    """What is being done, for people."""
    share: float | None = None
    """How much is done, 0 to 1; None: unknown."""
    paused: bool = False
    """Whether it waits for the user."""


@dataclass(frozen=True)
class Notice:
    """Something that the user is told once."""

    number: int
    """Counts up, so that the same words can be told twice."""
    text: str
    """The words."""
    bad: bool = False
    """Whether something went wrong."""


@dataclass(frozen=True)
class Showing:
    """What of the scene is seen."""

    hand: Literal["visual", "collision"] = "visual"
    """Which shapes of the hand: what its maker drew, or the convex pieces that can touch."""
    object: Literal["mesh", "pieces", "wireframe"] = "mesh"
    """Which shapes of the object."""
    transparent: bool = True
    """Whether one can see through the object, to contacts behind it."""
    ghost: bool = True
    """Whether the hand as it came is seen, too."""
    contacts: bool = True
    """Witness points, their lines, targets and penetration."""
    forces: bool = False
    """Contact forces and friction cones."""
    frames: bool = False
    """Frames of the base link and of the object."""
    table: bool = True
    """The table, if there is one."""


@dataclass(frozen=True, eq=False)
class State:
    """All that is shown of one grasp of what is open."""

    collection: Collection
    """What is open."""
    number: int
    """Which grasp of it is shown."""
    scene: Scene
    """Hand, object and table, and this grasp alone as the file has it."""
    initial: Pose
    """The hand as it came, before any refinement."""
    pose: Pose
    """Where the hand is now: as the file has it, steered, or refined."""
    settings: Any
    """The options of refinement: a dataclass whose `config(nearest=...)` makes a `Config`, or raises."""
    targets: tuple[Target, ...] = ()
    """Where links should touch; empty: anywhere."""
    T_world_object: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Where the object is drawn (4, 4); all else is told in the object's frame and goes with it."""
    trace: Trace | None = None
    """The iterations of the last refinement."""
    frame: int | None = None
    """Which of them is looked at; None: `pose`."""
    outcome: Outcome | None = None
    """What the last refinement that ended came to, one row."""
    job: Job | None = None
    """What is being done."""
    gizmo: Gizmo = "none"
    """What can be dragged."""
    picking: bool = False
    """Whether clicks on links and on the object set targets."""
    picked: tuple[str, Float[np.ndarray, " 3"]] | None = None
    """A link that was clicked, and the point on it (3,) in its frame; it waits for a point on the object."""
    trial: TrialResult | None = None
    """What simulation said of the grasp."""
    trials_by_grasp: Mapping[int, TrialResult] = field(default_factory=dict)
    """What it said of the grasps of the collection as their file has them, by number, where a document tells."""
    motion: ShownMotion | None = None
    """The simulation that is looked at."""
    motion_frame: int = 0
    """Which frame of it."""
    showing: Showing = Showing()
    """What of the scene is seen."""
    side_by_side: bool = False
    """Whether the grasp as it came is drawn beside, with an object of its own."""
    can_undo: bool = False
    """Whether there is something to undo."""
    can_redo: bool = False
    """Whether there is something to do again."""
    notice: Notice | None = None
    """What the user was told last."""
    change: int = 0
    """Counts the states."""

    @property
    def shown(self) -> Pose:
        """Where the hand is drawn, in the object's frame; in a simulation, in that of the object at its start."""
        if self.motion is not None:
            return self.motion.pose(self.motion_frame)
        if self.frame is not None and self.trace is not None:
            return self.trace.pose(min(self.frame, len(self.trace) - 1))
        return self.pose

    @property
    def standing(self) -> Pose:
        """Where the hand is for whatever is done next: as shown, but for a simulation, which is only looked at."""
        return self.pose if self.motion is not None else self.shown

    @property
    def T_shown_object(self) -> Float[np.ndarray, "4 4"]:
        """Where the object is (4, 4) in that frame: it moves in simulations only."""
        return np.eye(4) if self.motion is None else self.motion.T_object[self.motion_frame]
