"""How the refinement of one grasp ended, and what a user can do about it."""

from enum import IntEnum


class Status(IntEnum):
    """End of a refinement."""

    RUNNING = 0
    CONVERGED = 1
    STALLED = 2
    BUDGET = 3
    NO_TARGET = 4
    NOT_FINITE = 5

    @property
    def label(self) -> str:
        """The name as it is written in tables and JSON."""
        return self.name.lower().replace("_", " ")

    @property
    def advice(self) -> str:
        """What a user can do; empty when there is nothing to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.RUNNING: "",
    Status.CONVERGED: "",
    Status.STALLED: "the loss no longer falls: the targets may be out of reach together; see the contact errors",
    Status.BUDGET: "the iterations ran out while the loss still fell: raise --iterations",
    Status.NO_TARGET: "no contact link is near the object: start closer to it, or give --targets",
    Status.NOT_FINITE: "the grasp holds NaN or infinite numbers, or a query failed: check the input",
}
