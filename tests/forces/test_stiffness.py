"""Motion of the object on springs: closed forms, springs in series, and what turns with the frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from claw import claw
from grasp_refine.core.se3 import exp_se3, hat, inverse, matvec, transform_points
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.forces.stiffness import CONTACT_STIFFNESS, TORSION_LEVER_M, joint_stiffness, object_motion
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.scene import links_of

STEP = 1e-6
LOADS = np.eye(6)[None]
CENTER = np.array([0.01, -0.02, 0.005])
AT_REST = np.eye(4)


@pytest.fixture(scope="module", params=[False, True])
def hand(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Hand:
    """The claw, whose joints have actuators of their own or share one."""
    return claw(tmp_path_factory.mktemp("claw"), coupled=request.param)


def with_stiffness(hand: Hand, kp: float) -> Hand:
    return replace(hand, actuator=replace(hand.actuator, kp=np.full(len(hand.joint_names), kp)))


def points_of(point: np.ndarray, normal: np.ndarray) -> ContactPoints:
    """One grasp of the first links."""
    K = len(point)
    return ContactPoints(point[None], normal[None], np.zeros((1, K)), np.arange(K)[None], None)


def moved(
    hand: Hand, points: ContactPoints, pressure: np.ndarray, T: np.ndarray = AT_REST, center: np.ndarray = CENTER
) -> np.ndarray:
    """Motions (6, 6) of the object under unit loads, as columns."""
    chain = Chain(hand, links_of(hand))
    frames = chain(T[None], np.zeros((1, len(hand.joint_names))))
    return object_motion(hand, chain, frames, points, pressure[None], center, LOADS)[0].T


def random_points(seed: int = 0, count: int = 4) -> tuple[ContactPoints, np.ndarray]:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    pressure = rng.uniform(0.1, 1.0, count)
    return points_of(0.04 * rng.normal(size=(count, 3)), normal / np.linalg.norm(normal, axis=1)[:, None]), pressure


def test_two_opposing_contacts_of_a_rigid_hand(hand: Hand) -> None:
    a = 0.03
    points = points_of(np.array([[a, 0, 0], [-a, 0, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]]))
    found = moved(with_stiffness(hand, 1e12), points, np.ones(2), center=np.zeros(3))
    along, turning = 1.0 / (2.0 * CONTACT_STIFFNESS), 1.0 / (2.0 * a**2 * CONTACT_STIFFNESS)
    about = 1.0 / (2.0 * TORSION_LEVER_M**2 * CONTACT_STIFFNESS)
    if not hand.coupled:
        np.testing.assert_allclose(found, np.diag([along] * 3 + [about, turning, turning]), rtol=1e-4, atol=1e-9)


def test_joints_and_contacts_are_springs_in_series(hand: Hand) -> None:
    """The compliance of each contact is its own plus J K_q^-1 J^T, with J by finite differences of the poses."""
    points, pressure = random_points()
    count = len(pressure)
    chain = Chain(hand, links_of(hand))

    def places(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T = chain(np.eye(4)[None], q[None]).T_world_link[0, :count]
        rest = chain(np.eye(4)[None], np.zeros((1, len(q)))).T_world_link[0, :count]
        change = T @ inverse(rest)
        R = change[:, :3, :3]
        return matvec(R, points.point[0]) + change[:, :3, 3], R

    columns = []
    for axis in STEP * np.eye(len(hand.joint_names)):
        (ahead, R), (behind, S) = places(axis), places(-axis)
        turn = (R @ S.mT)[:, [2, 0, 1], [1, 2, 0]] - (R @ S.mT)[:, [1, 2, 0], [2, 0, 1]]
        spin = (0.5 * turn * points.normal[0]).sum(axis=1)
        columns.append(np.concatenate([(ahead - behind).ravel(), spin]) / (2.0 * STEP))
    J = np.stack(columns, axis=1)
    each = CONTACT_STIFFNESS * pressure / pressure.mean()
    own = 1.0 / np.concatenate([np.repeat(each, 3), TORSION_LEVER_M**2 * each])
    compliance = J @ np.linalg.inv(joint_stiffness(hand)) @ J.T + np.diag(own)
    arm = points.point[0] - CENTER
    A = np.zeros((4 * count, 6))
    for k in range(count):
        A[3 * k : 3 * k + 3] = np.concatenate([np.eye(3), -hat(arm[k])], axis=1)
        A[3 * count + k, 3:] = points.normal[0, k]
    wanted = np.linalg.inv(A.T @ np.linalg.inv(compliance) @ A)
    np.testing.assert_allclose(moved(hand, points, pressure), wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())


def test_softer_actuators_and_fewer_contacts_give_way_more(hand: Hand) -> None:
    points, pressure = random_points(1)
    fewer = np.where(np.arange(4) == 3, 0.0, pressure)
    given = [moved(hand, points, pressure), moved(with_stiffness(hand, 0.1 * hand.actuator.kp[0]), points, pressure)]
    # Those without a pressure hold nothing, and may be anywhere.
    lost = replace(points, point=np.where(np.arange(4)[None, :, None] == 3, np.nan, points.point))
    np.testing.assert_array_equal(moved(hand, points, fewer), moved(hand, lost, fewer))
    assert (np.diag(given[1]) > np.diag(given[0])).all()
    for found in given:
        np.testing.assert_allclose(found, found.T, rtol=1e-6, atol=1e-9)
        assert (np.linalg.eigvalsh(found) > 0.0).all()


def test_joints_of_one_tendon_give_in_turn(tmp_path: Path) -> None:
    """A motion that keeps the length of the tendon meets no stiffness."""
    hand = claw(tmp_path, coupled=True)
    (group, *_), K = hand.coupled, joint_stiffness(hand)
    joints = [hand.joint_names.index(name) for name in group.joints]
    dq = np.zeros(len(K))
    dq[joints[:2]] = group.ratio[1], -group.ratio[0]
    assert dq @ K @ dq < 1e-4 and K[joints[0], joints[0]] > 0.01


def test_it_turns_with_the_frame(hand: Hand) -> None:
    points, pressure = random_points(2)
    T = exp_se3(np.array([0.1, -0.2, 0.05, 0.4, 1.0, -0.7]))
    turned = replace(points, point=transform_points(T, points.point), normal=points.normal @ T[:3, :3].T)
    found = moved(hand, turned, pressure, T, transform_points(T, CENTER))
    R = np.kron(np.eye(2), T[:3, :3])
    np.testing.assert_allclose(R.T @ found @ R, moved(hand, points, pressure), rtol=1e-8, atol=1e-9)
