"""All formats of grasp files."""

from __future__ import annotations

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.registry import Registry
from grasp_refine.grasps.formats.acronym import Acronym
from grasp_refine.grasps.formats.bodex import Bodex
from grasp_refine.grasps.formats.dexgraspbench import DexGraspBench
from grasp_refine.grasps.formats.dexgraspnet import DexGraspNet
from grasp_refine.grasps.formats.dexonomy import Dexonomy
from grasp_refine.grasps.formats.dro import DRO
from grasp_refine.grasps.formats.equidexflow import EquiDexFlow
from grasp_refine.grasps.formats.format import Format, check_format
from grasp_refine.grasps.formats.frogger import Frogger
from grasp_refine.grasps.formats.graspm3 import GraspM3
from grasp_refine.grasps.formats.graspqp import GraspQP
from grasp_refine.grasps.formats.hugs import Hugs
from grasp_refine.grasps.formats.isaac_grasp import IsaacGrasp
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.formats.lightning_grasp import LightningGrasp
from grasp_refine.grasps.formats.multidex import MultiDex
from grasp_refine.grasps.formats.multigripper import MultiGripperGrasp
from grasp_refine.grasps.formats.ours import Ours
from grasp_refine.grasps.formats.table import Table
from grasp_refine.grasps.formats.unidexgrasp import UniDexGrasp

OURS = Ours()
FORMATS: Registry[Format] = Registry(
    "format",
    "grasp_refine.formats",
    (
        OURS,
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
        GraspM3(),
        EquiDexFlow(),
        Table(),
    ),
    name_of=lambda known: known.name,
    check=check_format,
    error=GraspFileError,
)
"""Formats of grasp files, ours first; formats of installed packages and of scripts follow."""

add_format = FORMATS.add

FOREIGN = FORMATS.view(lambda every: (known for known in every if known is not OURS))
"""Formats of other programs."""
