"""`refine-grasp bench grippers`: how many grasps of grippers hold before and after refinement."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine_apps.bench.grippers.study import GrippersStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, given
from grasp_refine_apps.commands.hands import OBJECTS
from grasp_refine_apps.commands.options import OptionalFile, Overwrite, default

PresetName = Literal["smoke"]

SMOKE = {"objects": ("box:0.04,0.04,0.06",), "count": 1}
"""Fields of the preset."""


@dataclass(frozen=True)
class BenchGrippers(BenchCommand):
    """Measure how many grasps of grippers hold before and after refinement, and which are lost.

    Each gripper samples grasps on each object; each of them is tried as it is, and moved by 5 mm in a random direction
    and turned by 10 degrees about a random axis through the middle of its pads. All are simulated as `dexgraspbench`
    does, before and after refinement, under frictions of 0.6 and 0.3, with several points for two convex pieces that
    touch, as validation of grippers has them, and with one.
    """

    command = "bench grippers"
    compared = ("objects", "count")

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment: smoke (one grasp on a box, in seconds)."""
    hands: Annotated[tuple[str, ...], arg(metavar="HAND [HAND ...]")] = ("franka_hand",)
    """Grippers: names or files, as for `run --hand`."""
    objects: Annotated[
        DisallowNone[tuple[str, ...] | None], default("mug bottle bowl ..., or 20 of --assets", metavar="OBJECT [...]")
    ] = None
    """Objects, as for `run --object`; with --assets names in objects.csv."""
    assets: Annotated[DisallowNone[Path | None], default("none", metavar="DIR")] = None
    """Folder with objects and objects.csv, as for `bench evidence`."""
    count: Annotated[DisallowNone[int | None], default("4, or the preset's")] = None
    """Number of sampled grasps of each gripper on each object."""
    workers: int = 1
    """Processes."""
    seed: int = 0
    """Random seed."""
    json: OptionalFile = None
    """Write all rows to this file."""
    html: OptionalFile = None
    """Write a report to this file."""
    overwrite: Overwrite = False

    def study(self) -> GrippersStudy:
        """Return the study that the options define."""
        objects = () if self.assets is not None else OBJECTS
        chosen = SMOKE if self.preset is not None else {}
        return GrippersStudy(**{"objects": objects, **chosen, **given(self, GrippersStudy)})
