"""Geometric measures in closed form: a hand of balls on a ball."""

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.geometry import Geometry, measure, movement
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.hand_object import HandObject
from made_hands import link, links, made_hand, slide, solid

RADIUS, OBJECT = 0.01, 0.05
"""Of the links' balls and of the object, in metres."""

SHORT = {"limits": (-0.1, 0.1)}
PARTS = (
    link("base"),
    links("left", "right", "middle", inside=solid(f"sphere {RADIUS}")),
    slide("l", "base", "left", at="0.1 0 0", axis="1 0 0", **SHORT),
    slide("r", "base", "right", at="-0.1 0 0", axis="1 0 0", **SHORT),
    slide("m", "base", "middle", at="0 0.2 0", rpy="0.3 0.5 1", axis="0 0 1", limits=(-0.05, 0.05)),
)
"""Three balls on slides: two along x, 10 cm from the origin, and one at y = 20 cm."""

LINKS = ("left", "right", "middle")


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return made_hand(tmp_path_factory.mktemp("hand"), *PARTS, name="sliders", candidates=64)


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object(f"sphere:{OBJECT}", candidates=64)


def poses(count: int) -> np.ndarray:
    return np.tile(np.eye(4), (count, 1, 1))


def nothing(count: int) -> np.ndarray:
    return np.full((count, len(LINKS), 3), np.nan)


def measured(hand: Hand, ball: Object, q: np.ndarray, T: np.ndarray | None = None) -> Geometry:
    count = len(q)
    return measure(HandObject(hand, ball), poses(count) if T is None else T, q, nothing(count), nothing(count))


def test_distances_are_as_in_balls(hand: Hand, ball: Object) -> None:
    q = np.array([[0.0, 0.0, 0.0], [-0.04, 0.045, 0.0], [-0.06, 0.03, 0.0]])
    found = measured(hand, ball, q)
    left, right = 0.1 + q[:, 0], 0.1 - q[:, 1]
    expected = np.stack([left, right, np.full(3, 0.2)], axis=1) - RADIUS - OBJECT
    np.testing.assert_allclose(found.distance, expected, atol=1e-9)
    np.testing.assert_allclose(found.penetration, [0.0, 0.005, 0.02], atol=1e-9)
    np.testing.assert_allclose(found.witness.point_b[:, 0], np.tile([OBJECT, 0, 0], (3, 1)), atol=1e-9)
    assert np.isnan(found.contact_error).all(), "nobody said where to touch"


def test_the_object_is_at_the_origin_and_the_pose_is_that_of_the_hand(hand: Hand, ball: Object) -> None:
    T = poses(1)
    T[0, :3, 3] = [0.02, 0.0, 0.0]
    found = measured(hand, ball, np.zeros((1, 3)), T)
    np.testing.assert_allclose(found.distance[0], [0.06, 0.02, np.hypot(0.2, 0.02) - 0.06], atol=1e-9)


def test_contact_error_is_the_largest_of_gap_and_misses(hand: Hand, ball: Object) -> None:
    q = np.array([[-0.037, 0.0, 0.0]])  # a gap of 3 mm at the left link
    target_link, target_object = nothing(1), nothing(1)
    # The link touches with its side at -x; the object at +x.
    target_link[0, 0], target_object[0, 0] = [-RADIUS, 0, 0], [OBJECT, 0, 0]

    def error(margin: float = 0.0) -> float:
        found = measure(HandObject(hand, ball), poses(1), q, target_link, target_object, margin)
        assert np.isnan(found.contact_error[0, 1:]).all()
        return float(found.contact_error[0, 0])

    assert error() == pytest.approx(0.003, abs=1e-9)
    assert error(margin=0.003) == pytest.approx(0.0, abs=1e-9)
    assert error(margin=0.01) == pytest.approx(0.007, abs=1e-9)
    target_link[0, 0] = [0, RADIUS, 0]
    assert error() == pytest.approx(RADIUS * np.sqrt(2), abs=1e-9)
    target_object[0, 0] = [0, 0, -OBJECT]
    assert error() == pytest.approx(OBJECT * np.sqrt(2), abs=1e-9)


def test_targets_move_with_the_link_and_not_with_the_hand(hand: Hand, ball: Object) -> None:
    turn = exp_se3(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))[None]
    target_link, target_object = nothing(1), nothing(1)
    # Turned by a quarter about z the left link is at y = 10 cm, and its own -x side still looks at the object.
    target_link[0, 0], target_object[0, 0] = [-RADIUS, 0, 0], [0, OBJECT, 0]
    found = measure(HandObject(hand, ball), turn, np.zeros((1, 3)), target_link, target_object)
    assert found.contact_error[0, 0] == pytest.approx(0.04, abs=1e-9)


def test_limits_are_counted_with_a_tolerance(hand: Hand, ball: Object) -> None:
    q = np.array([[0.1, -0.1, 0.05], [0.1 + 5e-7, -0.1 - 5e-7, 0.0], [0.11, -0.2, 0.0], [0.0, 0.2, 0.06]])
    np.testing.assert_array_equal(measured(hand, ball, q).limits_violated, [0, 0, 2, 2])


def test_a_grasp_that_is_not_finite_has_no_measures_and_spoils_no_other(hand: Hand, ball: Object) -> None:
    q, T = np.zeros((3, 3)), poses(3)
    q[1, 2] = np.nan
    T[2, 0, 3] = np.inf
    found = measured(hand, ball, q, T)
    np.testing.assert_array_equal(found.distance[0], measured(hand, ball, q[:1]).distance[0])
    assert np.isnan(found.distance[1:]).all() and np.isnan(found.penetration[1:]).all()
    assert np.isfinite(found.distance[0]).all() and found.penetration[0] == 0.0


def test_movement_of_palm_and_joints() -> None:
    rng = np.random.default_rng(0)
    before = exp_se3(rng.normal(size=(4, 6)))
    move = np.zeros((4, 6))
    move[0, 3:], move[1, 3:], move[2, 3:] = [0, 0, 0.3], [np.pi, 0, 0], [0, 1e-9, 0]
    after = before @ exp_se3(move)
    after[:, :3, 3] = before[:, :3, 3] + [[0, 0, 0], [0.003, 0.004, 0], [0, 0, 0], [0, 0, -1.0]]
    q = rng.normal(size=(4, 3))
    shift = np.array([[0.1, -0.2, 0], [0, 0, 0], [0.5, 0, 0], [0, 0, -0.3]])
    found = movement(before, q, after, q + shift, np.array([False, False, True]))
    np.testing.assert_allclose(found.palm_m, [0, 0.005, 0, 1.0], atol=1e-12)
    np.testing.assert_allclose(found.palm_rad, [0.3, np.pi, 1e-9, 0], atol=1e-12)
    np.testing.assert_allclose(found.joints_rad, [0.2, 0, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(found.slides_m, [0, 0, 0, 0.3], atol=1e-12)


def test_movement_of_what_is_not_finite_is_unknown() -> None:
    T = poses(2)
    T[1, 0, 0] = np.nan
    found = movement(poses(2), np.zeros((2, 1)), T, np.zeros((2, 1)), np.array([False]))
    np.testing.assert_array_equal(np.isnan(found.palm_m), [False, True])
    np.testing.assert_array_equal(np.isnan(found.palm_rad), [False, True])
    assert found.joints_rad.tolist() == [0.0, 0.0] and np.isnan(found.slides_m).all(), "the hand has no slides"
