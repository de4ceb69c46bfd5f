"""Options for hand, object and grasps; `problem.load` reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import DisallowNone, arg

from grasp_refine.problem.spec import ProblemSpec, ScanSpec, SourceSpec
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task_spec import TaskSpec
from grasp_refine_apps.commands.format_names import FormatName
from grasp_refine_apps.commands.option_rules import OptionGroup

HAND = OptionGroup(
    "hand",
    "The hand, and the arm that carries it.",
    (
        "hand",
        "transfer_from",
        "arm",
        "mount",
        "mount_pose",
        "urdf",
        "mjcf",
        "collision",
        "base_link",
        "follower_limits",
        "hull_limit",
    ),
)
OBJECT = OptionGroup(
    "object",
    "The object. Its mesh must be watertight, and its size that of a thing to grasp.",
    ("object", "object_name", "objects", "scale", "unit", "holes", "threshold", "other_object"),
)
SCAN = OptionGroup(
    "scan",
    "An object that was only seen: what saw it, and the solids that it may be.",
    tuple(ScanSpec.__dataclass_fields__),
)
TASK = OptionGroup(
    "task",
    "What the grasps must do, and where: recorded in results, and simulated where that is asked for.",
    tuple(TaskSpec.__dataclass_fields__),
)
OF_FILES = ("format", "index", "as_is")


@dataclass(frozen=True)
class Sources(SourceSpec):
    """Hand and objects: the fields of `SourceSpec`, as options."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "What is read of the files.", OF_FILES),
        HAND,
        OBJECT,
        SCAN,
        TASK,
    )
    metavars: ClassVar[Mapping[str, str]] = {
        "task": "NAME|FILE",
        "protocol": "NAME|FILE.toml",
        "urdf": "FILE",
        "mjcf": "FILE",
        "collision": "visual",
        "base_link": "LINK",
        "mount": "LINK",
        "mount_pose": "POSE",
        "base": "POSE",
        "scene": "NAME|FILE",
        "transfer_from": "HAND",
        "touch": "REGION",
        "avoid": "REGION",
        "table": "Z",
        "grasps": "FILE|sample:N",
        "seen_from": "X,Y,Z",
        "camera": "POSE|FILE",
        "intrinsics": "FX,FY,CX,CY|FILE",
        "mask": "FILE",
        "completions": "FOLDER",
    }

    format: FormatName | None = None
    task: str | None = None
    protocol: Annotated[
        DisallowNone[str | None],
        arg(
            metavar="NAME|FILE.toml",
            help="Protocol of the simulation, or a TOML file of your own; by default dexgraspbench, in a scene scene. "
            + "; ".join(f"{name}: {protocol.summary}" for name, protocol in PROTOCOLS.items())
            + ".",
            help_behavior_hint="",
        ),
    ] = None
    table: float | None = None
    scene: str | None = None
    base: str | None = None
    touch: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inputs(Sources, ProblemSpec):
    """Hand, object and grasps: the fields of `ProblemSpec`, as options."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "The grasps to begin from.", ("grasps", "targets", *OF_FILES)),
        HAND,
        OBJECT,
        SCAN,
        TASK,
    )
