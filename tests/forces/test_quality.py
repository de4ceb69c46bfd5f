"""Quality of grasps in closed form, and what may never make it better."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from claw import claw
from grasp_refine.collision.query import QueryStatus, Witness
from grasp_refine.core.se3 import exp_so3
from grasp_refine.forces.calibration import CALIBRATION
from grasp_refine.forces.programs import NUM_EDGES
from grasp_refine.forces.quality import (
    DEEP,
    LOADS,
    LOW_FRICTION,
    MOST_YIELDING,
    PUSH_SHARE,
    PUSHES,
    YIELDING_RAD_N,
    YIELDING_SHARE,
    Quality,
    quality,
)
from grasp_refine.forces.stiffness import CONTACT_STIFFNESS, TORSION_LEVER_M
from grasp_refine.forces.wrench import PLANNING_FRICTION
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.demand import TOTAL_PRESSURE_N, Demand
from grasp_refine.scene.scene import links_of


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"))


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"), coupled=True)


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object("sphere:0.03", candidates=16)


def touching(hand: Hand, point: list, normal: list, distance: list | None = None) -> tuple[Chain, Frames, Witness]:
    """Grasps (N) whose tips touch at points (N, C, 3); other links are far away."""
    chain = Chain(hand, links_of(hand))
    point, normal = np.array(point, dtype=float), np.array(normal, dtype=float)
    count, contacts = point.shape[:2]
    links = len(chain.links)
    gap = np.zeros((count, contacts)) if distance is None else np.array(distance, dtype=float)
    places, normals, gaps = np.zeros((count, links, 3)), np.zeros((count, links, 3)), np.full((count, links), np.inf)
    places[:, :contacts], normals[:, :contacts], gaps[:, :contacts] = point, normal, gap
    status = np.where(np.isfinite(gaps), np.where(gaps < 0, QueryStatus.PENETRATING, 0), QueryStatus.FAR)
    none = np.zeros((count, links), dtype=np.int64)
    witness = Witness(places - gaps[..., None].clip(-1, 1) * normals, places, normals, gaps, status, none, none)
    T = np.tile(np.eye(4), (count, 1, 1))
    return chain, chain(T, np.zeros((count, len(hand.joint_names)))), witness


OPPOSING = [[[0.03, 0, 0], [-0.03, 0, 0]]], [[[-1, 0, 0], [1, 0, 0]]]


def of(
    hand: Hand, obj: Object, point: list, normal: list, distance: list | None = None, demand: Demand | None = None
) -> Quality:
    return quality(hand, obj, *touching(hand, point, normal, distance), demand=demand)


# closed forms


def test_two_opposing_contacts_need_no_friction_but_for_what_pushes(free: Hand, ball: Object) -> None:
    """Of a push along y or z of 0.2 they take 0.15 cos 22.5 deg at least; of one along x they take all."""
    found = of(free, ball, *OPPOSING)
    assert found.slippery[0] == pytest.approx(0.0, abs=1e-4) and found.deep[0] == 0.0
    left = PUSH_SHARE - PLANNING_FRICTION
    assert 4 / 6 * left - 1e-4 <= found.pushed[0]
    # What x takes: pressures of 0.5 - 0.1 and 0.5 + 0.1 are not allowed, no contact carries more than half.
    most = 2 / 6 * PUSH_SHARE + 4 / 6 * (PUSH_SHARE - PLANNING_FRICTION * np.cos(np.pi / NUM_EDGES))
    assert found.pushed[0] <= most + 1e-4
    assert found.score[0] == pytest.approx(found.slippery[0] + found.pushed[0])
    assert found.value[0] == pytest.approx(CALIBRATION.probability(found.shortcomings)[0])


@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_the_weakest_push_is_one_that_fingers_cannot_take(free: Hand, ball: Object, turn: float) -> None:
    """Two contacts along x take part of a push across it, and nothing of one along x, as each presses with half of all.

    Pushes are along the axes of the hand.
    """
    chain, _, witness = touching(free, *OPPOSING)
    T = np.eye(4)[None].copy()
    T[0, :3, :3] = exp_so3(np.array([0.0, 0.0, turn]))
    found = quality(free, ball, chain, chain(T, np.zeros((1, len(free.joint_names)))), witness)
    in_hand = found.weakest_push[0] @ T[0, :3, :3]
    assert np.isclose(np.abs(in_hand).max(), 1.0) and np.count_nonzero(np.abs(in_hand) > 1e-9) == 1
    assert abs(found.weakest_push[0, 0]) == pytest.approx(np.cos(turn))


@pytest.mark.parametrize("apart", [0.004, 0.06])
def test_the_object_yields_where_contacts_beside_it_are_close(free: Hand, ball: Object, apart: float) -> None:
    """Two opposing contacts at x turn under pushes along y, and about their normals under those along z."""
    x, half = 0.03, 0.5 * apart
    rigid = replace(free, actuator=replace(free.actuator, kp=np.full(len(free.joint_names), 1e9)))
    found = of(rigid, ball, [[[x, half, 0], [x, -half, 0]]], [[[0, -1, 0], [0, 1, 0]]])
    about_z, about_y = (2.0 * CONTACT_STIFFNESS * lever**2 for lever in (half, TORSION_LEVER_M))
    turn = (x / (about_z - TOTAL_PRESSURE_N * half) + x / about_y) / 3.0
    assert found.yielding[0] == pytest.approx(max(turn / YIELDING_RAD_N - 1.0, 0.0), rel=0.02)
    assert (found.yielding[0] > 1.0) == (apart < 0.01)
    rest = found.slippery + found.pushed + found.deep + found.open + found.strained
    np.testing.assert_allclose(found.score, rest + YIELDING_SHARE * found.yielding)
    # Closer still, the forces turn it away: as bad as it gets.
    half = 0.4 * TOTAL_PRESSURE_N / (2.0 * CONTACT_STIFFNESS)
    assert of(rigid, ball, [[[x, half, 0], [x, -half, 0]]], [[[0, -1, 0], [0, 1, 0]]]).yielding[0] == MOST_YIELDING


@pytest.mark.parametrize("slope", [0.05, 0.12, 0.3])
def test_a_wedge_slips_where_its_slope_is_above_the_small_friction(free: Hand, ball: Object, slope: float) -> None:
    """What is left of each contact is sin a - mu cos a, for contacts that look up by a."""
    a = np.arctan(slope)
    # In the plane of the contacts, so that their friction can be anything between that of pyramid and cone.
    normal = [[[-np.cos(a), 0, np.sin(a)], [np.cos(a), 0, np.sin(a)]]]
    found = of(free, ball, [[[0.03, 0, 0], [-0.03, 0, 0]]], normal)
    low, high = (max(0.0, np.cos(a) * (slope - mu)) for mu in (LOW_FRICTION, LOW_FRICTION * np.cos(np.pi / NUM_EDGES)))
    assert low - 1e-4 <= found.slippery[0] <= high + 1e-4


def test_depth_counts_by_its_scale(free: Hand, ball: Object) -> None:
    """Of the deepest link alone; of gaps, the mean by pressure, which is half for each of two contacts."""
    found = of(free, ball, OPPOSING[0] * 3, OPPOSING[1] * 3, [[0.0, 0.0], [-0.002, -0.001], [0.002, 0.001]])
    np.testing.assert_allclose(found.deep, [0.0, 0.002 / DEEP, 0.0])
    np.testing.assert_allclose(found.open, [0.0, 0.0, 0.0015 / DEEP], atol=1e-9)
    np.testing.assert_allclose(found.score - found.deep - found.open, found.score[0], atol=1e-9)
    other = of(free, ball, OPPOSING[0] * 2, OPPOSING[1] * 2, [[-0.001, -0.002], [0.001, 0.002]])
    assert other.deepest_link[0] == 1 and other.farthest_contact[1] == 1
    # Gaps on purpose do not count.
    gaps = touching(free, *(part * 1 for part in OPPOSING), [[0.002, 0.001]])
    clearance = np.full(len(gaps[0].links), 5e-4)
    assert quality(free, ball, *gaps, clearance).open[0] == pytest.approx(0.001 / DEEP)


def test_what_is_two_centimetres_deep_does_not_hold(free: Hand, ball: Object) -> None:
    """However well its forces balance; up to one centimetre the calibration alone counts."""
    depths = [[0.0, 0.0], [-0.009, 0.0], [-0.015, 0.0], [-0.021, 0.0]]
    found = of(free, ball, OPPOSING[0] * 4, OPPOSING[1] * 4, depths)
    alone = CALIBRATION.probability(found.shortcomings)
    np.testing.assert_allclose(found.value, alone * [1.0, 1.0, 0.5, 0.0])


def test_pushes_are_in_six_directions_and_turn_nothing() -> None:
    np.testing.assert_allclose(PUSHES.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(PUSHES[:, :3], axis=1), PUSH_SHARE)
    assert len(np.unique(PUSHES, axis=0)) == 6 and not PUSHES[:, 3:].any()


# what may never make it better


def random_grasps(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three or four contacts on a dented ball (count, 4, 3), and normals that roughly look inward."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 4, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return -0.03 * normal + 0.004 * rng.normal(size=normal.shape), normal


def test_tendons_are_never_better_than_a_motor_for_each_joint(free: Hand, coupled: Hand, ball: Object) -> None:
    point, normal = random_grasps(20, 5)
    one, other = (of(hand, ball, point.tolist(), normal.tolist()) for hand in (free, coupled))
    np.testing.assert_allclose(other.slippery, one.slippery, atol=1e-9)
    assert (other.pushed >= one.pushed - 1e-3).all() and (other.pushed > one.pushed + 1e-3).any()


# torques of the actuators


def with_limit(hand: Hand, limit: float) -> Hand:
    actuator = replace(hand.actuator, force_limit=np.full(len(hand.joint_names), limit))
    return replace(hand, actuator=actuator)


@pytest.mark.parametrize("name", ["free", "coupled"])
def test_a_joint_is_strained_beyond_its_limit_and_not_within(name: str, ball: Object, request: Any) -> None:
    """Torques are as they were with any limit, and the excess is what a quarter of the limit makes of a share."""
    hand = request.getfixturevalue(name)
    point, normal = (each.tolist() for each in random_grasps(12, 8))
    without = of(with_limit(hand, np.inf), ball, point, normal)
    assert not without.strained.any()
    small = of(with_limit(hand, 1e-5), ball, point, normal)
    assert (small.strained > 1.0).all()
    smaller = of(with_limit(hand, 1e-5 / 4), ball, point, normal)
    np.testing.assert_allclose(1.0 + smaller.strained, 4.0 * (1.0 + small.strained))
    np.testing.assert_array_equal(smaller.strained_joint, small.strained_joint)
    # Just enough for the most strained grasp: nothing changes at all.
    ample = of(with_limit(hand, 1.001e-5 * (1.0 + small.strained.max())), ball, point, normal)
    np.testing.assert_array_equal(ample.shortcomings, without.shortcomings)
    np.testing.assert_array_equal(ample.value, without.value)
    np.testing.assert_array_equal(small.shortcomings[:, :4], without.shortcomings[:, :4])


# tasks


@pytest.mark.parametrize("grip", [0.5, 1.5])
def test_friction_of_the_task_is_what_a_wedge_slips_with(free: Hand, ball: Object, grip: float) -> None:
    """What is left of each contact is sin a - mu cos a, with the small friction of the task."""
    a = np.arctan(0.3)
    normal = [[[-np.cos(a), 0, np.sin(a)], [np.cos(a), 0, np.sin(a)]]]
    found = of(free, ball, OPPOSING[0], normal, demand=Demand(friction=grip * Demand.friction))
    inscribed = np.cos(np.pi / NUM_EDGES)
    most, least = (np.sin(a) - LOW_FRICTION * grip * share * np.cos(a) for share in (inscribed, 1.0))
    assert least - 1e-3 <= found.slippery[0] <= most + 1e-3


@pytest.mark.parametrize("times", [0.2, 7.0])
def test_a_hand_so_many_times_as_strong_and_stiff_carries_as_many_times_the_mass(
    free: Hand, ball: Object, times: float
) -> None:
    point, normal = (each.tolist() for each in random_grasps(12, 8))
    hand = with_limit(free, 0.02)
    actuator = hand.actuator
    strong = replace(hand, actuator=replace(actuator, force_limit=times * actuator.force_limit, kp=times * actuator.kp))
    one, other = of(hand, ball, point, normal), of(strong, ball, point, normal, demand=Demand(mass_kg=0.1 * times))
    assert (one.strained > 0.0).any()
    np.testing.assert_allclose(other.torque_share, one.torque_share)
    np.testing.assert_allclose(other.under(1.0 / times).torque_share * times, one.torque_share)


def test_up_to_the_largest_load_a_grasp_is_good_enough_and_beyond_it_is_not(free: Hand, ball: Object) -> None:
    hand = with_limit(free, 0.05)
    found = of(
        hand,
        ball,
        [[[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]],
        [[[-1, 0, 0], [0.5, -0.866, 0], [0.5, 0.866, 0]]],
    )
    [load] = found.largest_load(confidence := 0.9)
    assert 0.01 < load < 100.0
    assert found.under(0.999 * load).value[0] >= confidence > found.under(1.001 * load).value[0]
    # A grasp that even the lightest object leaves, and one that nothing limits.
    assert of(hand, ball, *OPPOSING).largest_load(0.9999)[0] == 0.0
    assert of(with_limit(free, np.inf), ball, *OPPOSING).under(0.0).largest_load(0.01)[0] == LOADS[1]


# grasps on their own


def test_without_contacts_there_is_no_quality(free: Hand, ball: Object) -> None:
    """Links that are near but not near enough are none; the other grasp is as ever."""
    point, normal = OPPOSING[0] * 2, OPPOSING[1] * 2
    found = of(free, ball, point, normal, [[0.0, 0.0], [0.05, 0.05]])
    alone = of(free, ball, *OPPOSING)
    assert np.isinf(found.score[1]) and np.isnan(found.value[1]) and np.isnan(found.slippery[1])
    assert found.score[0] == pytest.approx(alone.score[0])
