"""Culled queries: bounds of motion hold for every point, what is surely apart is not asked, the rest is exact."""

import numpy as np
import pytest

from grasp_refine.collision.culling import bounding_sphere, motion, query_near
from grasp_refine.collision.query import Pairs, QueryStatus, query
from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import capsule, sphere
from shapes_for_tests import cluster_body, convex_body, ring_body
from twists import random_poses

BODIES = {
    "hull": convex_body(0),
    "ring": ring_body(),
    "cluster": cluster_body(1),
    "round": build_body("round", [capsule(0.01, (0.05, 0, 0), (0.1, 0, 0)), sphere(0.02, (-0.1, 0, 0))]),
}


@pytest.mark.parametrize("name", BODIES)
def test_balls_hold_their_bodies(name: str) -> None:
    body = BODIES[name]
    ball = bounding_sphere(body)
    for piece in body.pieces:
        assert (np.linalg.norm(piece.vertices - ball[:3], axis=1) + piece.radius <= ball[3] + 1e-12).all()
    assert (np.linalg.norm(body.candidates.points - ball[:3], axis=1) <= ball[3] + 1e-12).all()


@pytest.mark.parametrize("size", [1e-6, 1e-2, 1.0, 3.0])
def test_no_point_moves_farther_than_the_bound(size: float) -> None:
    rng = np.random.default_rng(2)
    before = np.tile(random_poses(20, 3), (1, 4, 1, 1))
    now = exp_se3(size * rng.normal(size=(20, 4, 6)) * [0.05, 0.05, 0.05, 1, 1, 1]) @ before
    balls = np.array([bounding_sphere(body) for body in BODIES.values()])
    bound = motion(balls, before, now)
    for column, body in enumerate(BODIES.values()):
        points = body.candidates.points
        path = [transform_points(T[:, column], np.tile(points, (20, 1, 1)).swapaxes(0, 1)) for T in (before, now)]
        far = np.linalg.norm(path[1] - path[0], axis=-1).max(axis=0)
        assert (far <= bound[:, column] + 1e-12).all()
        assert (far > 0.1 * bound[:, column]).any(), "and the bound is not idle"


def test_a_bound_of_motion_in_closed_form() -> None:
    """Half a turn about its own centre moves the rim of a ball by its diameter, a translation by itself."""
    ball = np.array([[0.1, 0.0, 0.0, 0.02]])
    T = np.eye(4)[None, None].copy()
    turned = T.copy()
    turned[..., :3, :3] = np.diag([-1.0, -1.0, 1.0])
    turned[..., 0, 3] = 0.2
    assert motion(ball, T, turned)[0, 0] == pytest.approx(0.04)
    shifted = T.copy()
    shifted[..., 1, 3] = 0.3
    assert motion(ball, T, shifted)[0, 0] == pytest.approx(0.3)


@pytest.mark.usefixtures("engine")
def test_what_is_surely_apart_is_not_asked_and_the_rest_is_that_of_a_query() -> None:
    pairs = Pairs((BODIES["hull"], BODIES["ring"]), (BODIES["cluster"], BODIES["cluster"]))
    T_a, T_b = np.tile(random_poses(30, 4), (1, 2, 1, 1)), np.tile(random_poses(30, 5), (1, 2, 1, 1))
    plain = query(pairs, T_a, T_b)
    rng = np.random.default_rng(6)
    bound = plain.distance - rng.uniform(0, 0.02, plain.distance.shape)
    cutoff = np.where(rng.random(bound.shape) < 0.3, np.inf, 0.003)
    found = query_near(pairs, np.tile([0, 1], (30, 1)), bound, T_a, T_b, cutoff, None)
    skipped = ~np.isinf(cutoff) & (bound > 0)
    assert skipped.any() and (~skipped & (plain.distance < 0)).any()
    np.testing.assert_array_equal(found.status[skipped], QueryStatus.FAR)
    np.testing.assert_array_equal(found.distance[skipped], bound[skipped])
    assert not found.num_queries[skipped].any() and (found.winner[skipped] == -1).all()
    answered = found.valid
    np.testing.assert_allclose(found.distance[answered], plain.distance[answered], atol=1e-9)
    # Everything that penetrates was answered, and so was all without a cutoff.
    assert answered[plain.distance < 0].all() and answered[np.isinf(cutoff)].all()


@pytest.mark.usefixtures("engine")
def test_poses_that_are_not_finite_are_asked_and_said_to_be_so() -> None:
    pairs = Pairs((BODIES["hull"],), (BODIES["round"],))
    T = random_poses(4, 7)
    T[1:3, 0, 0, 3] = np.nan
    # An infinite bound is that of a rejected grasp, whose poses do not matter.
    bound = np.array([[1.0], [np.nan], [np.inf], [1.0]])
    found = query_near(pairs, np.zeros((4, 1), dtype=int), bound, T, random_poses(4, 8), np.full((4, 1), 0.003), None)
    far = QueryStatus.FAR
    np.testing.assert_array_equal(found.status[:, 0], [far, QueryStatus.NOT_FINITE, far, far])
