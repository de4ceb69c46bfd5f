"""`refine-grasp bench hold`: success rate of grasps after refinement, against its cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.spec import AUTO
from grasp_refine.refinement.config import Config
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine_apps.bench.hold.study import PRESETS, HoldStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, given
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.options import OptionalFile, Overwrite, default

PresetName = Literal["smoke"]


@dataclass(frozen=True)
class Options:
    """Options of the study."""

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment: smoke (every method on two grasps, in seconds)."""
    starts: Annotated[DisallowNone[tuple[int, ...] | None], default("1 6, or the preset's")] = None
    """Numbers of starts of the search for grasps that may not hold; each number is a separate run."""
    protocols: Annotated[tuple[str, ...], arg(metavar="NAME|FILE.toml [...]")] = ("dexgraspbench", "strict")
    """Protocols of the simulation: names that `refine-grasp validate --help` lists, or TOML files."""
    count: Annotated[DisallowNone[int | None], default("all, or the preset's")] = None
    """Maximum number of grasps on each object at each scale, the first ones."""
    width: int = Config.width
    """Maximum number of grasps refined at once."""
    threads: Annotated[DisallowNone[int | None], default("all")] = None
    """CPU threads of the simulation; refinement uses one."""
    seed: int = 0
    """Random seed."""
    json: OptionalFile = None
    """Write all rows to this file, in SI units, except times in ms."""
    html: OptionalFile = None
    """Write a report with a plot of success over time to this file."""
    overwrite: Overwrite = False


@dataclass(frozen=True)
class BenchHold(BenchCommand):
    """Measure how many grasps hold in simulation, against the CPU time of refinement.

    The methods are: grasps as given, with pregrasps and squeezes of our own, refined by geometry only, and refined for
    force balance, from one start or several. Without options, the example grasps of the embedded hand on the embedded
    mug.
    """

    command = "bench hold"
    compared = ("starts",)

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    options: Annotated[Options, arg(name="")] = field(default_factory=Options)

    def study(self) -> HoldStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: targets, which the study does not use, or no such protocol.
        """
        options = self.options
        if self.inputs.targets != AUTO:
            raise GraspRefineError("--targets: the benchmark refines grasps without targets")
        for name in options.protocols:
            load_protocol(name)
        preset = PRESETS[options.preset] if options.preset is not None else {}
        return HoldStudy(self.inputs, **{**preset, **given(options, HoldStudy)})
