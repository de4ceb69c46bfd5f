"""`refine-grasp bench scenes`: grasps of hands on an arm in scenes, along their trajectories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine_apps.bench.scenes.study import ScenesStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, given
from grasp_refine_apps.commands.options import OptionalFile, Overwrite, default

PresetName = Literal["smoke"]

SMOKE = {"scenes": ("mug-on-table",), "hands": ("franka_hand",), "count": 1}
"""Fields of the preset."""


@dataclass(frozen=True)
class BenchScenes(BenchCommand):
    """Measure how many sampled grasps are reachable, free along their trajectory, and held and lifted in MuJoCo.

    Each hand on its arm samples grasps in each scene; trajectories are planned before and after refinement, and free
    ones are followed in simulation as `run --trajectory --validate` does. The same again without knowing of the scene,
    which the simulation has nevertheless.
    """

    command = "bench scenes"
    compared = ("scenes", "hands", "count")

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment: smoke (one grasp of a gripper in one scene, in seconds)."""
    scenes: Annotated[
        DisallowNone[tuple[str, ...] | None], default("all that come with the program", metavar="SCENE [SCENE ...]")
    ] = None
    """Scenes: names or files, as for `run --scene`."""
    hands: Annotated[DisallowNone[tuple[str, ...] | None], default("allegro shadow", metavar="HAND [HAND ...]")] = None
    """Hands: names or files, as for `run --hand`."""
    arm: str = ScenesStudy.arm
    """Arm that carries them, as for `run --arm`."""
    base: Annotated[str, arg(metavar="x,y,z,roll,pitch,yaw")] = ScenesStudy.base
    """Pose of its base, metres and degrees, along the axes of the world from the origin of the object."""
    count: Annotated[DisallowNone[int | None], default("32, or the preset's")] = None
    """Number of sampled grasps of each hand in each scene."""
    workers: int = 1
    """Processes."""
    seed: int = 0
    """Random seed."""
    json: OptionalFile = None
    """Write all rows to this file."""
    html: OptionalFile = None
    """Write a report to this file."""
    overwrite: Overwrite = False

    def study(self) -> ScenesStudy:
        """Return the study that the options define."""
        return ScenesStudy(**{**(SMOKE if self.preset is not None else {}), **given(self, ScenesStudy)})
