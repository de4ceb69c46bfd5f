"""`refine-grasp bench scans`: grasps refined on scans of an object, tried on the object itself."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine_apps.bench.scans.measure import Measurement
from grasp_refine_apps.bench.scans.study import ScanStudy
from grasp_refine_apps.bench.scans.ways import Way
from grasp_refine_apps.bench.success.assets import EMBEDDED_OBJECTS
from grasp_refine_apps.bench.success.trials import Trial
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["smoke"]
Names = DisallowNone[tuple[str, ...] | None]


@dataclass(frozen=True)
class BenchScans(BenchCommand):
    """Measure how many grasps hold that were refined on a scan of the object, not on the object itself.

    They are refined on the hull of the scan, a plain reconstruction, or all solids that the object may be; and, for
    comparison, on the true mesh, and not at all.
    Depth pictures are rendered from random sides, with the noise, holes and mask errors of a common depth camera.
    Sampled grasps, moved by 5 mm and turned by 10 degrees, are refined, and simulated on the true mesh.
    """

    command = "bench scans"

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """smoke: one view of one object, two grasps, in seconds; other options replace its settings."""
    assets: Annotated[DisallowNone[Path | None], default("none: embedded hands and objects", metavar="DIR")] = None
    """Folder with hands/, objects/ and objects.csv, as for `bench success`."""
    hands: Annotated[Names, default("allegro, or all of --assets", metavar="HAND [...]")] = None
    """Hands."""
    on: Annotated[Names, default(f"{' '.join(EMBEDDED_OBJECTS)}, or all of --assets", metavar="OBJECT [...]")] = None
    """Objects."""
    ways: Annotated[DisallowNone[tuple[Way, ...] | None], default("all")] = None
    """Ways to refine: unrefined, on the hull of the scan, on a plain reconstruction, on all hypotheses, on the true
    mesh."""
    views: Annotated[DisallowNone[tuple[int, ...] | None], default("1 2 4")] = None
    """Numbers of views."""
    count: Annotated[DisallowNone[int | None], default("16")] = None
    """Number of grasps of each hand on each object."""
    hypotheses: Annotated[DisallowNone[int | None], default("8")] = None
    """Maximum number of solids that a scan may be."""
    offset: Annotated[DisallowNone[float | None], default("0", metavar="METRES")] = None
    """Displace each scan by this distance in a random direction, as by a calibration that is off."""
    protocol: str = "dexgraspbench"
    """Protocol of the simulation, as for `validate`."""
    threads: Annotated[DisallowNone[int | None], default("all")] = None
    """CPU threads of the simulation; refinement uses one."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> ScanStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: there is no such protocol.
        """
        study = ScanStudy()
        measurement = replace(study.measurement, trial=Trial(load_protocol(self.protocol)))
        if self.preset == "smoke":
            study = replace(study, on=EMBEDDED_OBJECTS[:1])
            measurement = replace(measurement, views=(1,), count=2, hypotheses=3)
        measurement = replace(measurement, **self.given(Measurement))
        if self.threads is None and self.outputs.workers > 1:
            measurement = replace(measurement, threads=1)
        return replace(study, **self.given(ScanStudy), measurement=measurement)
