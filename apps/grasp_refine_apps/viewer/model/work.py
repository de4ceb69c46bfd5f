"""Current state of one grasp with its results: kept for every grasp while its file is open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.objects.region import ContactRegions
from grasp_refine.refinement.config import Config
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.pose import Pose, Target
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.model.validated import TrialResult


@dataclass(frozen=True, eq=False)
class Work:
    """One grasp as it is now: as in its file, or edited, refined and tested."""

    pose: Pose
    """Pose of the hand: as in the file, edited, or refined."""
    targets: tuple[Target, ...] = ()
    """Target points of links on the object; empty: links touch anywhere."""
    T_world_object: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose of the object (4, 4), world frame; all else is in the object's frame and moves with it."""
    counted: Counted | None = None
    """Links that count by the file or by the last refinement; None: links with a target or within reach."""
    trace: Trace | None = None
    """Iterations of the last refinement."""
    frame: int | None = None
    """Number of the shown iteration; None: `pose` is shown."""
    outcome: Outcome | None = None
    """Outcome of the last refinement, one row, if `pose` is its result."""
    config: Config | None = None
    """Settings of that refinement."""
    refined_for: Task | None = None
    """Task of that refinement."""
    refined_at: datetime | None = None
    """Time of that refinement."""
    trial: TrialResult | None = None
    """Simulation result of `pose`."""
    tested_at: datetime | None = None
    """Time of that simulation; None: it is from a document, or there is none."""
    plan: Recording | None = None
    """Trajectory of the hand to `pose` and up with the object."""
    of_file: Pose | None = None
    """Pose in the file; None: there is no file."""
    saved: Pose | None = None
    """Pose that was saved last; None: none was."""
    regions_before: ContactRegions | None = None
    """Earlier regions, in a snapshot from before others were set; None in other snapshots."""
    undo_steps: tuple[Work, ...] = ()
    """Snapshots before the edits that can be undone, the last one last."""
    redo_steps: tuple[Work, ...] = ()
    """Snapshots that were undone, the last one last."""

    @property
    def standing(self) -> Pose:
        """Pose of the hand for the next command: that of the shown iteration, or the present one."""
        if self.frame is not None and self.trace is not None:
            return self.trace.pose(min(self.frame, len(self.trace) - 1))
        return self.pose

    @property
    def snapshots(self) -> tuple[Work, ...]:
        """Snapshots to return to, the last one last: the present pose and, if one is shown, that of an iteration."""
        present = replace(self, frame=None, undo_steps=(), redo_steps=())
        if self.standing.same(self.pose):
            return (present,)
        return present, replace(present, pose=self.standing, **NO_RESULTS)

    @property
    def changed(self) -> bool:
        """Whether the pose is not that of the file."""
        return self.of_file is not None and not self.of_file.same(self.pose)

    @property
    def unsaved(self) -> bool:
        """Whether the pose is neither that of the file nor saved."""
        return self.changed and (self.saved is None or not self.saved.same(self.pose))


NO_RESULTS: dict[str, Any] = dict.fromkeys(
    ("outcome", "config", "refined_for", "refined_at", "trial", "tested_at", "plan")
)
"""Fields without results, which do not hold for another pose."""

Works = Mapping[int, Work]
"""Number of a grasp -> its work; grasps that were never shown or refined have none."""


def now() -> datetime:
    """Return the present time, of this machine's clock."""
    return datetime.now().astimezone()
