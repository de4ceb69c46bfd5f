"""Poses as people write them."""

import numpy as np
import pytest

from grasp_refine.core.rpy_poses import rpy_from_transform, transform_from_rpy


@pytest.mark.parametrize("pose", [[0.1, -0.2, 0.3, 20, -50, 170], [0, 0, 1, 30, 90, 0], [0, 0, 0, -40, -90, 0]])
def test_poses_are_written_as_they_are_read(pose: list[float]) -> None:
    np.testing.assert_allclose(
        transform_from_rpy(rpy_from_transform(transform_from_rpy(pose))), transform_from_rpy(pose), atol=1e-12
    )
