"""Key points of human hands: any order and side, contacts at the tips, and transfers like those of a robot hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import load_hand
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.transfers.key_points import (
    MANO_ORDER,
    NUM_VERTICES,
    TIP_VERTICES,
    TOUCH_M,
    KeyPoints,
    load_key_points,
)
from grasp_refine.transfers.source_grasps import source_grasps

LINKS = [
    [f"{finger}{part}" for part in ("proximal", "middle", "distal", "distal")]
    for finger in ("th", "ff", "mf", "rf", "lf")
]


@pytest.fixture(scope="module")
def shadow() -> Problem:
    """Grasps of the Shadow hand on the mug, from its palm on."""
    return load_problem(ProblemSpec(hand="shadow_palm"))


@pytest.fixture(scope="module")
def points(shadow: Problem) -> np.ndarray:
    """Key points (N, 21, 3) of these grasps, in the order of OpenPose."""
    scene = shadow.groups[0].scene
    hand = scene.hand
    chain = Chain(hand, ["palm", *(link for finger in LINKS for link in finger)])
    T = chain(scene.T_world_root, scene.q).T_world_link
    found = T[..., :3, 3].copy()
    for k in range(5):
        pad = next(np.array(each.point) for each in hand.contacts if each.link == LINKS[k][3])
        found[:, 1 + 4 * k + 3] = transform_points(T[:, 1 + 4 * k + 3], pad)
    return found


def test_both_orders_give_the_same_points(points: np.ndarray):
    mano = np.empty_like(points)
    mano[:, MANO_ORDER] = points
    np.testing.assert_array_equal(KeyPoints(mano).points, KeyPoints(points).points)


def test_contacts_and_palm_are_those_of_the_hand(shadow: Problem, points: np.ndarray):
    scene = shadow.groups[0].scene
    found, theirs = KeyPoints(points).source_grasps(scene.object), source_grasps(scene)
    both = found.touching & theirs.touching
    assert both.sum() >= 2 * len(scene.q)
    # The tip and the pad of a finger that lies flat touch at other points.
    assert np.median(np.linalg.norm(found.point - theirs.point, axis=-1)[both]) < 0.006
    assert (np.einsum("nij,nij->nj", found.axes, theirs.axes) > 0.5).all()
    np.testing.assert_allclose(found.axes.mT @ found.axes, np.tile(np.eye(3), (len(points), 1, 1)), atol=1e-9)
    assert not found.is_left.any()


def test_mirrored_points_are_of_a_left_hand(shadow: Problem, points: np.ndarray):
    assert KeyPoints(points * [1.0, -1.0, 1.0]).source_grasps(shadow.groups[0].scene.object).is_left.all()


def test_tips_touch_up_to_a_distance():
    ball = gr.load_object("sphere:0.03")
    points = np.zeros((1, 21, 3))
    points[0, :, 2] = -0.1 + 0.001 * np.arange(21)
    points[0, 1:, 0] = np.repeat([-0.05, -0.02, 0.0, 0.02, 0.04], 4)
    near, far = 0.03 + TOUCH_M - 1e-4, 0.03 + TOUCH_M + 1e-4
    points[0, [4, 8]] = [[-near, 0, 0], [0, far, 0]]
    found = KeyPoints(points[:, :]).source_grasps(ball)
    assert found.touching[0, :2].tolist() == [True, False]
    np.testing.assert_allclose(found.point[0, 0], [-0.03, 0, 0], atol=1e-5)
    np.testing.assert_allclose(found.normal[0, 0], [-1, 0, 0], atol=1e-3)


def test_tips_of_vertices_are_at_the_published_numbers():
    vertices = np.random.default_rng(0).normal(scale=0.03, size=(2, NUM_VERTICES, 3))
    found = KeyPoints(vertices).points
    np.testing.assert_array_equal(found[:, :5], vertices[:, TIP_VERTICES])


def test_a_transfer_of_key_points_is_near_that_of_the_hand(shadow: Problem, points: np.ndarray):
    allegro, mug = load_hand("allegro"), shadow.groups[0].scene.object
    found = gr.transfer(gr.KeyPoints(points[:2]), mug, to=allegro).outcome
    assert len(found) == 2
    assert np.nanmax(found["original_pinch_shift_m"]) < 0.015
    assert all(": kept" in text for text in found.fingers.tolist())


def test_a_file_of_key_points_is_transferred(points: np.ndarray, tmp_path: Path):
    np.savez(tmp_path / "human.npz", key_points=points[:2], object="mug", scale=1.0)
    spec = ProblemSpec(grasps=tmp_path / "human.npz", transfer_from="mano", hand="allegro", index=(1,))
    problem = load_problem(spec)
    assert problem.names == ("mug",)
    assert problem.groups[0].scene.hand.name == "allegro"
    np.testing.assert_allclose(
        problem.groups[0].scene.original.approach,
        KeyPoints(points[1]).source_grasps(problem.groups[0].scene.object).axes[..., 2],
        atol=1e-12,
    )


@pytest.mark.parametrize("entries", [{"other": np.zeros((1, 21, 3))}, {"key_points": np.zeros((1, 20, 3))}])
def test_a_file_without_points_is_refused(entries: dict[str, np.ndarray], tmp_path: Path):
    np.savez(tmp_path / "human.npz", **entries)
    with pytest.raises(GraspFileError, match=r"human\.npz"):
        load_key_points(tmp_path / "human.npz")
