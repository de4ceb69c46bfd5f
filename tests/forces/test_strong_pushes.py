"""Strong pushes in closed form, and in another frame."""

from pathlib import Path

import numpy as np
import pytest

from claw import around, capsule, claw
from grasp_refine.collision.query import QueryStatus, Witness, query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.forces.squeeze import contacts
from grasp_refine.forces.strong_pushes import (
    STRONG_PUSH_FRICTION,
    STRONG_PUSH_SHARE,
    STRONG_PUSHES,
    strong_push_residual,
)
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import links_of


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"))


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object("sphere:0.03", candidates=16)


def residual_of(hand: Hand, obj: Object, chain: Chain, frames: Frames, witness: Witness) -> np.ndarray:
    """That of grasps."""
    points = contacts(hand, obj, chain.links, witness, frames.T_world_link)
    return strong_push_residual(points, obj, frames.T_world_root[:, :3, :3])


def residual(hand: Hand, ball: Object, normals: list[list[float]]) -> float:
    """That of tips with normals into a ball, so many as there are normals."""
    chain = Chain(hand, links_of(hand))
    links, count = len(chain.links), len(normals)
    point, normal = np.zeros((2, 1, links, 3))
    normal[0, :count] = np.array(normals) / np.linalg.norm(normals, axis=1, keepdims=True)
    point[0, :count] = -0.03 * normal[0, :count]
    gap = np.where(np.arange(links) < count, 0.0, np.inf)[None]
    status = np.where(np.isfinite(gap), 0, QueryStatus.FAR)
    none = np.zeros((1, links), dtype=np.int64)
    witness = Witness(point, point, normal, gap, status, none, none)
    frames = chain(np.eye(4)[None], np.zeros((1, len(hand.joint_names))))
    return float(residual_of(hand, ball, chain, frames, witness)[0])


def test_strong_pushes_go_to_faces_and_corners_of_a_cube() -> None:
    assert len(np.unique(STRONG_PUSHES, axis=0)) == 14 and not STRONG_PUSHES[:, 3:].any()
    np.testing.assert_allclose(np.linalg.norm(STRONG_PUSHES, axis=1), STRONG_PUSH_SHARE)
    np.testing.assert_allclose(STRONG_PUSHES.sum(axis=0), 0.0, atol=1e-15)


def test_two_opposing_contacts_leave_the_worst_push(hand: Hand, ball: Object) -> None:
    """Across them friction takes 0.3 at most of 0.33; along them both bear half already, and the whole push is left."""
    assert STRONG_PUSH_FRICTION < STRONG_PUSH_SHARE
    assert residual(hand, ball, [[1, 0, 0], [-1, 0, 0]]) == pytest.approx(STRONG_PUSH_SHARE, abs=1e-3)


def test_it_is_the_same_in_another_frame(tmp_path: Path) -> None:
    """Everything turned and nothing else: pushes and pyramids are aligned to the hand."""
    hand, obj = claw(tmp_path), capsule()
    scene, prepared = around(hand, obj, 6, 3), HandObject(hand, obj)
    T = exp_se3(np.array([0.0, 0.0, 0.0, 0.4, -1.1, 0.7]))
    here = prepared.chain(scene.T_world_root, scene.q)
    there = prepared.chain(T @ scene.T_world_root, scene.q)
    poses = here.T_world_link
    witness = query(prepared.pairs, poses, np.broadcast_to(np.eye(4), poses.shape))
    turned = [part @ T[:3, :3].T for part in (witness.point_a, witness.point_b, witness.normal)]
    moved = Witness(*turned, witness.distance, witness.status, witness.winner, witness.num_queries)
    one = residual_of(hand, obj, prepared.chain, here, witness)
    other = residual_of(hand, obj, prepared.chain, there, moved)
    assert np.isfinite(one).sum() >= 4
    np.testing.assert_allclose(other, one, atol=1e-9)
