"""Planes: heights of bodies above them, and their lowest points, in any pose."""

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, capsule, sphere
from grasp_refine.scene.plane import Plane
from refusals import refused

PLANE = Plane((0.6, 0.0, 0.8), 0.1)
BODIES = {
    "dice": [box([0.02, 0.03, 0.04])],
    "ball": [sphere(0.02, [0.01, 0.02, 0.03])],
    "finger": [capsule(0.01, [0, 0, 0], [0.02, 0.03, 0.05]), box([0.01, 0.01, 0.1])],
    "knob": [box([0.03, 0.03, 0.03]), sphere(0.02)],
}


def test_lowest_points_are_of_the_surface_and_nothing_is_below_them() -> None:
    bodies = [build_body(name, pieces, candidates=4000) for name, pieces in BODIES.items()]
    T = exp_se3(np.random.default_rng(0).normal(size=(5, len(BODIES), 6)))
    height, point = PLANE.heights(bodies, T)
    np.testing.assert_allclose(point @ PLANE.normal - 0.1, height, atol=1e-12)
    for column, body in enumerate(bodies):
        surface = transform_points(T[:, column, None], body.candidates.points[None])
        least = (surface @ PLANE.normal - 0.1).min(axis=1)
        assert (height[:, column] <= least + 1e-12).all() and (least - height[:, column] < 2e-3).all()
        away = np.linalg.norm(surface - point[:, column, None], axis=-1).min(axis=1)
        assert away.max() < 5e-3, "the point is on the surface"


@pytest.mark.parametrize("wrong", [{"normal": (0.0, 0.0, 2.0)}, {"normal": (0.0, 1.0)}, {"offset": "low"}])
def test_what_is_no_plane_is_refused(wrong: dict) -> None:
    with refused(GraspRefineError, next(iter(wrong))):
        Plane(**wrong)
