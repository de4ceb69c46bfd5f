"""Every term of the loss against finite differences, by least squares and by autograd, on slides and a mimic joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, sphere
from grasp_refine.hands.chain import integrate
from grasp_refine.objects.region import Box, ContactRegions, HalfSpace
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.derivative_check import finite_differences, gradients, relative_errors
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.objective import Objective
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.scene import Scene
from grasp_refine.witness.finite_difference import FiniteDifference
from sliding_gripper import OBJECTS, around_object, shallow, sliding_gripper

COUNT = 12
"""Grasps of each case."""

DEPTH = 0.006
"""Largest depth of hands in the object, metres: half of a link's radius."""

WEIGHT = 0.7

EXACT, TOLERANCES = 1e-5, {"contact": 0.02, "wrench": 0.06, "direction": 0.02, "region": 0.02}
"""Largest relative error of a gradient; curvatures at edges and vertices are those of small radii."""

SMALLEST_GRADIENT = 1e-5
"""Gradients below this, in m, count as zero."""

REGIONS = ContactRegions(
    (Box("right", np.array([0.004, -1.0, -1.0]), np.array([1.0, 0.006, 1.0])), HalfSpace("low", -np.eye(3)[2], 0.02)),
    (HalfSpace("tilted", np.array([0.6, 0.0, 0.8]), 0.018),),
)
"""Regions whose borders are all over the objects."""


@pytest.fixture(scope="module", params=list(OBJECTS))
def many(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Hands around an object, of spheres, boxes or meshes."""
    hand = sliding_gripper(tmp_path_factory.mktemp(request.param), request.param, candidates=1024)
    scene = around_object(hand, 600, 1, OBJECTS[request.param], table=True)
    return replace(scene, task=replace(scene.task, scene=beside(0.004), touch=REGIONS.touch, avoid=REGIONS.avoid))


def beside(margin: float) -> Environment:
    """A ball and a tilted corner of two boxes beside the object, and a body far away, in a turned world."""
    far, T_world_object = np.eye(4), exp_se3(np.array([0.3, -0.2, 0.7, 0.4, 1.1, -0.6]))
    far[0, 3] = 9.0
    corner = [box([0.1, 0.06, 0.02]), box([0.02, 0.06, 0.1])]
    T = exp_se3(np.array([[-0.06, -0.01, -0.07, 0.3, 0.5, 0.2], [0.055, 0.02, 0.01, 0.0, 0.0, 0.0]]))
    parts = ("ball", [sphere(0.03)], T[1]), ("corner", corner, T[0]), ("far", [sphere(0.1)], far)
    bodies = [EnvironmentBody(n, build_body(n, pieces), T_world_object @ T, margin) for n, pieces, T in parts]
    return Environment(tuple(bodies), T_world_object)


def with_goal(scene: Scene, name: str) -> Goal:
    """Three links touch, one of them along a normal; for contacts two at targets; for regions two touch, one at one."""
    number = 2 if name == "region" else 3
    rng, goal = np.random.default_rng(2), goal_of(scene, ContactSelection(links=scene.links[:number]))
    targets = np.full((2, COUNT, len(scene.links), 3), np.nan)
    direction = targets[0].copy()
    n = rng.normal(size=(COUNT, 3))
    direction[:, 0] = n / np.linalg.norm(n, axis=-1, keepdims=True)
    if aimed := {"contact": 2, "region": 1}.get(name):
        targets[:, :, :aimed] = rng.normal(size=(2, COUNT, aimed, 3)) * [[[[0.02]]], [[[0.03]]]]
    return replace(goal, target_link=targets[0], target_object=targets[1], direction=direction)


@pytest.mark.parametrize("name", term_kinds())
def test_every_term_has_the_loss_and_gradient_of_finite_differences_both_ways(many: Scene, name: str) -> None:
    """Least squares and autograd have the same loss, and its central differences."""
    itself, kind = name == "self_penetration", term_kinds()[name]
    scene = shallow(many, COUNT, 5 * DEPTH if itself else DEPTH, itself=itself)
    goal, nothing = with_goal(scene, name), dict.fromkeys(term_kinds(), 0.0)
    weights = Weights(**{**nothing, name: WEIGHT})
    config = Config(weights=weights, margin=1e-3, clearance=5e-4, derivative=FiniteDifference(step=1e-4))
    # Not where the hands began, so that there is something to stay near to.
    dx = np.random.default_rng(3).normal(size=(COUNT, 8)) * [5e-4, 5e-4, 5e-4, 0.02, 0.02, 0.02, 5e-4, 0.02]
    if name == "joint_limits":
        dx[:, 6:] = [0.03, 0.7]
    first, rows = Point(integrate(scene.T_world_root, dx[:, :6]), scene.q + dx[:, 6:]), np.arange(COUNT)
    problems = [GraspProblem(scene, goal, config)] if kind.least_squares else []
    problems += [Objective(scene, goal, replace(config, solver=Adam()))] if kind.autograd else []

    expected, loss = finite_differences(problems[0], first), problems[0].evaluate(rows, first, None).loss
    assert (np.linalg.norm(expected, axis=1) > SMALLEST_GRADIENT).sum() >= 3
    for problem in problems:
        np.testing.assert_allclose(problem.evaluate(rows, first, None).loss, loss, rtol=1e-6, atol=1e-12)
        error = relative_errors(gradients(problem, first), expected, SMALLEST_GRADIENT)
        # A face or an edge may change within a step, or by a new query.
        assert np.sort(error)[-2] < TOLERANCES.get(name, EXACT), (type(problem).__name__, error)
