"""Options of the simulation, of all commands that simulate."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Annotated, ClassVar

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.problem import StageSource
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engine_table import MUJOCO, EngineChoice, chosen_engines
from grasp_refine.validation.validate import Checks
from grasp_refine_apps.commands.option_rules import OptionGroup

MAX_PUSH_S = 60.0
"""Longest push, seconds."""


Engines = Annotated[tuple[EngineChoice, ...], arg(help_behavior_hint=f"(default: {MUJOCO})")]
"""Option with the names of engines."""


@dataclass(frozen=True)
class Simulation:
    """Simulation of the grasps."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("simulation"),)

    simulate: bool = True
    """Simulate the grasps, in addition to measuring their geometry."""
    seconds: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Duration of each push, or of the lift, in steps of 0.2 s, or as in the protocol; 0.4 instead of 2 takes a
    third of the time."""
    multiccd: Annotated[DisallowNone[bool | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Let two convex pieces touch in several points, so that flat faces hold each other by a patch, instead of turning
    about one point; for mujoco. A protocol that says nothing does so for hands that touch in patches, as grippers."""
    closing: StageSource = "auto"
    """Pregrasps and squeezes: from the file, generated, or auto: from the file if it has them, else generated."""
    engine: Engines = (MUJOCO,)
    """Engines that simulate, and how far they agree: each has its own contact model and solver. The first one decides
    which grasps hold, and makes the trials of --noise, --frictions and --without-squeeze. all: every installed engine
    that simulates the hand and its task; each needs its extra: pip install 'grasp-refine[NAME]'."""
    threads: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: all)")] = None
    """Number of CPU threads; results do not depend on it."""

    def changed(self, protocol: Protocol) -> Protocol:
        """Return a protocol with the duration and the contacts of the options.

        Raises:
            GraspRefineError: an invalid duration.
        """
        protocol = protocol.with_multiccd(self.multiccd)
        return protocol if self.seconds is None else protocol.changed(checks=_checks(protocol, self.seconds))


def _checks(protocol: Protocol, seconds: float) -> int:
    """Return the number of checks of a push that takes so many seconds.

    Raises:
        GraspRefineError: it is not a multiple of the interval between two checks, or too long.
    """
    interval = protocol.steps_per_check * protocol.timestep
    checks = round(min(seconds, 2 * MAX_PUSH_S) / interval)
    if not interval <= seconds <= MAX_PUSH_S or abs(checks * interval - seconds) > 1e-9:
        raise GraspRefineError(f"--seconds must be a multiple of {interval:g}, at most {MAX_PUSH_S:g}, got {seconds:g}")
    return checks


@dataclass(frozen=True)
class Robustness:
    """Further trials with one thing changed, of your choice; --margins draws everything that nobody knows."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("further trials"),)

    noise: int = 0
    """Number of random offsets of the object at which each grasp is tried again; the score is the share that holds."""
    noise_offset: float = Noise.offset
    """Largest translation of these offsets, metres."""
    noise_degrees: float = 5.0
    """Largest rotation of these offsets, degrees."""
    frictions: Annotated[tuple[float, ...], arg(metavar="F [F ...]", help_behavior_hint="(default: none)")] = ()
    """Try each grasp again with these coefficients of friction."""
    without_squeeze: bool = False
    """Try each grasp again without the squeeze."""
    seed: int = 0
    """Random seed."""

    def checks(self, threads: int | None) -> Checks:
        """Return the checks that the options define, on a number of threads."""
        return Checks(
            noise=Noise(self.noise, self.noise_offset, radians(self.noise_degrees)),
            frictions=self.frictions,
            without_squeeze=self.without_squeeze,
            seed=self.seed,
            threads=threads,
        )


@dataclass(frozen=True)
class ValidationOptions:
    """Validation in simulation; `refine-grasp validate` can do more."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("simulation"),)

    validate: bool = False
    """Simulate the grasps before and after: does the object stay in the hand when it is pushed?"""
    engine: Engines = (MUJOCO,)
    """Engines that simulate, as in `refine-grasp validate`; the first one decides."""

    @property
    def engines(self) -> tuple[EngineChoice, ...]:
        """Engines that simulate; none: nothing is simulated.

        Raises:
            GraspRefineError: engines without --validate, or one of them cannot be used.
        """
        if not self.validate and self.engine != ValidationOptions.engine:
            raise GraspRefineError("--engine needs --validate")
        chosen_engines(self.engine, ())
        return self.engine if self.validate else ()
