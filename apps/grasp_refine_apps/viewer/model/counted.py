"""Links whose gaps a text is on: the contact links of a grasp, or links that an iteration closes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.measures.measures import MEASURES

REMAINING = "remaining gap"
"""Name of the largest gap of the links that an iteration of a refinement closes, which differ from the input's."""


@dataclass(frozen=True, eq=False)
class Counted:
    """Links that should touch the object, and their gaps."""

    gap: Float[np.ndarray, " L"]
    """Gap (L,) in metres that each should keep, as `contact_gaps`; NaN for links that need not touch."""
    iteration: bool = False
    """Whether an iteration closes them; False: they are the contact links of a grasp."""

    @property
    def title(self) -> str:
        """Name of their largest gap, or miss of a target."""
        return REMAINING if self.iteration else MEASURES["contact_error_m"].title
