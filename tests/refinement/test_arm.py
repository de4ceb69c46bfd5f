"""Refinement of hands on arms: the base stands still, and grasps are those of the hand without the arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, exp_so3, inverse, log_so3, matvec, transform
from grasp_refine.forces.squeeze import squeezed
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.closing import close_hands
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import (
    START_JOINTS_RAD,
    START_ROTATION_RAD,
    START_TRANSLATION_M,
    Search,
)
from grasp_refine.refinement.grasp_problem import GraspProblem, sample_noise
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.pinches import finger_room
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.refinement.terms.stay_near import StayNear
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from grasp_refine.refinement.variables import MAX_STEP, variables
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from sliding_gripper import sliding_gripper

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


def test_refined_grasps_on_an_arm_touch_as_without_it_and_the_base_stands_still(
    scene: Scene, hand: Hand, box: Object, grasps: GraspSet, whole: Hand
) -> None:
    """The base has the same bits; both converge, with the arm's joints within their limits."""
    config = Config(weights=Weights(wrench=0.0))
    free = refine(Scene(hand, box, grasps.hand_pose, grasps.q), config)
    found = refine(scene, config)
    np.testing.assert_array_equal(found.T_world_root, scene.T_world_root)
    assert found.loss[:, 1].max() < 2e-5 and free.loss[:, 1].max() < 2e-5
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


def test_movement_from_the_start_is_measured_at_the_palm(sliding: Scene) -> None:
    """Rows of staying near, by finite differences in the joints."""
    scene = sliding
    goal = Goal.nothing(4, len(scene.links))
    problem = GraspProblem(scene, goal, Config(weights=Weights(stay_near=1.0)))
    term = next(term for _, term in problem.terms if isinstance(term, StayNear))
    rows, rng = np.arange(4), np.random.default_rng(0)
    q = np.clip(scene.q + 0.05 * rng.normal(size=scene.q.shape), scene.hand.lower, scene.hand.upper)
    state = problem.evaluate(rows, Point(scene.T_world_root, q), None)
    (found,) = term.rows(state, np.ones(4))
    h = 1e-6
    for joint in range(q.shape[1]):
        step = np.zeros_like(q)
        step[:, joint] = h
        a, b = (
            term.residuals(problem.evaluate(rows, Point(scene.T_world_root, q + sign * step), None))[0]
            for sign in (-1, 1)
        )
        np.testing.assert_allclose(found.jacobian[:, :, 6 + joint], (b - a) / (2 * h), atol=2e-3)


@pytest.fixture(scope="module")
def sliding(tmp_path_factory: pytest.TempPathFactory, box: Object) -> Scene:
    """Four grasps of a gripper of slides and a hinge on an arm, anywhere."""
    hand = mount(load_hand("ur5e", candidates=32), sliding_gripper(tmp_path_factory.mktemp("gripper"), candidates=32))
    rng, lower, upper = np.random.default_rng(3), np.maximum(hand.lower, -1.5), np.minimum(hand.upper, 1.5)
    q = lower + (upper - lower) * rng.uniform(0.3, 0.7, (4, len(lower)))
    return Scene(hand, box, np.tile(T_BASE, (4, 1, 1)), q)


def test_palms_beyond_their_bounds_come_back_on_the_way_of_the_arm(sliding: Scene) -> None:
    """All joints of the arm by the same share, to the bound; joints of the hand are bounded each by itself."""
    bounds, hand, member = MaxMove(translation=0.01, rotation=0.05, joints=0.1), sliding.hand, np.array([2, 0, 3, 1])
    arm, first = hand.arm_joints, sliding.q[member]
    arm_q = np.flatnonzero(arm)
    away = np.zeros_like(first)
    away[:, arm_q] = 1e-3
    away[1, arm_q[0]], away[2, arm_q[-1]] = 0.2, 0.3  # the first joint moves the palm, the last one turns it
    away[:, ~arm] = [0.004, 0.3]
    unknowns = variables(sliding, bounds)
    found = unknowns.project(member, Point(sliding.T_world_root[member], first + away))
    np.testing.assert_array_equal(found.T, sliding.T_world_root[member])
    np.testing.assert_allclose((found.q - first)[:, ~arm], np.tile([0.004, 0.1], (4, 1)), atol=1e-12)
    share = ((found.q - first) / np.where(arm, away, 1.0))[:, arm]
    np.testing.assert_allclose(share, share[:, :1] + 0.0 * share, atol=1e-9)
    np.testing.assert_array_equal(found.q[[0, 3]][:, arm], (first + away)[[0, 3]][:, arm])
    start = Point(sliding.T_world_root[member], first)
    moved, turned = distances(unknowns.palm(start), unknowns.palm(found))
    assert moved[1] == pytest.approx(0.01, rel=1e-5) and turned[2] == pytest.approx(0.05, rel=1e-5)
    assert moved.max() <= 0.01 and turned.max() <= 0.05
    # A slide is bounded by 0.1 m per radian.
    away[:, ~arm] = [0.02, 0.0]
    far = unknowns.project(member, Point(sliding.T_world_root[member], first + away))
    np.testing.assert_allclose((far.q - first)[:, ~arm][:, 0], 0.01, atol=1e-12)


def test_links_that_stand_on_the_table_with_the_base_do_not_count(sliding: Scene) -> None:
    """The depths of all others are those of their lowest vertices."""
    height = float(T_BASE[2, 3]) + 0.25
    scene = replace(sliding, task=Task(table=height))
    weights = Weights(**{**dict.fromkeys(term_kinds(), 0.0), "table": 1.0})
    problem = GraspProblem(scene, Goal.nothing(4, len(scene.links)), Config(weights=weights))
    known = problem.evaluate(np.arange(4), Point(scene.T_world_root, scene.q), None)
    depth = np.zeros((4, len(scene.links)))
    for column, body in enumerate(problem.prepared.bodies):
        for piece in body.pieces:
            z = (piece.vertices @ known.T_link[:, column, 2, :3].T).min(axis=0) + known.T_link[:, column, 2, 3]
            depth[:, column] = np.maximum(depth[:, column], height - z + piece.radius)
    stands = np.isin(scene.links, list(scene.hand.arm.standing))
    assert (depth[:, stands] > 0).all() and (depth[:, ~stands] > 0).any()
    np.testing.assert_allclose(known.loss, (depth[:, ~stands] ** 2).sum(axis=1), rtol=1e-9, atol=1e-15)


def test_twists_of_palms_are_of_the_grasps_that_step(sliding: Scene) -> None:
    unknowns, member = variables(sliding, MaxMove()), np.array([3, 1])
    dx = np.zeros((2, 6 + sliding.q.shape[1]))
    dx[:, 6 + np.flatnonzero(sliding.hand.arm_joints)] = 1e-6 * np.random.default_rng(4).normal(size=(2, 6))
    at = Point(sliding.T_world_root[member], sliding.q[member])
    before, after = unknowns.palm(at), unknowns.palm(unknowns.move(at, dx))
    twist = unknowns.palm_twist(member, dx)
    np.testing.assert_allclose(twist[:, :3], (after - before)[:, :3, 3], atol=1e-10)
    np.testing.assert_allclose(twist[:, 3:], log_so3(after[:, :3, :3] @ before[:, :3, :3].mT), atol=1e-10)


def test_starts_of_the_search_move_the_palm_and_the_fingers_alone(sliding: Scene) -> None:
    """The arm brings the palm to where a free hand would start; its joints have no noise of their own."""
    hand, rows = sliding.hand, np.arange(4)
    prepared = HandObject.of(sliding)
    search = Search(sliding, prepared, Config(prefer="strongest"), np.full(4, Status.RUNNING), None, None)
    search.touching[:, :2] = True
    middle = prepared.chain(sliding.T_world_root, sliding.q).T_world_link[:, :2, :3, 3].mean(axis=1)
    found = search.perturb(rows, np.ones(4, dtype=int))
    before = palm_poses(hand, sliding.T_world_root, sliding.q)
    noise = sample_noise(sliding, before, rows, np.ones(4, dtype=int), 0)
    R = exp_so3(START_ROTATION_RAD * noise[:, 3:6])
    wanted = before.copy()
    wanted[:, :3, :3] = R @ before[:, :3, :3]
    wanted[:, :3, 3] = middle + matvec(R, before[:, :3, 3] - middle) + START_TRANSLATION_M * noise[:, :3]
    moved, turned = distances(wanted, palm_poses(hand, found.T, found.q))
    reached = (moved < 1e-6) & (turned < 1e-6)
    assert reached.sum() >= 3
    joints = START_JOINTS_RAD * hand.per_radian * noise[:, 6:]
    own = ~hand.arm_joints
    np.testing.assert_allclose((found.q - sliding.q)[:, own], joints[:, own], atol=1e-12)
    np.testing.assert_array_equal(found.T, sliding.T_world_root)


def test_jaws_on_an_arm_have_the_room_and_close_as_without_it(box: Object) -> None:
    """Arms neither open a jaw nor close it, and no link of an arm keeps a clearance."""
    jaws = load_hand(Path(__file__).parents[1] / "two_jaws.urdf", candidates=32)
    on_arm = mount(load_hand("ur5e", candidates=32), jaws)
    own, q = ~on_arm.arm_joints, np.tile(np.where(on_arm.arm_joints, on_arm.rest, 0.04), (2, 1))
    q[1, own] = 0.0301, 0.03
    T_palm = palm_poses(on_arm, np.tile(np.eye(4), (2, 1, 1)), q)
    # The base stands where the palm is below the box, which fits between the jaws.
    T_jaws = np.tile(transform(np.eye(3), np.array([0.0, 0.0, -0.085])), (2, 1, 1))
    base = T_jaws @ inverse(T_palm)
    scenes = Scene(jaws, box, T_jaws, q[:, own]), Scene(on_arm, box, base, q)
    rooms, closed, clearance = [], [], []
    for one in scenes:
        prepared = HandObject.of(one)
        frames = prepared.chain(one.T_world_root, one.q)
        T = frames.T_world_link
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
        touching = np.tile(np.isin(one.links, ["left_jaw", "right_jaw"]), (2, 1))
        rooms.append(finger_room(prepared, frames, witness, touching))
        closed.append(close_hands(one, prepared))
        clearance.append(clearances(Config(clearance=1e-3), one.hand, prepared.chain))
    np.testing.assert_allclose(rooms[1], rooms[0], atol=1e-9)
    assert closed[0].moved_m[0] > 0.005
    np.testing.assert_allclose(closed[1].q[:, own], closed[0].q, atol=1e-6)
    np.testing.assert_array_equal(closed[1].q[:, ~own], q[:, ~own])
    np.testing.assert_allclose(closed[1].moved_m, closed[0].moved_m, atol=1e-6)
    assert not clearance[1].any()


def test_squeeze_closes_the_fingers_and_not_the_arm(scene: Scene) -> None:
    """Set points of the arm are its joint values, to the last bit."""
    found = refine(scene, Config(FEW, starts=1))
    after = replace(scene, q=found.q)
    arm = scene.hand.arm_joints
    pressed = squeezed(after)
    np.testing.assert_array_equal(pressed[:, arm], found.q[:, arm])
    assert (np.abs(pressed - found.q)[:, ~arm].max(axis=1) > 0.01).all()


def test_noise_moves_palms_on_an_arm_as_on_a_free_hand(sliding: Scene) -> None:
    """Restarts displace the palm by the same twist, as far as the arm reaches, and joints of the hand."""
    unknowns, own, rows = variables(sliding, MaxMove()), ~sliding.hand.arm_joints, np.arange(4)
    dx = 0.003 * np.random.default_rng(5).normal(size=(4, 6 + sliding.q.shape[1]))
    dx[:, 3:6] *= 10.0
    at = Point(sliding.T_world_root, sliding.q)
    after = unknowns.displace(rows, at, dx)
    moved, turned = distances(integrate(unknowns.palm(at), dx[:, :6]), unknowns.palm(after))
    assert moved.max() < 1e-6 and turned.max() < 1e-6
    np.testing.assert_allclose((after.q - sliding.q)[:, own], dx[:, 6:][:, own], atol=1e-12)


def test_first_order_solvers_refuse_an_arm(scene: Scene) -> None:
    """The message names the solver that moves one."""
    with pytest.raises(GraspRefineError, match="levenberg-marquardt"):
        refine(scene, Config(solver=Descent(iterations=1)))


def test_links_of_the_arm_are_no_contacts(scene: Scene, whole: Hand) -> None:
    """However near they are: an object at the forearm is touched by no link that should."""
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
