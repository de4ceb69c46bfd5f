"""The options that say how grasps are simulated, and what else is tried."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians
from typing import Annotated

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.pipeline.problem import StageSource
from grasp_refine.validation.protocol import SETTINGS, Protocol, SettingName
from grasp_refine.validation.robustness import Noise
from grasp_refine.validation.validate import Checks

CHECK = Protocol.steps_per_check * Protocol.timestep
"""Seconds between two checks of a push."""


LONGEST = 60.0
"""Longest push in seconds."""


@dataclass(frozen=True)
class Simulation:
    """How grasps are simulated."""

    simulate: bool = True
    """Simulate the grasps, beside measuring their geometry."""
    setting: SettingName = "force-closure"
    """force-closure: pushed in six directions, friction 0.6; strict: the same with friction 0.3; tabletop: lifted off
    a table by 10 cm."""
    friction: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the setting)")] = None
    """Another coefficient of sliding friction; that of torsion follows in proportion."""
    mass: float = Protocol.mass
    """Mass of the object in kg."""
    seconds: float = Protocol.checks * Protocol.steps_per_check * Protocol.timestep
    """How long each push, or the lift, lasts, in steps of 0.2 s; 0.4 takes a third of the time."""
    closing: StageSource = "auto"
    """Pregrasps and squeezes: those of the file, our own, or auto: those of the file if it has them, else our own."""
    threads: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: all)")] = None
    """CPU threads; results do not depend on it."""

    def protocol(self) -> Protocol:
        """The protocol that the options mean.

        Raises:
            GraspRefineError: a push cannot be that long, or friction or mass are 0.
        """
        for name, value in (("friction", self.friction), ("mass", self.mass)):
            if value == 0:
                raise GraspRefineError(f"--{name} must be above 0")
        checks = round(min(self.seconds, 2 * LONGEST) / CHECK)
        if not CHECK <= self.seconds <= LONGEST or abs(checks * CHECK - self.seconds) > 1e-9:
            raise GraspRefineError(
                f"--seconds must be a multiple of {CHECK:g}, at most {LONGEST:g}, got {self.seconds:g}"
            )
        return replace(SETTINGS[self.setting].slippery(self.friction), mass=self.mass, checks=checks)


@dataclass(frozen=True)
class Robustness:
    """What else is tried."""

    noise: int = 0
    """Try each grasp again with so many random offsets of the object; the score is the share that holds."""
    noise_offset: float = Noise.offset
    """Largest shift of these, in metres."""
    noise_degrees: float = 5.0
    """Largest rotation of these, in degrees."""
    frictions: Annotated[tuple[float, ...], arg(metavar="F [F ...]", help_behavior_hint="(default: none)")] = ()
    """Try each grasp again with these coefficients of friction."""
    without_squeeze: bool = False
    """Try each grasp again without the squeeze."""
    seed: int = 0
    """Seed of what is drawn."""

    def checks(self, threads: int | None) -> Checks:
        """What the options mean, on so many threads."""
        return Checks(
            noise=Noise(self.noise, self.noise_offset, radians(self.noise_degrees)),
            frictions=self.frictions,
            without_squeeze=self.without_squeeze,
            seed=self.seed,
            threads=threads,
        )
