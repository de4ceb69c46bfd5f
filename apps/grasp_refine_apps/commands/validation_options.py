"""Options of the validation in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.protocol import SETTINGS, Protocol, SettingName


@dataclass(frozen=True)
class ValidationOptions:
    """Validation in simulation; `refine-grasp validate` can do more."""

    validate: bool = False
    """Simulate the grasps before and after: does the object stay in the hand when it is pushed?"""
    setting: SettingName = "force-closure"
    """Protocol: force-closure (friction 0.6), strict (friction 0.3), or tabletop (lifted off a table)."""
    friction: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: that of the setting)")] = None
    """Coefficient of sliding friction."""

    def protocol(self) -> Protocol | None:
        """Return the protocol of the simulation; None: grasps are not simulated.

        Raises:
            GraspRefineError: an option that is invalid, or has no effect.
        """
        if not self.validate and self != ValidationOptions():
            raise GraspRefineError("--setting and --friction are for --validate, which simulates the grasps")
        if self.friction is not None and not 0 < self.friction < inf:
            raise GraspRefineError(f"--friction must be above 0, got {self.friction:g}")
        return SETTINGS[self.setting].slippery(self.friction) if self.validate else None
