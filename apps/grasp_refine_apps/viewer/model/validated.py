"""Simulation result of one grasp, as data and as text for users."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, isnan

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.results.simulated import closing_line
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.trials import NUMBERS, Reason, Trials
from grasp_refine.validation.validate import BARELY
from grasp_refine_apps.viewer.model.margins import HoldingMargins


@dataclass(frozen=True)
class DirectionResult:
    """Simulation result of a grasp in one direction; NaN where a value is not known."""

    direction: str
    """Name of the direction, such as "+x", or "lift"."""
    reason: Reason
    """End of the trial."""
    time_s: float
    """Time of failure in seconds after the push or the lift began; NaN where it did not fail."""
    displacement_m: float
    """Displacement of the object then, or at the end, metres."""
    angle_rad: float
    """Rotation of the object then, or at the end, radians."""
    peak_m: float
    """Largest displacement of the object, metres."""
    peak_rad: float
    """Largest rotation of the object, radians."""
    links: tuple[str, ...]
    """Names of the links that touched the object then."""

    @property
    def held(self) -> bool:
        """Whether the object stayed."""
        return self.reason == Reason.HELD

    @property
    def when(self) -> str:
        """Time of failure as text, such as ", 0.2 s"; empty where there is none."""
        return "" if isnan(self.time_s) else f", {self.time_s:.1f} s"

    @property
    def after(self) -> str:
        """Time of failure in a sentence, such as " after 0.2 s"."""
        return self.when.replace(",", " after")


@dataclass(frozen=True, eq=False)
class TrialResult:
    """Simulation result of one grasp; NaN where a value is not known."""

    protocol: Protocol
    """Protocol of the simulation."""
    results: tuple[DirectionResult, ...]
    """Results of the directions; at least one."""
    closing: Mapping[str, str]
    """Source of the simulated pregrasp and squeeze: stage -> "file" or "own"; empty where that is not known."""
    closing_m: float
    """Displacement of the object by the closing hand, metres."""
    closing_rad: float
    """Rotation of the object by the closing hand, radians."""
    penetration_m: float
    """Penetration of hand and object at the pregrasp, metres."""
    label: float | None = None
    """Share of the protocol's offsets of the object with which the grasp held; None without offsets."""
    margins: HoldingMargins | None = None
    """Margins, where a document has them."""
    motion: Motion | None = None
    """Closing motion of the hand, for another simulation; None where that is not known."""

    @staticmethod
    def of(
        trials: Trials, i: int, protocol: Protocol, closing: Mapping[str, str], motion: Motion | None
    ) -> TrialResult:
        """Return the result of grasp `i` of some trials."""
        results = tuple(
            DirectionResult(
                direction=name,
                reason=Reason(trials.reason[i, d]),
                links=tuple(trials.links[link] for link in np.flatnonzero(trials.contacts[i, d])),
                **{key: float(getattr(trials, key)[i, d]) for key in NUMBERS},
            )
            for d, name in enumerate(trials.directions)
        )
        return TrialResult(
            protocol=protocol,
            results=results,
            closing=closing,
            closing_m=float(trials.closing_m[i]),
            closing_rad=float(trials.closing_rad[i]),
            penetration_m=float(trials.penetration_m[i]),
            label=None if trials.label is None else float(trials.label[i]),
            motion=motion,
        )

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the directions, in order."""
        return tuple(result.direction for result in self.results)

    @property
    def held(self) -> bool:
        """Whether it held by the rule of the protocol."""
        return self._held_centred if self.label is None else self.label >= self.protocol.required_label

    @property
    def _held_centred(self) -> bool:
        """Whether it held in enough directions, with the object where it should be."""
        return sum(result.held for result in self.results) >= self.protocol.required(len(self.results))

    @property
    def barely(self) -> bool:
        """Whether it held, but came more than half of the way to what counts as lost."""
        far, steep = BARELY * self.protocol.farthest, BARELY * self.protocol.steepest
        near = (result.peak_m > far or result.peak_rad > steep for result in self.results if result.held)
        return self.held and any(near)

    @property
    def before_push(self) -> Reason | None:
        """Reason for which nothing was pushed; None where something was."""
        first = self.results[0].reason
        early = first not in (Reason.HELD, Reason.MOVED, Reason.ROTATED)
        same = all(result.reason == first and isnan(result.time_s) for result in self.results)
        return first if early and same else None

    @property
    def watchable(self) -> bool:
        """Whether there is a motion to be seen: the hand began to close."""
        never = (Reason.PENETRATES, Reason.IN_TABLE, Reason.NOT_FINITE, Reason.OUT_OF_REACH)
        return self.before_push not in never

    @property
    def verdict(self) -> str:
        """The outcome in one line."""
        if self.label is None:
            return self._verdict_centred
        noise, holds = self.protocol.noise, "Holds" if self.held else "Does not hold"
        return (
            f"{holds}: the object stayed in {self.label:.0%} of {noise.count} trials "
            f"with it up to {noise.reach} elsewhere; where it should be: {self._verdict_centred}"
        )

    @property
    def _verdict_centred(self) -> str:
        """The outcome in one line, with the object where it should be."""
        if self.before_push is not None:
            return f"Does not hold: {self.words(self.results[0])}"
        lost = [result for result in self.results if not result.held]
        if self.protocol.tabletop:
            if lost:
                whose = (
                    ""
                    if lost[0].reason in (Reason.UNSTABLE, Reason.HAND_UNSTABLE)
                    else "while it was lifted, the object "
                )
                return f"Does not hold: {whose}{self.words(lost[0])}"
            stayed = f"Holds: the object stayed in the hand while it was lifted by {self.protocol.lift * 1e2:g} cm"
        elif lost:
            names = ", ".join(result.direction for result in lost)
            where = f"the object was lost in {len(lost)} of {len(self.results)} directions ({names})"
            if not self._held_centred:
                return f"Does not hold: {where}"
            stayed = f"Holds, as {self.protocol.required(len(self.results))} directions are enough: {where}"
        else:
            stayed = f"Holds: the object stayed in all {len(self.results)} directions"
        if self.barely:
            held = [result for result in self.results if result.held]
            moved, turned = (max(getattr(result, key) for result in held) for key in ("peak_m", "peak_rad"))
            stayed += f", but barely: it moved {moved * 1e3:.0f} mm and rotated {degrees(turned):.0f}° at most"
        return stayed

    @property
    def conditions(self) -> str:
        """Conditions of the simulation in one line."""
        return f"{self.protocol.name}: {self.protocol.summary}"

    @property
    def closed_by(self) -> str:
        """Source of the simulated pregrasp and squeeze in one line; empty where that is not known."""
        return closing_line(self.closing).plain if self.closing else ""

    def words(self, result: DirectionResult) -> str:
        """Describe the result of one direction, such as "rotated by 15.2° after 0.2 s, 4 links still touched it"."""
        left = f"{_links(len(result.links))} touched it"
        moved, turned = f"{result.displacement_m * 1e3:.1f} mm", f"{degrees(result.angle_rad):.1f}°"
        if result.reason == Reason.HELD:
            return f"stayed: moved by {moved}, rotated by {turned}"
        if result.reason == Reason.MOVED:
            return f"moved by {moved}{result.after}, {left}"
        if result.reason == Reason.ROTATED:
            return f"rotated by {turned}{result.after}, {left}"
        if result.reason == Reason.UNSTABLE:
            return f"the simulation became unstable{result.after}"
        if result.reason == Reason.PENETRATES and not isnan(self.penetration_m):
            return (
                f"hand and object overlap by {self.penetration_m * 1e3:.1f} mm before the hand closes, which would "
                f"eject the object (at most {self.protocol.deepest * 1e3:g} mm)"
            )
        if result.reason == Reason.EJECTED_WHILE_CLOSING and not isnan(self.closing_m):
            return (
                f"closing the hand moved the object by {self.closing_m * 1e3:.0f} mm and rotated it by "
                f"{degrees(self.closing_rad):.0f}°, before any push"
            )
        return result.reason.meaning(self.protocol)


def _links(count: int) -> str:
    """Number of links as text."""
    return {0: "no link", 1: "1 link still"}.get(count, f"{count} links still")
