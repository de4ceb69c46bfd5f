"""Bounds of movement: closed forms, and real refinements that stay within them."""

from dataclasses import replace

import numpy as np
import pytest

from boxed_example import boxed_example
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, exp_so3, log_so3
from grasp_refine.hands.chain import integrate
from grasp_refine.hands.files.defaults import SLIDE_LEVER_M
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.scene import Scene
from refusals import refused

NEAR = MaxMove(translation=0.002, rotation=0.03, joints=0.04)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two example grasps of the embedded hand on the embedded box."""
    return boxed_example().select(slice(2))


def away(T: np.ndarray, q: np.ndarray, T_first: np.ndarray, q_first: np.ndarray) -> tuple[np.ndarray, ...]:
    """How far roots have integrate and turned, and joints at most (M,)."""
    turned = log_so3(T[:, :3, :3] @ T_first[:, :3, :3].mT)
    return (
        np.linalg.norm(T[:, :3, 3] - T_first[:, :3, 3], axis=1),
        np.linalg.norm(turned, axis=1),
        np.abs(q - q_first).max(axis=1),
    )


def poses(count: int, seed: int) -> tuple[np.ndarray, ...]:
    """Poses and joint values, and others at various distances from them."""
    rng = np.random.default_rng(seed)
    T, q = exp_se3(rng.normal(size=(count, 6))), rng.normal(size=(count, 5))
    size = 10.0 ** rng.uniform(-4, 0, (count, 1))
    return T, q, integrate(T, size * rng.normal(size=(count, 6))), q + size * rng.normal(size=q.shape)


def test_what_is_too_far_comes_back_as_far_as_it_may() -> None:
    """On the straight way back: same direction of movement, same axis, each joint by itself."""
    T_first, q_first, T, q = poses(60, 0)
    kept_T, kept_q = NEAR.project(T, q, T_first, q_first, np.ones(q.shape[1]))
    before, after = away(T, q, T_first, q_first), away(kept_T, kept_q, T_first, q_first)
    for limit, far, near in zip((0.002, 0.03, 0.04), before, after, strict=True):
        assert (far > limit).any() and (far < limit).any()
        np.testing.assert_allclose(near, np.minimum(far, limit), atol=1e-12)
    shift, kept_shift = (pose[:, :3, 3] - T_first[:, :3, 3] for pose in (T, kept_T))
    np.testing.assert_allclose(np.cross(shift, kept_shift), 0.0, atol=1e-12)
    turn, kept_turn = (log_so3(pose[:, :3, :3] @ T_first[:, :3, :3].mT) for pose in (T, kept_T))
    np.testing.assert_allclose(np.cross(turn, kept_turn), 0.0, atol=1e-9)
    assert ((turn * kept_turn).sum(axis=1) >= 0.0).all()
    np.testing.assert_array_equal(kept_q, np.clip(q, q_first - 0.04, q_first + 0.04))
    R = kept_T[:, :3, :3]
    np.testing.assert_allclose(R @ R.mT, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)


@pytest.mark.parametrize("name", ["translation", "rotation", "joints"])
def test_each_bound_is_one_of_its_own(name: str) -> None:
    T_first, q_first, T, q = poses(10, 3)
    kept = away(*MaxMove(**{name: 0.0}).project(T, q, T_first, q_first, np.ones(q.shape[1])), T_first, q_first)
    free = away(T, q, T_first, q_first)
    for bound, found, before in zip(("translation", "rotation", "joints"), kept, free, strict=True):
        np.testing.assert_allclose(found, 0.0 if bound == name else before, atol=1e-12)


def test_slides_move_by_a_tenth_of_a_metre_per_radian() -> None:
    T, q = np.eye(4)[None], np.array([[1.0, 1.0, -1.0]])
    _, kept = MaxMove(joints=0.2).project(T, q, T, np.zeros((1, 3)), np.array([1.0, SLIDE_LEVER_M, SLIDE_LEVER_M]))
    np.testing.assert_allclose(kept, [[0.2, 0.02, -0.02]], atol=1e-15)


@pytest.mark.parametrize("angle", [1e-9, 3.0, np.pi - 1e-6, np.pi])
def test_turns_of_any_angle_are_bounded(angle: float) -> None:
    """Half a turn has two axes, and either will do."""
    T = np.eye(4)[None].copy()
    T[0, :3, :3] = exp_so3(angle * np.array([0.6, 0.0, 0.8]))
    kept, _ = MaxMove(rotation=0.5).project(T, np.zeros((1, 0)), np.eye(4)[None], np.zeros((1, 0)), np.ones(0))
    assert np.linalg.norm(log_so3(kept[0, :3, :3])) == pytest.approx(min(angle, 0.5), abs=1e-9)
    np.testing.assert_allclose(kept[0, :3, :3] @ kept[0, :3, :3].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("name", ["translation", "rotation", "joints"])
@pytest.mark.parametrize("value", [-0.01, np.nan])
def test_what_is_no_distance_is_refused(name: str, value: float) -> None:
    with refused(GraspRefineError, name, f"{value:g}"):
        MaxMove(**{name: value})


# refinements

SHORT = Config(solver=LevenbergMarquardt(iterations=12), starts=2)


def refined(scene: Scene, bounds: MaxMove) -> Refinement:
    return refine(scene, replace(SHORT, max_move=bounds))


@pytest.mark.parametrize("bounds", [NEAR, MaxMove(rotation=0.01), MaxMove(translation=0.001, joints=0.02)])
def test_refined_grasps_are_no_farther_than_they_may(scene: Scene, bounds: MaxMove) -> None:
    """Whatever was tried on the way, other starts included."""
    found = refined(scene, bounds)
    distances = away(found.T_world_root, found.q, scene.T_world_root, scene.q)
    for name, distance in zip(("translation", "rotation", "joints"), distances, strict=True):
        assert (distance <= getattr(bounds, name) + 1e-9).all()
    assert (found.loss[:, 1] < found.loss[:, 0]).any()


def test_a_bound_of_nothing_keeps_the_grasp(scene: Scene) -> None:
    found = refined(scene, MaxMove(0.0, 0.0, 0.0))
    np.testing.assert_allclose(found.T_world_root, scene.T_world_root, atol=1e-12)
    np.testing.assert_array_equal(found.q, scene.q)
    np.testing.assert_allclose(found.loss[:, 1], found.loss[:, 0], rtol=1e-9)
