"""The conventions that the package's docstring states hold in the code, and its examples run."""

from __future__ import annotations

import doctest

import numpy as np
import pytest

import grasp_refine
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import (
    ambient_gradient,
    exp_se3,
    hat,
    inverse,
    matrix_from_quaternion,
    matvec,
    pose_from_transform,
    transform_from_pose,
    transform_points,
)
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from twists import adjoint


def random_transforms(count: int, seed: int = 0) -> np.ndarray:
    return exp_se3(np.random.default_rng(seed).normal(size=(count, 6)))


def test_the_examples_of_the_docstring_run() -> None:
    (found,) = doctest.DocTestFinder(recurse=False).find(grasp_refine, "grasp_refine")
    assert len(found.examples) >= 10
    runner = doctest.DocTestRunner()
    runner.run(found)
    assert runner.summarize(verbose=False).failed == 0


def test_quaternions_are_hamiltons_w_first_active_and_written_with_w_above_zero() -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(20, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    point = rng.normal(size=(20, 3))

    def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        w = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(axis=1, keepdims=True)
        return np.hstack([w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])

    turned = product(product(q, np.hstack([np.zeros((20, 1)), point])), q * [1, -1, -1, -1])
    np.testing.assert_allclose(turned[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(matvec(matrix_from_quaternion(q), point), turned[:, 1:], atol=1e-14)
    np.testing.assert_allclose(matrix_from_quaternion(-q), matrix_from_quaternion(q), atol=1e-15)
    written = pose_from_transform(transform_from_pose(np.hstack([point, q])))
    np.testing.assert_allclose(written, np.hstack([point, np.where(q[:, :1] < 0, -q, q)]), atol=1e-14)


def test_spatial_twists_move_points_of_the_world_and_body_twists_are_carried_there_by_the_adjoint() -> None:
    rng, h = np.random.default_rng(2), 1e-6
    T, xi, p = random_transforms(10), rng.normal(size=(10, 6)), rng.normal(size=(10, 3))
    there = transform_points(T, p)
    ahead, behind = (transform_points(exp_se3(sign * h * xi) @ T, p) for sign in (1.0, -1.0))
    velocity = xi[:, :3] + np.cross(xi[:, 3:], there)
    np.testing.assert_allclose((ahead - behind) / (2 * h), velocity, atol=1e-8)
    np.testing.assert_allclose(exp_se3(matvec(adjoint(T), xi)) @ T, T @ exp_se3(xi), atol=1e-12)
    np.testing.assert_allclose(matvec(hat(xi[:, 3:]), p), np.cross(xi[:, 3:], p), atol=1e-15)


def test_a_wrench_is_the_derivative_along_a_spatial_twist() -> None:
    """The loss f . p of a point that T carries has the wrench (f, p x f)."""
    rng, h = np.random.default_rng(3), 1e-6
    T, xi = random_transforms(10), rng.normal(size=(10, 6))
    f, point_body = rng.normal(size=(2, 10, 3))
    p = transform_points(T, point_body)
    wrench = np.concatenate([f, np.cross(p, f)], axis=1)
    ahead, behind = ((f * transform_points(exp_se3(sign * h * xi) @ T, point_body)).sum(axis=1) for sign in (1.0, -1.0))
    np.testing.assert_allclose((wrench * xi).sum(axis=1), (ahead - behind) / (2 * h), atol=1e-8)
    generator = np.zeros((10, 4, 4))
    generator[:, :3, :3], generator[:, :3, 3] = hat(xi[:, 3:]), xi[:, :3]
    paired = (ambient_gradient(T, wrench) * (generator @ T)).sum(axis=(1, 2))
    np.testing.assert_allclose(paired, (wrench * xi).sum(axis=1), atol=1e-12)


@pytest.mark.parametrize("gap", [0.01, -0.01])
def test_normals_point_from_a_to_b_and_distances_are_negative_in_penetration(gap: float) -> None:
    ball, other = load_object("sphere:0.02").body, load_object("sphere:0.03").body
    T_a, T_b = random_transforms(8, 4)[:, None], random_transforms(8, 5)[:, None]
    away = np.random.default_rng(6).normal(size=(8, 1, 3))
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    T_b[..., :3, 3] = T_a[..., :3, 3] + (0.05 + gap) * away
    found = query(Pairs((ball,), (other,)), T_a, T_b)
    np.testing.assert_allclose(found.normal, away, atol=1e-6)
    np.testing.assert_allclose(found.distance, gap, atol=1e-9)
    along = (found.normal * (found.point_b - found.point_a)).sum(axis=-1)
    np.testing.assert_allclose(along, found.distance, atol=1e-12)
    turned = query(Pairs((other,), (ball,)), T_b, T_a)
    np.testing.assert_allclose(turned.normal, -found.normal, atol=1e-6)
    np.testing.assert_allclose(turned.distance, found.distance, atol=1e-12)


@pytest.mark.parametrize("gap", [0.01, -0.01])
def test_the_signed_distance_follows_both_bodies_as_stated(gap: float) -> None:
    box, ball, h = load_object("box:0.06,0.05,0.04").body, load_object("sphere:0.02").body, 1e-5
    pairs, rng = Pairs((box,), (ball,)), np.random.default_rng(7)
    T_a = random_transforms(6, 8)[:, None]
    T_b = T_a.copy()
    T_b[..., :3, 3] += (0.05 + gap) * T_a[..., :3, 0]  # beside the face at x = 0.03
    found = query(pairs, T_a, T_b)
    np.testing.assert_allclose(found.distance, gap, atol=1e-9)
    xi_a, xi_b = rng.normal(size=(2, 6, 1, 6))
    ahead, behind = (
        query(pairs, exp_se3(sign * h * xi_a) @ T_a, exp_se3(sign * h * xi_b) @ T_b).distance for sign in (1.0, -1.0)
    )
    moves = [xi[..., :3] + np.cross(xi[..., 3:], x) for xi, x in ((xi_a, found.point_a), (xi_b, found.point_b))]
    expected = (found.normal * (moves[1] - moves[0])).sum(axis=-1)
    np.testing.assert_allclose((ahead - behind) / (2 * h), expected, atol=1e-5)


def test_frames_chain_from_the_world_over_the_root_to_the_link() -> None:
    hand = load_hand("leap", candidates=16)
    chain = Chain(hand, [link.name for link in hand.links])
    q = np.random.default_rng(9).uniform(hand.lower, hand.upper, (4, len(hand.joint_names)))
    T_world_root = random_transforms(4, 10)
    T_root_link = chain(np.tile(np.eye(4), (4, 1, 1)), q).T_world_link
    T_world_link = chain(T_world_root, q).T_world_link
    np.testing.assert_allclose(T_world_link, T_world_root[:, None] @ T_root_link, atol=1e-12)
    root = [link.name for link in hand.links].index(hand.base_link)
    np.testing.assert_allclose(T_world_link[:, root], T_world_root, atol=1e-12)
    point_link = np.array([0.01, 0.02, 0.03])
    back = transform_points(inverse(T_world_link), transform_points(T_world_link, point_link))
    np.testing.assert_allclose(back, np.broadcast_to(point_link, back.shape), atol=1e-12)


def test_poses_of_grasp_files_are_as_in_the_base_link_in_the_frame_of_the_object() -> None:
    hand = load_hand("allegro", candidates=16)
    grasps = load_grasps(hand.urdf.parent / "example_rounded_box.npz")
    assert grasps.hand_pose.shape[1] == 7 and set(grasps.joint_names) == set(hand.joint_names)
    chain = Chain(hand, [contact.link for contact in hand.contacts])
    surface = load_object("rounded_box").body.candidates.points
    q = grasps.q[:, [grasps.joint_names.index(name) for name in hand.joint_names]]

    def farthest(T_world_root: np.ndarray) -> float:
        """How far the fingertips' pads are from samples of the box, at most, in metres."""
        T_tips = chain(T_world_root, q).T_world_link
        pads = transform_points(T_tips, np.array([contact.point for contact in hand.contacts]))
        return np.linalg.norm(pads[..., None, :] - surface, axis=-1).min(axis=-1).max()

    T = transform_from_pose(grasps.hand_pose)
    assert farthest(T) < 0.02
    # The other way round, or with the quaternion's w last, they would be somewhere else.
    last = transform_from_pose(grasps.hand_pose[:, [0, 1, 2, 6, 3, 4, 5]])
    assert farthest(inverse(T)) > 0.04 and farthest(last) > 0.04
