"""Shadows on the ground."""

import numpy as np

from grasp_refine_apps.viewer.drawing.ground import DARKNESS, shadow


def test_a_shadow_is_dark_below_the_points_and_only_there() -> None:
    """A bar along y, and a spot beside its end, seen from above: rows along y, columns along x."""
    bar = np.stack(np.meshgrid(np.linspace(-0.01, 0.01, 30), np.linspace(-0.1, 0.1, 200)), axis=-1).reshape(-1, 2)
    spot = np.stack(np.meshgrid(np.linspace(0.06, 0.08, 30), np.linspace(0.08, 0.1, 30)), axis=-1).reshape(-1, 2)
    flat = np.concatenate([bar, spot]) + (0.3, -0.2)
    image, middle, side = shadow(np.column_stack([flat, np.random.default_rng(0).uniform(0.0, 1.0, len(flat))]))
    np.testing.assert_allclose(middle, np.array([0.035, 0.0]) + (0.3, -0.2))
    assert 0.2 < side < 0.4

    def dark(x: float, y: float) -> float:
        column, row = ((np.array([x, y]) + (0.3, -0.2) - middle) / side + 0.5) * len(image)
        return image[int(row), int(column), 3] / (255 * DARKNESS)

    assert dark(0.0, 0.05) > 0.6 and dark(0.0, -0.05) > 0.6 and dark(0.07, 0.09) > 0.4
    assert dark(0.07, -0.09) < 0.05 and dark(0.07, 0.0) < 0.05
