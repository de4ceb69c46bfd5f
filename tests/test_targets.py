"""Automatic targets: the present witness points, for links that are near enough."""

from dataclasses import replace

import numpy as np
from twists import random_poses

from grasp_refine.collision.query import Pairs, QueryStatus, query
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.se3 import transform_points
from grasp_refine.targets import REACH, automatic_targets

PAIRS = Pairs((build_body("a", [sphere(0.02)]),), (build_body("b", [sphere(0.03)]),))


def at_gaps(*gaps: float) -> tuple[np.ndarray, np.ndarray]:
    T_a, T_b = random_poses(len(gaps), 1), random_poses(len(gaps), 2)
    along = np.random.default_rng(3).normal(size=(len(gaps), 1, 3))
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    T_b[..., :3, 3] = T_a[..., :3, 3] + (0.05 + np.array(gaps))[:, None, None] * along
    return T_a, T_b


def test_links_within_reach_are_meant_to_touch_and_no_others() -> None:
    T_a, T_b = at_gaps(-0.01, 0.0, REACH - 1e-6, REACH + 1e-6, 0.5)
    on_a, on_b = automatic_targets(query(PAIRS, T_a, T_b), T_a, T_b)
    for found in (on_a, on_b):
        np.testing.assert_array_equal(np.isfinite(found).all(-1)[:, 0], [True, True, True, False, False])
        np.testing.assert_array_equal(np.isnan(found).any(-1), np.isnan(found).all(-1))


def test_targets_are_points_of_the_bodies_in_closed_form() -> None:
    T_a, T_b = at_gaps(-0.01, 0.005, 0.02)
    on_a, on_b = automatic_targets(query(PAIRS, T_a, T_b), T_a, T_b)
    n = T_b[..., :3, 3] - T_a[..., :3, 3]
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    # On the balls' surfaces, in the frame of the ball, towards the other one.
    np.testing.assert_allclose(on_a, 0.02 * np.einsum("bpji,bpj->bpi", T_a[..., :3, :3], n), atol=1e-9)
    np.testing.assert_allclose(on_b, -0.03 * np.einsum("bpji,bpj->bpi", T_b[..., :3, :3], n), atol=1e-9)
    # Moved with their bodies they stay where they are on them.
    M = random_poses(1, 4)[0, 0]
    gap = transform_points(M @ T_b, on_b) - transform_points(M @ T_a, on_a)
    np.testing.assert_allclose(np.linalg.norm(gap, axis=-1)[:, 0], [0.01, 0.005, 0.02], atol=1e-9)


def test_the_reach_can_be_set() -> None:
    T_a, T_b = at_gaps(0.005, 0.02)
    for reach, expected in ((0.001, [False, False]), (0.01, [True, False]), (0.1, [True, True])):
        found = automatic_targets(query(PAIRS, T_a, T_b), T_a, T_b, reach)[0]
        np.testing.assert_array_equal(np.isfinite(found).all(-1)[:, 0], expected)


def test_what_was_not_answered_is_no_target() -> None:
    T_a, T_b = at_gaps(0.005, 0.005, 0.005, 0.005)
    w = query(PAIRS, T_a, T_b)
    bad = [QueryStatus.FAR, QueryStatus.FAILED, QueryStatus.NOT_FINITE]
    status = w.status.copy()
    status[:3, 0] = bad
    distance = np.where(status > QueryStatus.FAR, np.nan, w.distance)
    # A pair that is FAR carries its cutoff as distance, which may well be within reach.
    on_a, on_b = automatic_targets(replace(w, status=status, distance=distance), T_a, T_b)
    np.testing.assert_array_equal(np.isfinite(on_a).all(-1)[:, 0], [False, False, False, True])
    np.testing.assert_array_equal(np.isfinite(on_b).all(-1)[:, 0], [False, False, False, True])
