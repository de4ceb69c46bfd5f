"""All formats of grasp files."""

from __future__ import annotations

from typing import Literal

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats.acronym import Acronym
from grasp_refine.grasps.formats.bodex import Bodex
from grasp_refine.grasps.formats.dexgraspbench import DexGraspBench
from grasp_refine.grasps.formats.dexgraspnet import DexGraspNet
from grasp_refine.grasps.formats.dexonomy import Dexonomy
from grasp_refine.grasps.formats.dro import DRO
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.frogger import Frogger
from grasp_refine.grasps.formats.graspqp import GraspQP
from grasp_refine.grasps.formats.hugs import Hugs
from grasp_refine.grasps.formats.isaac_grasp import IsaacGrasp
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.formats.lightning_grasp import LightningGrasp
from grasp_refine.grasps.formats.multidex import MultiDex
from grasp_refine.grasps.formats.multigripper import MultiGripperGrasp
from grasp_refine.grasps.formats.ours import Ours
from grasp_refine.grasps.formats.unidexgrasp import UniDexGrasp

FormatName = Literal[
    "ours",
    "dexgraspbench",
    "bodex",
    "dexonomy",
    "dexgraspnet",
    "unidexgrasp",
    "frogger",
    "leap_cache",
    "isaac_grasp",
    "multidex",
    "dro",
    "graspqp",
    "lightning_grasp",
    "hugs",
    "acronym",
    "multigripper",
]
"""Names of the formats on the command line."""

OURS = Ours()
FOREIGN: tuple[Format, ...] = (
    DexGraspBench(),
    Bodex(),
    Dexonomy(),
    DexGraspNet(),
    UniDexGrasp(),
    Frogger(),
    LeapCache(),
    IsaacGrasp(),
    MultiDex(),
    DRO(),
    GraspQP(),
    LightningGrasp(),
    Hugs(),
    Acronym(),
    MultiGripperGrasp(),
)
FORMATS: tuple[Format, ...] = (OURS, *FOREIGN)


def format_named(name: str) -> Format:
    """Return the format with a name.

    Raises:
        GraspFileError: there is none; lists all names.
    """
    for known in FORMATS:
        if known.name == name:
            return known
    raise GraspFileError(f"no format '{name}'; the formats are {', '.join(known.name for known in FORMATS)}")
