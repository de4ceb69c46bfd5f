"""Points spread over a sphere."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float


def on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Return points (n, 3) spread over the unit sphere, along a spiral."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    return np.column_stack([np.sqrt(1.0 - height**2)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), height])
