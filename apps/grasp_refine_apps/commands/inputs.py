"""Options for the grasps to refine: from a file, the hand's example, or sampled; `pipeline.load` reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import DisallowNone, arg

from grasp_refine.pipeline.spec import ProblemSpec
from grasp_refine_apps.commands.sources import Sources


@dataclass(frozen=True)
class Inputs(Sources, ProblemSpec):
    """Hand, object and grasps: the fields of `ProblemSpec`, as options."""

    grasps: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE|sample:N", help_behavior_hint="(default: the hand's example)")
    ] = None
