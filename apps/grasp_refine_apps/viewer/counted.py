"""Links whose contacts count in the contact error of a grasp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool


@dataclass(frozen=True, eq=False)
class Counted:
    """Links whose contacts count, by the file or by the refinement."""

    touching: Bool[np.ndarray, " L"]
    """Links (L,) that should touch, as `Scene.links`."""
    margin: float = 0.0
    """Gap in metres that they should keep."""
