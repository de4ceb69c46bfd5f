"""Refinement of hands on arms: the base stands still, and grasps are those of the hand without the arm."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, exp_so3, transform, transform_from_pose
from grasp_refine.forces.squeeze import squeezed
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.refinement.variables import MAX_STEP, variables
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.scene import Scene

FEW = LevenbergMarquardt(iterations=12)

T_BASE = transform_from_rpy([-0.45, 0.05, -0.15, 0, 0, 20])


@pytest.fixture(scope="module")
def hand() -> Hand:
    """Return a hand of many fingers."""
    return load_hand("allegro", candidates=128)


@pytest.fixture(scope="module")
def whole(hand: Hand) -> Hand:
    """Return it on an arm."""
    return mount(load_hand("ur5e", candidates=32), hand)


@pytest.fixture(scope="module")
def box() -> Object:
    """Return the object."""
    return load_object("box:0.06,0.06,0.12")


@pytest.fixture(scope="module")
def grasps(hand: Hand, box: Object) -> GraspSet:
    """Return grasps of the hand alone."""
    return sample_grasps(hand, box, 3, seed=2)


@pytest.fixture(scope="module")
def scene(whole: Hand, box: Object, grasps: GraspSet) -> Scene:
    """Return the same grasps on the arm."""
    placed, _ = on_arm(grasps, whole, T_BASE)
    return Scene(whole, box, placed.hand_pose, placed.q)


def test_palms_on_the_arm_are_where_the_grasps_have_them(scene: Scene, grasps: GraspSet, whole: Hand) -> None:
    """To a micrometre, with the base where it was told to be."""
    moved, turned = distances(transform_from_pose(grasps.hand_pose), palm_poses(whole, scene.T_world_root, scene.q))
    assert moved.max() < 1e-6 and turned.max() < 1e-6
    np.testing.assert_allclose(scene.T_world_root, np.tile(T_BASE, (3, 1, 1)), atol=1e-12)
    np.testing.assert_array_equal(scene.q[:, ~whole.arm_joints], grasps.q)


def test_refined_grasps_on_an_arm_touch_as_without_it_and_the_base_stands_still(
    scene: Scene, hand: Hand, box: Object, grasps: GraspSet, whole: Hand
) -> None:
    """The base has the same bits; both converge, with the arm's joints within their limits."""
    free = refine(Scene(hand, box, grasps.hand_pose, grasps.q), Config(starts=2))
    found = refine(scene, Config(starts=2))
    np.testing.assert_array_equal(found.T_world_root, scene.T_world_root)
    assert found.loss[:, 1].max() < 1e-5 and free.loss[:, 1].max() < 1e-5
    assert not np.isin(found.status, UNUSABLE).any()
    assert (found.q >= whole.lower).all() and (found.q <= whole.upper).all()
    assert found.touching[:, :4].sum() == free.touching[:, :4].sum()
    # The arm had to move: the palms of the free hand did, too.
    assert (np.abs(found.q - scene.q)[:, whole.arm_joints].max(axis=1) > 1e-4).all()


def test_arm_of_a_grasp_that_is_out_of_reach_is_reported(scene: Scene) -> None:
    """Its status says so, it is returned as it was, and others do not notice."""
    q = scene.q.copy()
    q[1, scene.hand.arm_joints] = np.nan
    found = refine(replace(scene, q=q), Config(FEW, starts=1))
    assert found.status[1] == Status.OUT_OF_REACH and "`base`" in Status.OUT_OF_REACH.advice
    np.testing.assert_array_equal(found.q[1], q[1])
    alone = refine(scene.select(np.array([0])), Config(FEW, starts=1))
    np.testing.assert_allclose(found.q[0], alone.q[0], atol=1e-8)
    q[1, ~scene.hand.arm_joints] = np.nan
    assert refine(replace(scene, q=q), Config(FEW, starts=1)).status[1] == Status.NOT_FINITE


def test_steps_of_the_arm_are_bounded_by_how_far_they_move_the_palm(scene: Scene) -> None:
    """A step of all joints moves the palm by at most the largest step, to first order, and the base not at all."""
    unknowns = variables(scene, MaxMove())
    rows = np.arange(3)
    at = Point(scene.T_world_root, scene.q)
    dx = np.zeros((3, 6 + scene.q.shape[1]))
    dx[:, :6] = 1.0
    dx[:, 6 + np.flatnonzero(scene.hand.arm_joints)] = [0.3, -0.2, 0.4, 0.1, 0.2, -0.3]
    after = unknowns.integrate(rows, at, dx)
    np.testing.assert_array_equal(after.T, scene.T_world_root)
    moved, turned = distances(unknowns.palm(at), unknowns.palm(after))
    assert (moved < 1.1 * MAX_STEP[0]).all() and (turned < 1.1 * MAX_STEP[1]).all() and (moved > 0.02).all()
    lower, upper = unknowns.step_bounds(rows, at)
    assert (lower[:, :6] == 0).all() and (upper[:, :6] == 0).all()


def test_metric_of_an_arm_joint_is_the_squared_movement_of_the_palm(scene: Scene) -> None:
    """By finite differences: metres of its origin, and 0.05 m for each radian."""
    unknowns = variables(scene, MaxMove())
    metric = unknowns.metric(np.arange(3))
    h = 1e-6
    for joint in np.flatnonzero(scene.hand.arm_joints):
        step = np.zeros_like(scene.q)
        step[:, joint] = h
        a, b = (unknowns.palm(Point(scene.T_world_root, scene.q + sign * step)) for sign in (-1, 1))
        moved, turned = distances(a, b)
        expected = (moved / (2 * h)) ** 2 + (0.05 * turned / (2 * h)) ** 2
        np.testing.assert_allclose(metric[:, 6 + joint], expected, rtol=1e-5)


def test_largest_movement_is_that_of_the_palm(scene: Scene) -> None:
    """Bounds hold for palm and fingers, and leave the arm's joints free."""
    bounds = MaxMove(translation=0.004, rotation=0.03, joints=0.1)
    found = refine(scene, Config(FEW, starts=1, max_move=bounds))
    hand = scene.hand
    before, after = palm_poses(hand, scene.T_world_root, scene.q), palm_poses(hand, found.T_world_root, found.q)
    moved, turned = distances(before, after)
    assert moved.max() <= 0.004 + 1e-9 and turned.max() <= 0.03 + 1e-9
    assert np.abs(found.q - scene.q)[:, ~hand.arm_joints].max() <= 0.1 + 1e-12
    assert moved.max() > 1e-4


def test_movement_from_the_start_is_measured_at_the_palm(scene: Scene) -> None:
    """Rows of staying near, by finite differences in the joints."""
    from grasp_refine.refinement.grasp_problem import GraspProblem
    from grasp_refine.refinement.terms.stay_near import StayNear
    from grasp_refine.scene.goal import Goal

    goal = Goal.nothing(3, len(scene.links))
    problem = GraspProblem(scene, goal, Config(weights=Weights(stay_near=1.0)))
    term = next(term for _, term in problem.terms if isinstance(term, StayNear))
    rows, rng = np.arange(3), np.random.default_rng(0)
    q = np.clip(scene.q + 0.05 * rng.normal(size=scene.q.shape), scene.hand.lower, scene.hand.upper)
    state = problem.evaluate(rows, Point(scene.T_world_root, q), None)
    (found,) = term.rows(state, np.ones(3))
    h = 1e-6
    for joint in (0, 3, 5, 9):
        step = np.zeros_like(q)
        step[:, joint] = h
        a, b = (
            term.residuals(problem.evaluate(rows, Point(scene.T_world_root, q + sign * step), None))[0]
            for sign in (-1, 1)
        )
        np.testing.assert_allclose(found.jacobian[:, :, 6 + joint], (b - a) / (2 * h), atol=2e-3)


def test_squeeze_closes_the_fingers_and_not_the_arm(scene: Scene) -> None:
    """Set points of the arm are its joint values, to the last bit."""
    found = refine(scene, Config(FEW, starts=1))
    after = replace(scene, q=found.q)
    arm = scene.hand.arm_joints
    pressed = squeezed(after)
    np.testing.assert_array_equal(pressed[:, arm], found.q[:, arm])
    assert (np.abs(pressed - found.q)[:, ~arm].max(axis=1) > 0.01).all()


def test_grasp_turns_with_the_whole_scene(scene: Scene, whole: Hand, box: Object) -> None:
    """Another place of the base, with the same palms, gives other arms; the same arms move with the base."""
    T = transform(exp_so3(np.array([0.2, 0.1, 0.4])), np.array([0.1, 0.2, 0.3]))
    kinematics = ArmKinematics(whole)
    palm = kinematics.palm(scene.T_world_root, scene.q)
    np.testing.assert_allclose(kinematics.palm(T @ scene.T_world_root, scene.q), T @ palm, atol=1e-12)
    np.testing.assert_allclose(
        kinematics.dexterity(T @ scene.T_world_root, scene.q), kinematics.dexterity(scene.T_world_root, scene.q),
        atol=1e-12,
    )  # fmt: skip


def test_noise_moves_palms_on_an_arm_as_on_a_free_hand(scene: Scene) -> None:
    """Restarts displace the palm by the same twist, as far as the arm reaches."""
    unknowns = variables(scene, MaxMove())
    dx = np.zeros((3, 6 + scene.q.shape[1]))
    dx[:, :6] = [0.004, -0.003, 0.002, 0.05, -0.02, 0.04]
    at = Point(scene.T_world_root, scene.q)
    after = unknowns.displace(np.arange(3), at, dx)
    wanted = integrate(unknowns.palm(at), dx[:, :6])
    moved, turned = distances(wanted, unknowns.palm(after))
    assert moved.max() < 1e-6 and turned.max() < 1e-6
    own = ~scene.hand.arm_joints
    np.testing.assert_array_equal(after.q[:, own], scene.q[:, own])


def test_first_order_solvers_refuse_an_arm(scene: Scene) -> None:
    """The message names the solver that moves one."""
    with pytest.raises(GraspRefineError, match="levenberg-marquardt"):
        refine(scene, Config(solver=Descent(iterations=1)))


def test_links_of_the_arm_are_no_contacts(scene: Scene, whole: Hand) -> None:
    """However near they are: an object at the forearm is touched by no link that should."""
    from grasp_refine.refinement.grasp_problem import GraspProblem
    from grasp_refine.scene.contact_selection import ContactSelection
    from grasp_refine.scene.goal import goal_of

    T = Chain(whole, ["forearm_link"])(np.eye(4)[None], whole.rest[None]).T_world_link[0, 0]
    base = np.eye(4)
    base[:3, 3] = -(T @ [-0.2, 0.0, 0.09, 1.0])[:3]
    near = Scene(whole, scene.object, base, whole.rest)
    goal = goal_of(near, ContactSelection(), None)
    assert whole.arm is not None
    of_arm = np.isin(near.links, list(whole.arm.links))
    assert not goal.touching[:, of_arm].any()
    problem = GraspProblem(near, goal, Config())
    witness = problem.evaluate(np.arange(1), Point(near.T_world_root, near.q), None).witness
    assert np.nanmin(witness.distance[:, of_arm]) < 0.03
