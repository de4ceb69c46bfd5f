"""Options for hand, object and grasps; `problem.load` reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, UseAppendAction, arg

from grasp_refine.geometry.units import Unit
from grasp_refine.problem.spec import ProblemSpec, SourceSpec
from grasp_refine_apps.commands.format_names import FormatName
from grasp_refine_apps.commands.options import INDICES


@dataclass(frozen=True)
class Sources(SourceSpec):
    """Hand and objects: the fields of `SourceSpec`, as options."""

    hand: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    urdf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    mjcf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    collision: Annotated[
        DisallowNone[Literal["visual"] | None], arg(metavar="visual", help_behavior_hint="(default: see above)")
    ] = None
    follower_limits: Annotated[
        DisallowNone[Literal["own", "leader"] | None], arg(help_behavior_hint="(default: see above)")
    ] = None
    base_link: Annotated[DisallowNone[str | None], arg(metavar="LINK", help_behavior_hint="(default: see above)")] = (
        None
    )
    arm: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: none, the hand floats)")] = None
    mount: Annotated[DisallowNone[str | None], arg(metavar="LINK", help_behavior_hint="(default: see above)")] = None
    mount_pose: Annotated[DisallowNone[str | None], arg(metavar="POSE", help_behavior_hint="(default: see above)")] = (
        None
    )
    base: Annotated[DisallowNone[str | None], arg(metavar="POSE", help_behavior_hint="(default: none)")] = None
    object: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    object_name: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the only one)")] = None
    objects: Annotated[DisallowNone[Path | None], arg(help_behavior_hint="(default: none)")] = None
    unit: Annotated[DisallowNone[Unit | None], arg(help_behavior_hint="(default: m, asked about if unlikely)")] = None
    format: Annotated[DisallowNone[FormatName | None], arg(help_behavior_hint="(default: detected)")] = None
    index: Annotated[tuple[int, ...], INDICES, arg(help_behavior_hint="(default: all)")] = ()
    scene: Annotated[DisallowNone[str | None], arg(metavar="NAME|FILE", help_behavior_hint="(default: none)")] = None
    touch: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="REGION", help_behavior_hint="(default: anywhere)")
    ] = ()
    avoid: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="REGION", help_behavior_hint="(default: none)")] = ()
    table: Annotated[DisallowNone[float | None], arg(metavar="Z", help_behavior_hint="(default: none)")] = None
    other_object: Annotated[bool, arg(help_behavior_hint="")] = False
    as_is: Annotated[bool, arg(help_behavior_hint="")] = False


@dataclass(frozen=True)
class Inputs(Sources, ProblemSpec):
    """Hand, object and grasps: the fields of `ProblemSpec`, as options."""

    grasps: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE|sample:N", help_behavior_hint="(default: the hand's example)")
    ] = None
