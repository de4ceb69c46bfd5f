"""Losses of terms on hands and objects of balls, whose distances and witness points are known in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from grasp_refine.core.se3 import Array, exp_se3, transform_points
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region import HalfSpace
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.derivative_check import finite_differences, gradients, relative_errors
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.objective import Objective
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.penetration import depths
from grasp_refine.refinement.terms.region import INSIDE_M
from grasp_refine.refinement.terms.term import State, Term
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.goal import Goal
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import made_hand
from plate_gripper import PARTS
from sliding_gripper import around_object, sliding_gripper

COUNT, RADIUS, MARGIN, CLEARANCE, WEIGHT = 40, 0.03, 1e-3, 4e-3, 0.7
BODIES = {"near": (0.03, (0.065, 0.01, 0.02), 5e-3), "beside": (0.03, (-0.06, 0.02, 0.0), 0.0)}
"""Balls around the object: radius, centre in the object's frame, and margin, metres."""
BORDER = HalfSpace("right", np.array([0.8, 0.0, 0.6]), 0.004)
"""Region that links should touch."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Hands of four balls about a ball, beside others and above a tilted table; the thumb is no contact link."""
    hand = sliding_gripper(tmp_path_factory.mktemp("gripper"), candidates=64)
    hand = replace(hand, contacts=tuple(contact for contact in hand.contacts if contact.link != "thumb"))
    scene = around_object(hand, COUNT, 5, f"sphere:{RADIUS}", table=True)
    # Every other hand is closed, its thumb between the fingers.
    scene.q[::2] = np.random.default_rng(8).uniform([0.0, 0.3], [0.005, 0.9], (COUNT // 2, 2))
    T_world_object = exp_se3(np.array([0.3, -0.2, 0.7, 0.4, 1.1, -0.6]))
    bodies = []
    for name, (radius, center, margin) in BODIES.items():
        T = exp_se3(np.array([*center, 0.0, 0.0, 0.0]))
        bodies.append(EnvironmentBody(name, build_body(name, [sphere(radius)]), T_world_object @ T, margin))
    around = Environment(tuple(bodies), T_world_object, lift=0.0)
    return replace(scene, task=replace(scene.task, scene=around, touch=(BORDER,)))


@pytest.fixture(scope="module")
def goal(scene: Scene) -> Goal:
    """Some links should touch anywhere, some at targets, some along normals, and some nowhere."""
    rng, shape = np.random.default_rng(6), (COUNT, len(scene.links))
    aimed = rng.random(shape) < 0.25
    targets = np.where(aimed[..., None], rng.normal(size=(2, *shape, 3)) * 0.02, np.nan)
    n = rng.normal(size=(*shape, 3))
    touching = aimed | (rng.random(shape) < 0.4)
    asked = touching & (rng.random(shape) < 0.5)
    direction = np.where(asked[..., None], n / np.linalg.norm(n, axis=-1, keepdims=True), np.nan)
    return replace(
        Goal.nothing(*shape), touching=touching, target_link=targets[0], target_object=targets[1], direction=direction
    )


def expected_loss(name: str, scene: Scene, goal: Goal) -> np.ndarray:
    """Loss (COUNT,) of a term in closed form, from the centres of the links by pytorch-kinematics."""
    bodies = [scene.hand.links_by_name[link].body.pieces[0] for link in scene.links]
    radius, middle = np.array([one.radius for one in bodies]), np.array([one.vertices[0] for one in bodies])
    T = Kinematics(scene.hand, scene.links)(torch.from_numpy(scene.T_world_root), torch.from_numpy(scene.q)).numpy()
    center = transform_points(T, middle)
    away = np.linalg.norm(center, axis=-1)
    outward, distance = center / away[..., None], away - radius - RADIUS
    on_link, on_object = center - radius[:, None] * outward, RADIUS * outward
    anywhere = goal.touching & ~goal.aimed
    clearance = np.where(np.array(scene.links) == "thumb", CLEARANCE, 0.0)
    if name == "contact":
        misses = (
            np.nan_to_num(on_link - transform_points(T, goal.target_link)),
            np.nan_to_num(on_object - goal.target_object),
        )
        squares = np.where(goal.aimed, (distance - MARGIN) ** 2 + sum((miss**2).sum(axis=-1) for miss in misses), 0.0)
        return (squares + np.where(anywhere, (distance - MARGIN - clearance) ** 2, 0.0)).sum(axis=1)
    if name == "penetration":
        depth = np.where(goal.aimed, 0.0, clearance) - distance
    elif name == "self_penetration":
        first, second = HandObject.of(scene).self_collision_links
        depth = radius[first] + radius[second] - np.linalg.norm(center[:, first] - center[:, second], axis=-1)
    elif name == "table":
        depth = scene.table.offset + radius - center @ scene.table.normal
    elif name == "environment":
        depth = np.concatenate(
            [margin + radius + r - np.linalg.norm(center - at, axis=-1) for r, at, margin in BODIES.values()], axis=1
        )
    elif name == "region":
        outside = BORDER.offset - on_object @ BORDER.normal + INSIDE_M
        room = CONTACTS.cutoff(scene.hand, scene.links) - distance
        depth = np.where(anywhere, outside, np.where(goal.aimed, 0.0, np.minimum(outside, room)))
    elif name == "direction":
        return np.nansum((-outward - goal.direction) ** 2, axis=(1, 2))
    elif name == "joint_limits":
        depth = np.maximum(scene.q - scene.hand.upper, scene.hand.lower - scene.q)
    return (np.maximum(depth, 0.0) ** 2).sum(axis=1)


@pytest.mark.parametrize("name", sorted(set(term_kinds()) - {"stay_near", "wrench"}))
def test_losses_of_balls_are_in_closed_form_for_both_kinds_of_solvers(name: str, scene: Scene, goal: Goal) -> None:
    if name == "joint_limits":
        scene = replace(scene, q=scene.q + np.random.default_rng(7).normal(size=scene.q.shape) * [0.02, 0.5])
    weights = Weights(**{**dict.fromkeys(term_kinds(), 0.0), name: WEIGHT})
    config, kind = Config(weights=weights, margin=MARGIN, clearance=CLEARANCE), term_kinds()[name]
    point, rows = Point(scene.T_world_root, scene.q), np.arange(COUNT)
    # Where no link should touch, all that are near keep out of regions.
    for aim in (goal, Goal.nothing(*goal.touching.shape)) if name == "region" else (goal,):
        expected = expected_loss(name, scene, aim)
        assert (expected > 1e-6).sum() >= 8, "few grasps have a loss"
        problems = [GraspProblem(scene, aim, config)] if kind.least_squares else []
        problems += [Objective(scene, aim, replace(config, solver=Adam()))] if kind.autograd else []
        for problem in problems:
            found = problem.evaluate(rows, point, None).loss
            np.testing.assert_allclose(found, WEIGHT * expected, rtol=1e-6, atol=1e-12, err_msg=type(problem).__name__)


class Depths(Term):
    """Depths of links in the object, with residuals alone."""

    def residuals(self, state: State) -> tuple[Array, ...]:
        return (depths(state.witness),)


def test_own_terms_see_all_links_and_have_derivatives_by_autograd(scene: Scene) -> None:
    """Also where no term of ours asks for links that should not touch."""
    none = Goal.nothing(COUNT, len(scene.links))
    config = Config(weights=Weights(**dict.fromkeys(term_kinds(), 0.0)), terms=(Depths(),))
    expected = expected_loss("penetration", scene, replace(none, target_link=np.zeros_like(none.target_link)))
    point = Point(scene.T_world_root, scene.q)
    for kind, solver in ((GraspProblem, LevenbergMarquardt()), (Objective, Adam())):
        problem = kind(replace(scene, task=Task()), none, replace(config, solver=solver))
        np.testing.assert_allclose(problem.evaluate(np.arange(COUNT), point, None).loss, expected, rtol=1e-6)
        slopes = finite_differences(problem, point)
        assert (np.linalg.norm(slopes, axis=1) > 1e-4).sum() >= 8
        assert relative_errors(gradients(problem, point), slopes, 1e-5).max() < 1e-5


def test_bodies_without_a_link_near_them_cost_nothing(scene: Scene, tmp_path: Path) -> None:
    """Also at the padding of grasps with fewer pairs than others."""
    apart = scene.T_world_root[:2].copy()
    apart[0, :3, 3] = [0.0, -0.2, 0.0]
    two = replace(scene, T_world_root=apart, q=scene.q[:2])
    only = Weights(**{**dict.fromkeys(term_kinds(), 0.0), "environment": 1.0})
    goal, point = Goal.nothing(2, len(scene.links)), Point(two.T_world_root, two.q)
    for problem in (
        GraspProblem(two, goal, Config(weights=only)),
        Objective(two, goal, Config(weights=only, solver=Adam())),
    ):
        assert problem.evaluate(np.arange(2), point, None).loss[0] == 0.0


def test_corners_of_a_patch_count_as_much_as_one_gap_by_the_weight_of_the_patch(tmp_path: Path) -> None:
    """Two plates at a box, turned by up to 0.3 rad: the weight falls as faces tilt apart."""
    hand, angles = made_hand(tmp_path, *PARTS, candidates=64), np.linspace(0.0, 0.3, 6)
    T = exp_se3(np.stack([np.zeros(6), np.zeros(6), np.full(6, -0.05), 0.5 * angles, angles, np.zeros(6)], axis=1))
    scene = Scene(hand, load_object("box:0.04,0.04,0.04"), T, np.tile([0.062, -0.062], (6, 1)))
    touching = np.tile(np.isin(scene.links, ["left", "right"]), (6, 1))
    goal = replace(Goal.nothing(6, len(scene.links)), touching=touching)
    config = Config(weights=Weights(**{**dict.fromkeys(term_kinds(), 0.0), "contact": 1.0}))
    found = GraspProblem(scene, goal, config).evaluate(np.arange(6), Point(scene.T_world_root, scene.q), None)
    faces, gap = found.patches.faces, np.where(touching, found.witness.distance, 0.0)
    corners = np.where(faces.there, faces.gap, 0.0) ** 2
    share = faces.weight / np.maximum(faces.count, 1)
    assert ((faces.weight > 0.01) & (faces.weight < 0.9)).sum() >= 3
    expected = (gap**2).sum(axis=1) + (share * corners.sum(axis=-1)).sum(axis=1)
    np.testing.assert_allclose(found.loss, expected, rtol=1e-9)
    assert (expected - (gap**2).sum(axis=1) > 1e-8).sum() >= 3
