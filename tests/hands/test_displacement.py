"""Displacement of hands: root mean square over surface points, the same in every frame, without the arm."""

import numpy as np
import pytest

from claw import around, capsule, claw
from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.displacement import Displacement
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.scene.scene import Scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return around(claw(tmp_path_factory.mktemp("claw")), capsule(), 5, 2)


def test_it_is_the_root_mean_square_over_the_surface(scene: Scene) -> None:
    """Against all surface points, moved one by one."""
    hand, other = scene.hand, np.roll(np.arange(5), 1)
    links = [link for link in hand.links if link.body is not None]
    chain = Chain(hand, [link.name for link in links])
    T = chain(scene.T_world_root, scene.q).T_world_link
    square, total = np.zeros(5), 0.0
    for column, link in enumerate(links):
        points = link.solid.candidates
        before = transform_points(T[:, None, column], points.points[None])
        moved = np.linalg.norm(before[other] - before, axis=-1)
        square += (points.areas * moved**2).sum(axis=1)
        total += points.areas.sum()
    found = Displacement.of(hand).between(scene.T_world_root, scene.q, scene.T_world_root[other], scene.q[other])
    np.testing.assert_allclose(found, np.sqrt(square / total), rtol=1e-10)
    assert (found > 1e-3).all()


def test_a_translation_displaces_by_its_length_in_any_frame(scene: Scene) -> None:
    T, q, between = scene.T_world_root, scene.q, Displacement.of(scene.hand).between
    shift = np.eye(4)
    shift[:3, 3] = (0.003, -0.004, 0.012)
    np.testing.assert_allclose(between(T, q, shift @ T, q), 0.013, rtol=1e-9)
    np.testing.assert_allclose(between(T, q, T, q), 0.0, atol=1e-12)
    other, frame = np.roll(np.arange(5), 1), exp_se3(np.array([0.4, -0.3, 0.2, 0.5, 1.0, -2.0]))
    expected = between(T, q, T[other], q[other])
    np.testing.assert_allclose(between(frame @ T, q, frame @ T[other], q[other]), expected, rtol=1e-9)
    np.testing.assert_allclose(between(T[other], q[other], T, q), expected, rtol=1e-12)


def test_links_of_an_arm_do_not_count() -> None:
    """The displacement of a hand on an arm is that of the hand alone with its palm at the same poses."""
    hand = load_hand("franka_hand", candidates=32)
    whole = mount(load_hand("ur5e", candidates=32), hand)
    q = np.stack([0.5 * (whole.lower + whole.upper), 0.4 * whole.lower + 0.6 * whole.upper])
    T = np.broadcast_to(np.eye(4), (2, 4, 4))
    palm, own = palm_poses(whole, T, q), q[:, ~whole.arm_joints]
    found = Displacement.of(whole).between(T[:1], q[:1], T[1:], q[1:])
    np.testing.assert_allclose(found, Displacement.of(hand).between(palm[:1], own[:1], palm[1:], own[1:]), rtol=1e-9)
    assert found > 0.01
