"""Options of the simulation, of all commands that simulate."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, radians
from typing import Annotated, ClassVar

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.problem import StageSource
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.registry import DEFAULT, PROTOCOLS, default_protocol
from grasp_refine.validation.engine_choice import EngineChoice
from grasp_refine.validation.validate import Checks
from grasp_refine_apps.commands.option_rules import OptionGroup

ProtocolOption = Annotated[
    str,
    arg(
        metavar="NAME|FILE.toml",
        help=f"Protocol, or a TOML file of your own; with --scene, {DEFAULT} becomes scene. "
        + "; ".join(f"{name}: {protocol.summary}" for name, protocol in PROTOCOLS.items())
        + ".",
    ),
]
"""Option of a protocol; its help lists all of them."""

MAX_PUSH_S = 60.0
"""Longest push, seconds."""


@dataclass(frozen=True)
class Simulation:
    """Simulation of the grasps."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("simulation"),)

    simulate: bool = True
    """Simulate the grasps, in addition to measuring their geometry."""
    protocol: ProtocolOption = DEFAULT
    friction: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Coefficient of sliding friction; torsional friction is scaled in proportion."""
    mass: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Mass of the object, kg."""
    seconds: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Duration of each push, or of the lift, in steps of 0.2 s, or as in the protocol; 0.4 instead of 2 takes a
    third of the time."""
    multiccd: Annotated[DisallowNone[bool | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Let two convex pieces touch in several points, so that flat faces hold each other by a patch, instead of turning
    about one point; for mujoco. A protocol that says nothing does so for hands that touch in patches, as grippers."""
    closing: StageSource = "auto"
    """Pregrasps and squeezes: from the file, generated, or auto: from the file if it has them, else generated."""
    engine: EngineChoice = "mujoco"
    """Engine that simulates: mujoco; drake, of another contact model, for a second opinion (pip install
    'grasp-refine[drake]'); or both, and how far they agree. --noise, --frictions and --without-squeeze of both are
    mujoco's."""
    threads: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: all)")] = None
    """Number of CPU threads; results do not depend on it."""

    def chosen_protocol(self, *, in_scene: bool = False) -> Protocol:
        """Return the protocol that the options define; in a scene the default one lifts the object out of it.

        Raises:
            GraspRefineError: an invalid duration, or friction or mass of 0.
        """
        for name, value in (("friction", self.friction), ("mass", self.mass)):
            if value == 0:
                raise GraspRefineError(f"--{name} must be above 0")
        protocol = _named(self.protocol, in_scene).with_friction(self.friction).with_mass(self.mass)
        protocol = protocol.with_multiccd(self.multiccd)
        return protocol if self.seconds is None else protocol.changed(checks=_checks(protocol, self.seconds))


def _named(name: str, in_scene: bool) -> Protocol:
    """Return the protocol of a name or file; in a scene, the default one is that which lifts the object out of it."""
    return default_protocol(in_scene=in_scene) if name == DEFAULT else load_protocol(name)


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
    protocol: ProtocolOption = DEFAULT
    friction: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the protocol)")] = None
    """Coefficient of sliding friction."""

    def chosen_protocol(self, *, in_scene: bool = False) -> Protocol | None:
        """Return the protocol of the simulation, in a scene by default `scene`; None: grasps are not simulated.

        Raises:
            GraspRefineError: an option that is invalid, or has no effect.
        """
        if not self.validate and self != ValidationOptions():
            raise GraspRefineError("--protocol and --friction are for --validate, which simulates the grasps")
        if self.friction is not None and not 0 < self.friction < inf:
            raise GraspRefineError(f"--friction must be above 0, got {self.friction:g}")
        return _named(self.protocol, in_scene).with_friction(self.friction) if self.validate else None
