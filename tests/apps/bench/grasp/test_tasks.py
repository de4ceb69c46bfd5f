"""Tasks: true grasps touch, disturbances are what they say, and no task depends on the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_se3, transform_from_pose, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import hull
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.grasp.presets import Variant
from grasp_refine_apps.bench.grasp.tasks import (
    Disturbance,
    Tasks,
    given_targets,
    slice_body,
    true_grasps,
)
from shapes_for_tests import convex_body


@pytest.fixture(scope="module")
def group() -> Tasks:
    """The example grasps of the embedded hand on the embedded box."""
    grasps = load_grasps(resource_dir("robots") / "allegro/example_rounded_box.npz")
    hand, box = load_hand("allegro", candidates=256), load_object("rounded_box", candidates=256)
    return Tasks("box", 1.0, Scene(hand, box, transform_from_pose(grasps.hand_pose), grasps.q), np.arange(len(grasps)))


@pytest.fixture(scope="module")
def true(group: Tasks) -> Tasks:
    return true_grasps(group)


def test_true_grasps_touch_with_every_fingertip_where_their_targets_are(true: Tasks):
    scene = true.scene
    hand, tips = scene.hand, [contact.link for contact in scene.hand.contacts]
    assert len(true) >= 3 and len(set(tips)) == 4
    T = Kinematics(hand, tips)(torch.tensor(scene.T_world_root), torch.tensor(scene.q)).numpy()
    pairs = Pairs.against([hand.links_by_name[tip].body for tip in tips], scene.object.body)
    found = query(pairs, T, np.broadcast_to(np.eye(4), T.shape))
    assert np.abs(found.distance).max() < 1e-5
    assert scene.links[:4] == tuple(tips)
    np.testing.assert_allclose(transform_points(T, scene.target_link[:, :4]), found.point_a, atol=1e-9)
    np.testing.assert_allclose(scene.target_object[:, :4], found.point_b, atol=1e-9)
    assert np.isnan(scene.target_link[:, 4:]).all() and np.isnan(scene.target_object[:, 4:]).all()
    assert ((scene.q >= hand.lower) & (scene.q <= hand.upper)).all()


def test_a_disturbance_is_as_large_as_it_says(true: Tasks):
    scene = true.scene
    keys = [(0, i) for i in range(len(true))]
    T, q = Disturbance(0.02, np.radians(15.0), 0.2).apply(scene.hand, scene.T_world_root, scene.q, keys)
    moved = np.linalg.norm(T[:, :3, 3] - scene.T_world_root[:, :3, 3], axis=1)
    np.testing.assert_allclose(moved, 0.02, rtol=1e-12)
    R = T[:, :3, :3] @ scene.T_world_root[:, :3, :3].mT
    angle = np.arccos((np.trace(R, axis1=1, axis2=2) - 1.0) / 2.0)
    np.testing.assert_allclose(np.degrees(angle), 15.0, rtol=1e-9)
    assert ((q >= scene.hand.lower) & (q <= scene.hand.upper)).all()
    still, same = Disturbance(0.02, 0.0, 0.0).apply(scene.hand, scene.T_world_root, scene.q, keys)
    np.testing.assert_array_equal(same, scene.q)
    np.testing.assert_allclose(still[:, :3, :3], scene.T_world_root[:, :3, :3], atol=1e-15)


def test_a_task_does_not_depend_on_how_many_others_there_are(group: Tasks):
    few, many, other = (
        given_targets("box", (group,), count, Disturbance(), seed)[0] for count, seed in ((2, 0), (7, 0), (2, 1))
    )
    for name in ("T_world_root", "q", "target_link", "target_object"):
        np.testing.assert_array_equal(getattr(few.scene, name), getattr(many.scene, name)[:2])
    np.testing.assert_array_equal(few.index, many.index[:2])
    assert len(many) == 7
    assert np.abs(few.scene.q - other.scene.q).max() > 0.01
    # The same grasp again is disturbed in another way.
    again = np.flatnonzero(many.index == many.index[0])
    assert len(again) > 1 and np.abs(np.diff(many.scene.q[again], axis=0)).max() > 0.01


def test_contacts_are_left_out_from_the_last_finger_on(true: Tasks):
    aimed = ~np.isnan(true.scene.target_object[..., 0])
    for count in (1, 3, 4):
        scene = true.of(Variant(contacts=count)).scene
        for target, before in (
            (scene.target_link, true.scene.target_link), (scene.target_object, true.scene.target_object),
        ):  # fmt: skip
            kept = ~np.isnan(target[..., 0])
            np.testing.assert_array_equal(kept, aimed & (np.cumsum(aimed, axis=1) <= count))
            np.testing.assert_array_equal(target[kept], before[kept])
    assert true.of(Variant(contacts=5)) is None
    assert true.of(Variant()).scene is true.scene


def test_only_a_convex_object_is_cut(true: Tasks):
    cut = true.of(Variant(pieces=8))
    assert len(cut.scene.object.body.pieces) == 8 and cut.scene.object.name == true.scene.object.name
    ball = load_object("sphere:0.03")
    assert replace(true, scene=replace(true.scene, object=ball)).of(Variant(pieces=8)) is None
    # Cut once, it is no longer one piece.
    assert cut.of(Variant(pieces=16)) is None


# slices


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_slices_make_up_the_body(count: int):
    body = convex_body(3, 60)
    cut = slice_body(body, count)
    assert len(cut.pieces) == count and cut.candidates is body.candidates
    whole = volume(body.pieces[0].vertices, body.pieces[0].faces)
    assert sum(volume(piece.vertices, piece.faces) for piece in cut.pieces) == pytest.approx(whole, rel=1e-9)
    # No slice is much longer than the others.
    longest = [np.ptp(piece.bounds, axis=0).max() for piece in cut.pieces]
    assert count < 8 or max(longest) < 2.5 * min(longest)
    # A box in two is known.
    halves = slice_body(build_body("box", [hull(np.indices((2, 2, 2)).reshape(3, -1).T * [4.0, 1.0, 1.0])]), 2)
    assert sorted(piece.bounds[:, 0].tolist() for piece in halves.pieces) == [[0.0, 2.0], [2.0, 4.0]]


def test_distances_outside_stay_the_same_and_penetration_gets_shallower():
    body, other = convex_body(3, 60), convex_body(4, 30)
    rng = np.random.default_rng(0)
    T_a, T_b = (exp_se3(rng.normal(size=(200, 1, 6)) * ([0.05] * 3 + [1.0] * 3)) for _ in range(2))
    whole = query(Pairs((body,), (other,)), T_a, T_b).distance
    parts = query(Pairs((slice_body(body, 16),), (other,)), T_a, T_b).distance
    apart = whole > 0
    assert 20 < apart.sum() < 180
    np.testing.assert_allclose(parts[apart], whole[apart], atol=1e-8)
    assert (parts[~apart] >= whole[~apart] - 1e-6).all() and (parts[~apart] <= 1e-7).all()
