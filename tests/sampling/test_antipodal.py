"""Antipodal grasps of grippers with two jaws: both jaws touch opposite sides, within the stroke, from any side."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.sampling.antipodal import FRICTION, antipodal_pairs
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import JawFrame, jaw_frame
from grasp_refine.sampling.sample import CONTACT_DISTANCE_M, sample_grasps
from grasp_refine.scene.hand_object import HandObject
from plate_gripper import URDF


@pytest.fixture(scope="module")
def franka() -> Hand:
    return load_hand("franka_hand", candidates=512)


@pytest.fixture(scope="module")
def plates(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Two jaws, each with an actuator of its own, and contacts that are guessed."""
    path: Path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF)
    return load_hand(path, candidates=512)


@pytest.fixture(scope="module")
def box() -> Object:
    return load_object("box:0.04,0.06,0.1", candidates=512)


def frame_of(hand: Hand) -> JawFrame:
    found = jaw_frame(hand, closure_frame(hand))
    assert found is not None
    return found


def test_the_width_of_plates_is_the_distance_between_them(plates: Hand) -> None:
    jaws = frame_of(plates)
    np.testing.assert_allclose(jaws.width[[0, -1]], [0.17, 0.03], atol=1e-9)
    np.testing.assert_allclose(np.abs(jaws.axis), [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(jaws.q[[0, -1]], [[0.0, 0.0], [0.07, -0.07]], atol=1e-12)
    np.testing.assert_allclose(jaws.center[:, 0], 0.0, atol=1e-9)
    # The plates are 3 cm broad and 6 cm long.
    assert 0.012 < jaws.half_breadth <= 0.015 and 0.027 < jaws.half_length <= 0.03
    q, center = jaws.at(np.array([0.1, 0.5]))
    np.testing.assert_allclose(q, [[0.035, -0.035], [0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(center[:, 0], 0.0, atol=1e-9)


def test_poses_bring_the_middle_of_the_pads_to_a_point(franka: Hand) -> None:
    jaws = frame_of(franka)
    axis, way = np.array([[0.0, 0.6, 0.8]]), np.array([[1.0, 0.0, 0.0]])
    _, center = jaws.at(np.array([0.03]))
    T = jaws.poses(np.array([[0.1, 0.2, 0.3]]), axis, way, center)[0]
    np.testing.assert_allclose(T[:3, :3] @ center[0] + T[:3, 3], [0.1, 0.2, 0.3], atol=1e-12)
    found = np.stack([jaws.axis, jaws.approach]) @ T[:3, :3].T
    np.testing.assert_allclose(found, [axis[0], way[0]], atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["allegro", "leap", "shadow_palm"])
def test_hands_of_more_fingers_are_no_jaws(name: str) -> None:
    hand = load_hand(name, candidates=64)
    assert jaw_frame(hand, closure_frame(hand)) is None


def test_two_fingers_side_by_side_are_no_jaws(plates: Hand) -> None:
    """Both plates belong to one finger, or one of them does not move."""
    one = replace(plates, contacts=tuple(replace(contact, group="finger") for contact in plates.contacts))
    assert jaw_frame(one, closure_frame(one)) is None
    closure = closure_frame(plates)
    assert jaw_frame(plates, replace(closure, closing=np.zeros(2))) is None


def test_pairs_lie_in_both_friction_cones_and_in_the_stroke(box: Object) -> None:
    pairs = antipodal_pairs(box, (0.03, 0.08))
    x, n = box.body.candidates.points, box.body.candidates.normals
    line = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(line, axis=1)
    assert len(pairs) > 100 and (length > 0.03).all() and (length < 0.08).all()
    for side, sign in ((0, -1.0), (1, 1.0)):
        along = sign * (line * n[pairs[:, side]]).sum(axis=1)
        across = np.linalg.norm(line - sign * along[:, None] * n[pairs[:, side]], axis=1)
        assert (across <= FRICTION * along * (1 + 1e-9)).all()
    # The long side is longer than the stroke; each pair is there in both orders.
    inner = np.abs(n[pairs[:, 0]]).max(axis=1) > 0.999
    assert (np.abs(n[pairs[inner, 0], 2]) < 0.5).all()
    assert {(a, b) for a, b in pairs.tolist()} == {(b, a) for a, b in pairs.tolist()}


@pytest.mark.parametrize("hand", ["franka", "plates"])
@pytest.mark.parametrize("source", ["box:0.04,0.06,0.1", "sphere:0.025"])
def test_both_jaws_touch_opposite_sides(hand: str, source: str, request: pytest.FixtureRequest) -> None:
    gripper: Hand = request.getfixturevalue(hand)
    obj = load_object(source, candidates=512)
    grasps = sample_grasps(gripper, obj, 16)
    prepared = HandObject(gripper, obj)
    T = transform_from_pose(grasps.hand_pose)
    links = prepared.chain(T, grasps.q).T_world_link
    found = query(prepared.pairs, links, np.broadcast_to(np.eye(4), links.shape))
    assert len(grasps) == 16 and (found.distance[:, :2] <= CONTACT_DISTANCE_M).all() and found.distance.min() > 0.0
    assert ((found.normal[:, 0] * found.normal[:, 1]).sum(axis=1) < -0.9).all()
    jaws = frame_of(gripper)
    axis = T[:, :3, :3] @ jaws.axis
    assert (np.abs((found.normal[:, :2] * axis[:, None]).sum(axis=-1)) > np.cos(np.arctan(FRICTION))).all()
    assert (grasps.q >= gripper.lower - 1e-12).all() and (grasps.q <= gripper.upper + 1e-12).all()
    # Approach directions are all around the axis.
    way = T[:, :3, :3] @ jaws.approach
    assert np.linalg.norm(way.mean(axis=0)) < 0.7


def test_what_is_wider_than_the_stroke_is_taken_where_it_is_thin(franka: Hand) -> None:
    """A plate of 12 x 12 x 1 cm fits between the jaws in one direction only."""
    grasps = sample_grasps(franka, load_object("box:0.12,0.12,0.01", candidates=1024), 6)
    jaws = frame_of(franka)
    axis = transform_from_pose(grasps.hand_pose)[:, :3, :3] @ jaws.axis
    assert (np.abs(axis[:, 2]) > 0.99).all()
    np.testing.assert_allclose(2.0 * grasps.q[:, 0], 0.01, atol=2.5e-3)
