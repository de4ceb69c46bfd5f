"""Results of simulated grasps: held or not, and the reason of a failure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from math import degrees
from typing import Literal

import numpy as np

from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.plurals import count_text
from grasp_refine.core.short_repr import labels, tallied
from grasp_refine.scene.protocols.protocol import Protocol


class Reason(IntEnum):
    """Result of the trial of a grasp in one direction."""

    HELD = 0
    MOVED = 1
    ROTATED = 2
    EJECTED_WHILE_CLOSING = 3
    PENETRATES = 4
    IN_TABLE = 5
    UNSTABLE = 6
    NOT_FINITE = 7
    OFF_CENTRE = 8
    OUT_OF_REACH = 9
    HAND_UNSTABLE = 10

    @property
    def label(self) -> str:
        """Name of the reason in results and tables."""
        return self.name.lower().replace("_", " ")

    def meaning(self, protocol: Protocol) -> str:
        """Return a description of the outcome, for people."""
        return {
            Reason.HELD: "the object stayed",
            Reason.MOVED: f"the object was {protocol.farthest * 1e3:g} mm or more away from its place",
            Reason.ROTATED: f"the object had rotated by {degrees(protocol.steepest):g} degrees or more",
            Reason.EJECTED_WHILE_CLOSING: "closing the hand moved the object by "
            f"{', or rotated it by '.join(protocol.bounds())}, before the push",
            Reason.IN_TABLE: f"the hand is deeper than {protocol.deepest * 1e3:g} mm in the table, or in a body of "
            "the scene, at the pregrasp",
            Reason.PENETRATES: f"hand and object are deeper than {protocol.deepest * 1e3:g} mm in each other at the "
            "pregrasp, which would eject the object",
            Reason.UNSTABLE: "the simulation diverged",
            Reason.HAND_UNSTABLE: "joints of the hand diverged, which is a fault of its model, not of the grasp: give "
            "them damping or armature, or their servos less stiffness",
            Reason.NOT_FINITE: "the grasp holds NaN or infinite numbers, or its pose is invalid: no rigid "
            "motion, or beyond 1e6 m or rad",
            Reason.OUT_OF_REACH: "the arm does not reach the grasp: move its base, or the object",
            Reason.OFF_CENTRE: "the object stayed, but in too many of the trials with the object elsewhere it did not",
        }[self]


PUSHED_M = 0.005
"""Displacement in metres from which on a neighbour of the object counts as pushed."""

NUMBERS = ("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad")
"""Fields of `Trials` with one number for each direction."""


@dataclass(frozen=True, eq=False)
class Trials(ArrayRecord):
    """Trials of N grasps, each in D directions, with contacts of L links."""

    directions: tuple[str, ...]
    """Names of the D directions, such as "+x", or "lift"."""
    links: tuple[str, ...]
    """Names of the L links that can touch the object."""
    reason: Int[np.ndarray, "N D"]
    """A `Reason` for each trial (N, D)."""
    time_s: Float[np.ndarray, "N D"]
    """Time of the failure (N, D), in seconds after the push or the lift began; NaN where the grasp held."""
    displacement_m: Float[np.ndarray, "N D"]
    """Displacement of the object from its initial position (N, D), at the failure or at the end, metres."""
    angle_rad: Float[np.ndarray, "N D"]
    """Rotation of the object from its initial pose (N, D), at the failure or at the end, radians."""
    peak_m: Float[np.ndarray, "N D"]
    """Largest displacement of the object at all checks until then (N, D), metres."""
    peak_rad: Float[np.ndarray, "N D"]
    """Largest rotation of the object at all checks until then (N, D), radians."""
    contacts: Bool[np.ndarray, "N D L"]
    """True (N, D, L) where a link touched the object at the failure or at the end."""
    contacts_grasp: Bool[np.ndarray, "N L"]
    """True (N, L) where a link touched the object at the grasp, before the squeeze."""
    contacts_squeeze: Bool[np.ndarray, "N L"]
    """True (N, L) where a link touched the object after the squeeze, before the push."""
    closing_m: Float[np.ndarray, " N"]
    """Displacement of the object while the hand closed (N,), metres."""
    closing_rad: Float[np.ndarray, " N"]
    """Rotation of the object while the hand closed (N,), radians."""
    penetration_m: Float[np.ndarray, " N"]
    """Penetration of hand and object at the pregrasp (N,), metres."""
    success: Bool[np.ndarray, " N"]
    """True where a grasp (N,) held by the rule of its protocol (`Protocol.rule`)."""
    label: Float[np.ndarray, " N"] | None = None
    """Share (N,) of the protocol's offsets of the object with which the grasp held; None without offsets."""
    limits: tuple[float, float] = (Protocol.farthest, Protocol.steepest)
    """Displacement and rotation of a lost object by the protocol, metres and radians."""
    neighbours: tuple[str, ...] = ()
    """Names of the V bodies around the object that can be pushed."""
    pushed_m: Float[np.ndarray, "N V"] | None = None
    """Displacement (N, V) of these at the failure or at the end, metres; NaN where nothing was simulated. None: there
    are none."""

    runaway: np.ndarray | None = None
    """Name (N,) of the hand's joint that made a simulation diverge; empty where none did. None: that is not known."""

    def __repr__(self) -> str:
        held = f"{self.success.sum()} of {count_text(len(self), 'grasp')} held"
        return f"Trials({held}; pushed {', '.join(self.directions)}: {tallied(self.labels.reshape(-1))})"

    @property
    def runaways(self) -> tuple[str, ...]:
        """Names of the hand's joints that made simulations diverge."""
        return () if self.runaway is None else tuple(sorted({*self.runaway.tolist()} - {""}))

    @property
    def labels(self) -> np.ndarray:
        """Labels of `reason` (N, D), such as "held"."""
        return labels(Reason, self.reason)

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.reason)

    @property
    def worst(self) -> Int[np.ndarray, " N"]:
        """Column (N,) of the first direction that failed; for a grasp that held, of that nearest to failing."""
        failed = self.reason != Reason.HELD
        share = np.maximum(self.peak_m / self.limits[0], self.peak_rad / self.limits[1])
        nearest = np.where(failed, -1.0, np.nan_to_num(share, nan=np.inf)).argmax(axis=1)
        lost = failed.all(axis=1) | (failed.any(axis=1) & ~self.success)
        return np.where(lost, failed.argmax(axis=1), nearest)

    @property
    def outcome(self) -> Int[np.ndarray, " N"]:
        """A `Reason` for each grasp (N,): HELD by the rule of the protocol, else that of the worst direction.

        OFF_CENTRE, where all directions held, but too few of the offsets of the object.
        """
        worst = self.reason[np.arange(len(self)), self.worst]
        return np.where(self.success, Reason.HELD, np.where(worst == Reason.HELD, Reason.OFF_CENTRE, worst))

    def most(self, name: Literal["peak_m", "peak_rad"]) -> Float[np.ndarray, " N"]:
        """Return the largest displacement or rotation (N,) over the directions in which the object was held."""
        return np.where(self.reason == Reason.HELD, getattr(self, name), 0.0).max(axis=1)

    def pushed(self, i: int) -> str:
        """Return text on the neighbour that grasp `i` pushed farthest; empty if none by `PUSHED_M`."""
        if self.pushed_m is None or not (self.pushed_m[i] >= PUSHED_M).any():
            return ""
        most = int(np.nan_to_num(self.pushed_m[i]).argmax())
        return f"pushed {self.neighbours[most]} {1e3 * self.pushed_m[i, most]:.0f} mm"

    @classmethod
    def join(cls, parts: Sequence[Trials]) -> Trials:
        """Return the grasps of all parts, in that order; parts may have different links."""
        links = tuple(dict.fromkeys(link for part in parts for link in part.links))

        def spread(part: Trials, contacts: np.ndarray) -> np.ndarray:
            wide = np.zeros((*contacts.shape[:-1], len(links)), dtype=bool)
            wide[..., [links.index(link) for link in part.links]] = contacts
            return wide

        columns = {}
        for field in fields(cls)[2:]:
            values = [getattr(part, field.name) for part in parts]
            if not isinstance(values[0], np.ndarray):
                continue
            if field.name.startswith("contacts"):
                values = [spread(part, value) for part, value in zip(parts, values, strict=True)]
            columns[field.name] = np.concatenate(values)
        return cls(parts[0].directions, links, **columns, limits=parts[0].limits, neighbours=parts[0].neighbours)
