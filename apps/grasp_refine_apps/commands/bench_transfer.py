"""`refine-grasp bench transfer`: grasps of one hand as grasps of others, in several ways, tried in simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine_apps.bench.success.assets import EMBEDDED_OBJECTS
from grasp_refine_apps.bench.success.trials import Trial
from grasp_refine_apps.bench.transfer.measure import Measurement
from grasp_refine_apps.bench.transfer.study import SOURCE_HAND, TARGETS, TransferStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["smoke"]
Names = DisallowNone[tuple[str, ...] | None]


@dataclass(frozen=True)
class BenchTransfer(BenchCommand):
    """Measure how many grasps of one hand hold as grasps of another, and how much they are still the same grasps.

    Three ways are compared: joints copied finger by finger, inverse kinematics of the contacts alone, and
    `refine-grasp transfer`, which refines these grasps.
    """

    command = "bench transfer"

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """smoke: the examples on one object to one hand, in seconds; other options replace its settings."""
    source_hand: Annotated[
        DisallowNone[str | None], arg(name="from", metavar="HAND", help_behavior_hint=f"(default: {SOURCE_HAND})")
    ] = None
    """Embedded hand whose example grasps are transferred, without --assets."""
    to: Annotated[Names, default(" ".join(TARGETS), metavar="HAND [...]")] = None
    """Hands that get the grasps, as for `run`: names, folders, URDF or MJCF files."""
    on: Annotated[Names, default(f"{' '.join(EMBEDDED_OBJECTS)}, or all of --assets", metavar="OBJECT [...]")] = None
    """Objects."""
    assets: Annotated[DisallowNone[Path | None], default("none: embedded examples", metavar="DIR")] = None
    """Folder with hands/, objects/, objects.csv and grasps/, as for `bench success`."""
    generators: Annotated[Names, default("all", metavar="NAME[:N] [...]")] = None
    """Grasp files of --assets, or N grasps of each, evenly from the file."""
    protocol: str = "dexgraspbench"
    """Protocol of the simulation, as for `validate`."""
    threads: Annotated[DisallowNone[int | None], default("all")] = None
    """CPU threads of the simulation; the rest uses one."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> TransferStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: there is no such protocol.
        """
        study = TransferStudy()
        if self.preset == "smoke":
            study = replace(study, on=EMBEDDED_OBJECTS[:1], to=TARGETS[:1])
        measurement = replace(study.measurement, trial=Trial(load_protocol(self.protocol)), **self.given(Measurement))
        if self.threads is None and self.outputs.workers > 1:
            measurement = replace(measurement, threads=1)
        return replace(study, **self.given(TransferStudy), measurement=measurement)
