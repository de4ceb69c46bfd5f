"""Devices: everything but collision queries runs where it is asked to.

Without a GPU, a default device on which numbers cannot be read stands for "another device": a tensor that is made
without saying where would end up there, and could not be used with the others. With one, results are compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from boxed_example import boxed_example
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.objective import Objective
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.scene import Scene
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.zeroth_order import ZerothOrder

METHODS = [ContactKinematics(), Distance(), Direction(), Analytical(), ZerothOrder(), FiniteDifference()]

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device is here")


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Grasps of the embedded hand on the embedded box."""
    return boxed_example().select(slice(2))


@pytest.fixture
def elsewhere() -> Iterator[None]:
    """A default device that is none."""
    before = torch.get_default_device()
    torch.set_default_device("meta")
    yield
    torch.set_default_device(before)


def objective(scene: Scene, config: Config) -> Objective:
    return Objective(scene, goal_of(scene, config.contact_selection, nearest=config.nearest), config)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
@pytest.mark.parametrize("nearest", [False, True], ids=["anywhere", "targets"])
def test_losses_and_gradients_leave_no_tensor_elsewhere(
    scene: Scene, method: Derivative, nearest: bool, request: pytest.FixtureRequest
):
    config = Config(solver=Descent(transport=True), derivative=method, nearest=nearest)
    of = objective(scene, config)
    start = Point(scene.T_world_root, scene.q)
    expected = of.evaluate(np.arange(2), start, None)
    request.getfixturevalue("elsewhere")
    found = of.evaluate(np.arange(2), start, None)
    np.testing.assert_allclose(found.loss, expected.loss)
    np.testing.assert_allclose(found.gradient, expected.gradient)


@needs_gpu
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
def test_a_gpu_finds_what_the_cpu_finds(scene: Scene, method: Derivative, dtype: str):
    config = Config(solver=Descent(iterations=5, transport=True), derivative=method, nearest=True, dtype=dtype)
    on_cpu, on_gpu = (refine(scene, replace(config, device=device)) for device in ("cpu", "cuda"))
    tolerance = 1e-9 if dtype == "float64" else 1e-3
    np.testing.assert_allclose(on_gpu.loss, on_cpu.loss, rtol=tolerance)
    np.testing.assert_allclose(on_gpu.q, on_cpu.q, atol=tolerance)
    np.testing.assert_allclose(on_gpu.T_world_root, on_cpu.T_world_root, atol=tolerance)
