"""Status of the refinement of a grasp, with advice."""

from enum import IntEnum


class Status(IntEnum):
    """Status of the refinement of a grasp, such as converged, stalled or invalid, with advice on what to do."""

    RUNNING = 0
    CONVERGED = 1
    STALLED = 2
    BUDGET = 3
    NO_TARGET = 4
    NOT_FINITE = 5
    UNREACHABLE = 6
    INVALID = 7
    OUT_OF_REACH = 8

    @property
    def label(self) -> str:
        """Name of the status in tables and JSON."""
        return self.name.lower().replace("_", " ")

    @property
    def advice(self) -> str:
        """Advice for the user; empty when there is nothing to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.RUNNING: "",
    Status.CONVERGED: "",
    Status.STALLED: "the loss no longer falls: contacts or targets, penetration and joint limits contradict each "
    "other, or the remaining error is tiny",
    Status.BUDGET: "the iterations ran out while the loss still fell: raise `iterations`",
    Status.NO_TARGET: "no contact link is near the object: start closer, raise `reach`, or name `contacts`",
    Status.NOT_FINITE: "the grasp holds NaN or infinite numbers, or a query failed: check the input",
    Status.UNREACHABLE: "a target lies off the surface of its link or of the object: check frames and scale, or lower "
    "`threshold`",
    Status.INVALID: "the pose is no rigid motion, pose, joints or targets are beyond 1e6 m or rad, or a target normal "
    "is not of length 1: check the input",
    Status.OUT_OF_REACH: "no way of the arm brings the palm there without going through itself, the object or the "
    "table: move its base (`base`) or the object, or take another grasp",
}

UNUSABLE = (Status.NO_TARGET, Status.NOT_FINITE, Status.INVALID, Status.OUT_OF_REACH)
"""Statuses of grasps that were not refined at all."""
