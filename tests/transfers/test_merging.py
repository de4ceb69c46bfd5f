"""Merging: fingers that press against the thumb become one, at the middle of their contacts on the object."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.objects.object import load_object
from grasp_refine.transfers.merging import merged
from grasp_refine.transfers.source_grasps import SourceGrasps

RADIUS = 0.03


def grasps(normals: list[list[float] | None], heights: list[float]) -> SourceGrasps:
    """One grasp of a cylinder, whose fingers touch where its normal is as given, at heights."""
    normal = np.array([[[np.nan] * 3 if one is None else one for one in normals]], dtype=float)
    point = RADIUS * normal + np.array([0.0, 0.0, 1.0]) * np.array(heights)[None, :, None]
    weight = np.where(np.isnan(normal[..., 0]), 0.0, 1.0)
    names = ("thumb", "index", "middle", "ring")[: len(normals)]
    return SourceGrasps(names, "side", point, normal, weight, np.zeros((1, 3)), np.eye(3)[None])


@pytest.mark.parametrize(
    ("normals", "heights", "height"),
    [
        ([[-1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], [0.0, -0.02, 0.0, 0.01], -0.01 / 3),
        ([[-1, 0, 0], [1, 0, 0], [-1, 0, 0], None], [0.0, 0.02, -0.03, 0.0], 0.02),
        ([None, [1, 0, 0], [1, 0, 0], None], [0.0, 0.02, 0.01, 0.0], 0.015),
    ],
    ids=["all oppose", "one beside the thumb", "without a thumb"],
)
def test_opposed_fingers_become_one_in_their_middle(normals: list, heights: list[float], height: float):
    found = merged(grasps(normals, heights), load_object(f"cylinder:{RADIUS},0.1"))
    assert found.fingers == ("thumb", "fingers")
    np.testing.assert_allclose(found.point[0, 1], [RADIUS, 0.0, height], atol=3e-4)
    np.testing.assert_allclose(found.normal[0, 1], [1.0, 0.0, 0.0], atol=0.05)
    assert found.touching.tolist() == [[normals[0] is not None, True]]
