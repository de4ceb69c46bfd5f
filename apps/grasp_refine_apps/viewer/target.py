"""Target point of a link on the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Target:
    """Target point of a link on the object."""

    link: str
    """Name of the link."""
    point_link: Float[np.ndarray, " 3"]
    """The point on it (3,), link frame, metres."""
    point_object: Float[np.ndarray, " 3"]
    """The point on the object (3,), its frame, metres."""
