"""Measures of grasps whose contacts are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.grasp.measures import measure_grasps


@pytest.fixture(scope="module")
def scene() -> Scene:
    grasps = load_grasps(resource_dir("robots") / "allegro/example_rounded_box.npz")
    hand, box = load_hand("allegro", candidates=256), load_object("rounded_box", candidates=256)
    return Scene(hand, box, transform_from_pose(grasps.hand_pose), grasps.q)


def test_a_contact_error_is_gap_and_both_misses_squared(scene: Scene):
    plain = measure_grasps(scene, scene.T_world_root, scene.q)
    assert np.isnan(plain.contact_error).all()
    on_link, on_object = plain.point_link.copy(), plain.point_object.copy()
    on_link[:, 1:], on_object[:, 1:] = np.nan, np.nan
    on_link[:, 0] += [0.0, 0.003, 0.0]
    on_object[:, 0] += [0.002, 0.0, 0.001]
    aimed = replace(scene, target_link=on_link, target_object=on_object)
    error = measure_grasps(aimed, scene.T_world_root, scene.q).contact_error
    np.testing.assert_allclose(error[:, 0], plain.distance[:, 0] ** 2 + 9e-6 + 5e-6, rtol=1e-9)
    assert np.isnan(error[:, 1:]).all()


def test_depths_and_limits_are_counted(scene: Scene):
    inside = scene.T_world_root.copy()
    inside[:, :3, 3] = 0.0
    q = np.tile(scene.hand.upper + 0.1, (len(inside), 1))
    found = measure_grasps(scene, inside, q)
    assert (found.penetration > 0.01).all()
    assert (found.limits_violated == q.shape[1]).all()
    np.testing.assert_allclose(found.penetration, -found.distance.min(axis=1))
