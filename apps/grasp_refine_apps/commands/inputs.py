"""Options for hand, object and grasps; `problem.load` reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from grasp_refine.problem.spec import ProblemSpec, SourceSpec
from grasp_refine_apps.commands.format_names import FormatName
from grasp_refine_apps.commands.option_rules import OptionGroup

HAND = OptionGroup(
    "hand",
    "The hand, and the arm that carries it.",
    ("hand", "arm", "mount", "mount_pose", "urdf", "mjcf", "collision", "base_link", "follower_limits", "hull_limit"),
)
OBJECT = OptionGroup(
    "object",
    "The object. Its mesh must be watertight, and its size that of a thing to grasp.",
    ("object", "object_name", "objects", "scale", "unit", "holes", "threshold", "other_object"),
)
AROUND = OptionGroup(
    "surroundings",
    "What is around the object, where the arm stands, and which regions links should touch.",
    ("scene", "table", "base", "touch", "avoid"),
)
OF_FILES = ("format", "index", "as_is")


@dataclass(frozen=True)
class Sources(SourceSpec):
    """Hand and objects: the fields of `SourceSpec`, as options."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "What is read of the files.", OF_FILES),
        HAND,
        OBJECT,
        AROUND,
    )
    metavars: ClassVar[Mapping[str, str]] = {
        "urdf": "FILE",
        "mjcf": "FILE",
        "collision": "visual",
        "base_link": "LINK",
        "mount": "LINK",
        "mount_pose": "POSE",
        "base": "POSE",
        "scene": "NAME|FILE",
        "touch": "REGION",
        "avoid": "REGION",
        "table": "Z",
        "grasps": "FILE|sample:N",
    }

    format: FormatName | None = None


@dataclass(frozen=True)
class Inputs(Sources, ProblemSpec):
    """Hand, object and grasps: the fields of `ProblemSpec`, as options."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "The grasps to begin from.", ("grasps", "targets", *OF_FILES)),
        HAND,
        OBJECT,
        AROUND,
    )
