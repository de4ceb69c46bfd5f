"""Margins whose numbers are chosen, for tests of what shows and writes them."""

from __future__ import annotations

import numpy as np

from grasp_refine.validation.margins.limits import Limits
from grasp_refine.validation.margins.margins import Margins


def made_margins(better: int = 0) -> Margins:
    """Three grasps in 8 draws, of each factor alone in 4; with `better`, so many more draws are held by all."""

    def held(counts: list[int], of: int) -> np.ndarray:
        return np.arange(of) < np.minimum(np.array(counts) + better, of)[:, None]

    return Margins(
        held={
            "all": held([2, 6, 8], 8),
            "push": held([3, 4, 4], 4),
            "friction": held([2, 4, 4], 4),
            "mass": held([3, 1, 4], 4),
        },
        limits=Limits(
            friction=np.array([np.nan, 0.4, 0.1]), force=np.array([0.0, 2.0, 5.0]), torque=np.array([0.0, 0.1, 0.3])
        ),
        cpu_s=np.array([1.0, 2.0, 3.0]),
    )
