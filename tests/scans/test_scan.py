"""Scans: which surface counts as seen."""

import numpy as np
import pytest

from grasp_refine.scans.scan import NEAR_M, Scan


def scan(points: np.ndarray, noise_m: float = 0.0) -> Scan:
    count = len(points)
    return Scan(
        points, np.tile([0.0, 0.0, 1.0], (count, 1)), np.array([[0.0, 0.0, 1.0]]), np.zeros(count, int), noise_m
    )


GRID = np.stack([*np.meshgrid(np.arange(5) * 0.004, np.arange(5) * 0.004), np.zeros((5, 5))], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(("noise", "reach"), [(0.0, 0.008), (0.004, 0.012)])
def test_surface_near_points_counts_as_seen(noise: float, reach: float):
    points = np.array([[0.0, 0.0, reach - 1e-6], [0.0, 0.0, reach + 1e-6], [0.016 + reach + 1e-6, 0.0, 0.0]])
    assert scan(GRID, noise).seen(points).tolist() == [True, False, False]
    assert scan(GRID, noise).seen(points.reshape(1, 3, 3)).shape == (1, 3)


def test_of_dense_points_a_least_distance_counts_and_nan_is_not_seen():
    dense = scan(GRID * 0.01)
    assert dense.seen(np.array([[0.0, 0.0, NEAR_M - 1e-6], [np.nan, 0.0, 0.0]])).tolist() == [True, False]
