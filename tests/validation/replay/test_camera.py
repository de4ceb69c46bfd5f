"""Where points are in the picture of a camera."""

import numpy as np
import pytest

from grasp_refine.validation.replay.camera import View


def test_a_view_shows_all_that_it_was_fitted_to() -> None:
    points = np.random.default_rng(3).normal(size=(50, 3)) * [0.1, 0.02, 0.05] + [1.0, 2.0, 3.0]
    for azimuth, elevation in ((0, 0), (90, -30), (200, 40)):
        view = View(float(azimuth), float(elevation), np.zeros(3), 1.0).fit(points, 1.5)
        pixels = view.project(points, 600, 400)
        assert (pixels >= [40, 25]).all() and (pixels <= [560, 375]).all()
        touching = [abs(pixels[:, 0] - 300).max() / 300, abs(pixels[:, 1] - 200).max() / 200]
        assert max(touching) == pytest.approx(0.84), "no farther away than it must be"
        np.testing.assert_allclose(view.axes() @ view.axes().T, np.eye(3), atol=1e-12)
    ahead = View(90.0, 0.0, np.zeros(3), 1.0)
    right_of_it, above_it = ahead.project(np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.1]]), 600, 400)
    assert right_of_it[0] > 300 and above_it[1] < 200
