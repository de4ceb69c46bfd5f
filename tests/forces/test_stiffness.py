"""Motion of the object on springs that forces press: closed forms, second derivatives, turned frames."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from claw import claw
from grasp_refine.core.se3 import exp_se3, exp_so3, hat, inverse, matvec, transform_points
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.forces.stiffness import CONTACT_STIFFNESS, TORSION_LEVER_M, joint_stiffness, object_motion
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.scene.scene import links_of

STEP = 1e-6
LOADS = np.eye(6)[None]
CENTER = np.array([0.01, -0.02, 0.005])
AT_REST = np.eye(4)


@pytest.fixture(scope="module", params=[False, True])
def hand(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Hand:
    """The claw, whose joints have actuators of their own or share one."""
    return claw(tmp_path_factory.mktemp("claw"), coupled=request.param)


@pytest.fixture(scope="module", params=["claw", "tendons", "leap", "franka_hand"])
def any_hand(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Hand:
    """Hands of short and long fingers, with joints that turn, that slide, and that follow others."""
    if request.param in ("leap", "franka_hand"):
        return load_hand(request.param)
    return claw(tmp_path_factory.mktemp("claw"), coupled=request.param == "tendons")


def with_stiffness(hand: Hand, kp: float) -> Hand:
    return replace(hand, actuator=replace(hand.actuator, kp=np.full(len(hand.joint_names), kp)))


def points_of(point: np.ndarray, normal: np.ndarray) -> ContactPoints:
    """One grasp of the first links."""
    K = len(point)
    return ContactPoints(point[None], normal[None], np.zeros((1, K)), np.arange(K)[None], None)


def moved(
    hand: Hand, points: ContactPoints, force: np.ndarray, T: np.ndarray = AT_REST, center: np.ndarray = CENTER
) -> np.ndarray:
    """Motions (6, 6) of the object under unit loads, as columns."""
    chain = Chain(hand, links_of(hand))
    frames = chain(T[None], np.zeros((1, len(hand.joint_names))))
    return object_motion(hand, chain, frames, points, force[None], center, LOADS)[0].T


def random_points(seed: int = 0, count: int = 4, newtons: float = 1e-3) -> tuple[ContactPoints, np.ndarray]:
    """Contacts, and forces within their friction cones."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    force = newtons * rng.uniform(0.1, 1.0, (count, 1)) * (normal + 0.1 * rng.normal(size=(count, 3)))
    return points_of(0.04 * rng.normal(size=(count, 3)), normal), force


@pytest.mark.parametrize("share", [1e-9, 0.003, 0.9, 1.1])
def test_two_opposing_contacts_of_a_rigid_hand(hand: Hand, share: float) -> None:
    """Forces that press the object together turn it away, as a rod that buckles: from f = k a on."""
    a = 0.03
    normal = np.array([[-1.0, 0, 0], [1, 0, 0]])
    f = share * CONTACT_STIFFNESS * a
    points = points_of(np.array([[a, 0, 0], [-a, 0, 0]]), normal)
    found = moved(with_stiffness(hand, 1e12), points, f * normal, center=np.zeros(3))
    along, about = 1.0 / (2.0 * CONTACT_STIFFNESS), 1.0 / (2.0 * TORSION_LEVER_M**2 * CONTACT_STIFFNESS)
    turning = 1.0 / (2.0 * a * (a * CONTACT_STIFFNESS - f))
    if share > 1.0:
        assert np.isinf(found).all()
    elif not hand.coupled:
        np.testing.assert_allclose(found, np.diag([along] * 3 + [about, turning, turning]), rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("newtons", [1e-3, 4.0])
def test_the_stiffness_is_the_second_derivative_of_the_energy(any_hand: Hand, newtons: float) -> None:
    """Springs in series, and forces that keep their direction, with the places of contacts by exact poses."""
    hand = any_hand
    points, force = random_points(newtons=newtons)
    count, n = len(force), len(hand.joint_names)
    chain = Chain(hand, links_of(hand))
    link = np.linspace(0, len(chain.links) - 1, count).astype(int)
    points = replace(points, link=link[None])
    rest = chain(np.eye(4)[None], np.zeros((1, n))).T_world_link[0, link]

    def places(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change = chain(np.eye(4)[None], q[None]).T_world_link[0, link] @ inverse(rest)
        R = change[:, :3, :3]
        return matvec(R, points.point[0]) + change[:, :3, 3], R

    columns = []
    for axis in STEP * np.eye(n):
        (ahead, R), (behind, S) = places(axis), places(-axis)
        turn = (R @ S.mT)[:, [2, 0, 1], [1, 2, 0]] - (R @ S.mT)[:, [1, 2, 0], [2, 0, 1]]
        spin = (0.5 * turn * points.normal[0]).sum(axis=1)
        columns.append(np.concatenate([(ahead - behind).ravel(), spin]) / (2.0 * STEP))
    J = np.stack(columns, axis=1)
    pressure = (force * points.normal[0]).sum(axis=1)
    each = CONTACT_STIFFNESS * pressure / pressure.mean()
    D = np.concatenate([np.repeat(each, 3), TORSION_LEVER_M**2 * each])[:, None]
    arm = points.point[0] - CENTER
    A = np.zeros((4 * count, 6))
    for k in range(count):
        A[3 * k : 3 * k + 3] = np.concatenate([np.eye(3), -hat(arm[k])], axis=1)
        A[3 * count + k, 3:] = points.normal[0, k]
    both = np.concatenate([A, -J], axis=1)
    K = both.T @ (D * both)
    K[6:, 6:] += joint_stiffness(hand)
    K[3:6, 3:6] += second_derivatives(lambda w: -float((force * (arm @ exp_so3(w).T)).sum()), 3)
    K[6:, 6:] += second_derivatives(lambda q: float((force * places(q)[0]).sum()), n)
    wanted = np.linalg.inv(K)[:6, :6]
    assert (np.linalg.eigvalsh(K) > 0.0).all()
    np.testing.assert_allclose(moved(hand, points, force), wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())


def second_derivatives(function: Callable[[np.ndarray], float], size: int, step: float = 1e-3) -> np.ndarray:
    """Second derivatives (size, size) of a function at 0, by central differences."""
    H, e = np.empty((size, size)), step * np.eye(size)
    for i, j in product(range(size), repeat=2):
        ends = [a * b * function(a * e[i] + b * e[j]) for a, b in product((1, -1), repeat=2)]
        H[i, j] = sum(ends) / (4.0 * step**2)
    return H


def test_joints_of_one_tendon_give_in_turn(tmp_path: Path) -> None:
    """A motion that keeps the length of the tendon meets no stiffness; its stiffness is that of its first joint."""
    hand = claw(tmp_path, coupled=True)
    kp = np.arange(1.0, 1.0 + len(hand.joint_names))
    hand = replace(hand, actuator=replace(hand.actuator, kp=kp))
    (group, *_), K = hand.coupled, joint_stiffness(hand)
    joints = [hand.joint_names.index(name) for name in group.joints]
    K_tendon = kp[joints[0]] * np.outer(group.ratio, group.ratio)
    np.testing.assert_allclose(K[np.ix_(joints, joints)], K_tendon, atol=1e-5)
    dq = np.zeros(len(K))
    dq[joints[:2]] = group.ratio[1], -group.ratio[0]
    assert dq @ K @ dq < 1e-4 and K[joints[0], joints[0]] > 0.01


def test_it_turns_with_the_frame(hand: Hand) -> None:
    points, force = random_points(2, newtons=0.5)
    T = exp_se3(np.array([0.1, -0.2, 0.05, 0.4, 1.0, -0.7]))
    turned = replace(points, point=transform_points(T, points.point), normal=points.normal @ T[:3, :3].T)
    found = moved(hand, turned, force @ T[:3, :3].T, T, transform_points(T, CENTER))
    R = np.kron(np.eye(2), T[:3, :3])
    assert np.isfinite(found).all()
    np.testing.assert_allclose(R.T @ found @ R, moved(hand, points, force), rtol=1e-8, atol=1e-9)
