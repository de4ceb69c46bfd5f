"""Frozen parts of a hand: they keep the bits of the input, whatever the solver tries, and all others are free."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boxed_example import boxed_example
from grasp_refine.core.errors import HandError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import exp_so3
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import integrate
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.objective import Objective
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.refinement.variables import variables
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from refusals import refused
from spread_gripper import spread_gripper

FEW = LevenbergMarquardt(iterations=10)
THUMB = np.repeat([False, True], [12, 4])
"""Joints of the thumb of the embedded hand, its last four."""

KINDS: dict[tuple[str, ...], tuple[bool, bool, np.ndarray]] = {
    ("palm",): (True, True, 0 * THUMB > 0),
    ("translation",): (True, False, 0 * THUMB > 0),
    ("rotation",): (False, True, 0 * THUMB > 0),
    ("thumb",): (False, False, THUMB),
    ("joint_13.0",): (False, False, np.arange(16) == 13),
    ("palm", "thumb", "joint_2.0"): (True, True, THUMB | (np.arange(16) == 2)),
}
"""Names -> whether the palm keeps its translation and its rotation, and joints (16,) that stay."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two example grasps, away from where they hold, on which all starts are tried."""
    scene = boxed_example(128).select(slice(2))
    T = scene.T_world_root.copy()
    T[:, :3, 3] += [0.006, -0.004, 0.005]
    T[:, :3, :3] = exp_so3(np.array([0.1, 0.2, -0.1])) @ T[:, :3, :3]
    return replace(scene, T_world_root=T, q=np.clip(scene.q - 0.05, scene.hand.lower + 0.01, scene.hand.upper - 0.01))


def check_frozen(scene: Scene, names: tuple[str, ...], config: Config) -> None:
    """Compare bits of frozen parts with the input; the pose, where it is free, and other joints move."""
    translation, rotation, joints = KINDS[names]
    found = refine(scene, replace(config, freeze=names))
    T, q = found.T_world_root, found.q
    changed = [T[:, :3, 3] != scene.T_world_root[:, :3, 3], T[:, :3, :3] != scene.T_world_root[:, :3, :3]]
    assert [bool(part.any()) for part in changed] == [not translation, not rotation]
    np.testing.assert_array_equal(q[:, joints], scene.q[:, joints])
    assert (q != scene.q).any()


@pytest.mark.parametrize("names", KINDS, ids="+".join)
def test_frozen_parts_keep_their_bits_from_any_start(scene: Scene, names: tuple[str, ...]) -> None:
    check_frozen(scene, names, Config(FEW, starts=2))


@pytest.mark.parametrize("names", KINDS, ids="+".join)
def test_points_anywhere_come_back_to_frozen_parts_of_their_own_grasp(scene: Scene, names: tuple[str, ...]) -> None:
    """Random starts and noise move everything; the first point here is one of the second grasp."""
    translation, rotation, joints = KINDS[names]
    unknowns, member, rng = variables(scene, MaxMove(), names), np.array([1, 0, 1]), np.random.default_rng(0)
    first = Point(scene.T_world_root[member], scene.q[member])
    dx = 0.2 * rng.normal(size=(3, 22))
    moved = Point(integrate(first.T, dx[:, :6]), np.clip(first.q + dx[:, 6:], scene.hand.lower, scene.hand.upper))
    for found in (unknowns.project(member, moved), unknowns.displace(member, moved, dx)):
        assert (found.T[:, :3, 3] == first.T[:, :3, 3]).all() == translation
        assert (found.T[:, :3, :3] == first.T[:, :3, :3]).all() == rotation
        np.testing.assert_array_equal(found.q[:, joints], first.q[:, joints])
    free = unknowns.project(member, moved)
    np.testing.assert_array_equal(free.q[:, ~joints], moved.q[:, ~joints])
    assert translation or (free.T[:, :3, 3] == moved.T[:, :3, 3]).all()
    assert rotation or (free.T[:, :3, :3] == moved.T[:, :3, :3]).all()


@pytest.mark.parametrize(("names", "balance"), [(("palm",), True), (("rotation",), False), (("thumb",), True)])
def test_frozen_parts_keep_their_bits_with_targets(scene: Scene, names: tuple[str, ...], balance: bool) -> None:
    """Inverse kinematics, restarts and the balance of forces afterwards leave them alone."""
    goal = goal_of(scene, Config().contact_selection, HandObject.of(scene), nearest=True)
    aimed = replace(scene, target_link=goal.target_link, target_object=goal.target_object + 0.002)
    solver = LevenbergMarquardt(iterations=10, restarts=1)
    check_frozen(aimed, names, Config(solver, starts=2, weights=Weights() if balance else Weights(wrench=0.0)))


@pytest.mark.parametrize("solver", [Descent(iterations=8), Adam(iterations=8)], ids=["descent", "adam"])
@pytest.mark.parametrize("names", KINDS, ids="+".join)
def test_first_order_solvers_keep_frozen_parts(scene: Scene, names: tuple[str, ...], solver: Descent | Adam) -> None:
    check_frozen(scene, names, Config(solver))


def test_gradient_is_that_of_all_unknowns_without_frozen_components(scene: Scene) -> None:
    config, rows = Config(Descent(), nearest=True), np.arange(2)
    goal = goal_of(scene, config.contact_selection, HandObject.of(scene), nearest=True)
    point = Point(scene.T_world_root, scene.q)
    free, found = (
        Objective(scene, goal, replace(config, freeze=names)).evaluate(rows, point, None)
        for names in ((), ("rotation", "thumb"))
    )
    still = np.concatenate([np.repeat([False, True], 3), THUMB])
    np.testing.assert_array_equal(found.gradient, np.where(still, 0.0, free.gradient))
    assert free.gradient[:, still].any() and found.gradient.any()


def test_single_precision_keeps_the_bits_of_frozen_parts(scene: Scene) -> None:
    check_frozen(scene, ("palm",), Config(Descent(iterations=3), dtype="float32"))


def test_hand_whose_parts_are_all_frozen_is_returned(scene: Scene) -> None:
    found = refine(scene, Config(FEW, starts=2, freeze=("palm", *scene.hand.fingers)))
    np.testing.assert_array_equal(found.T_world_root, scene.T_world_root)
    np.testing.assert_array_equal(found.q, scene.q)
    np.testing.assert_allclose(found.loss[:, 1], found.loss[:, 0], rtol=1e-12)


def test_frozen_joint_beyond_its_limit_goes_to_the_limit(scene: Scene) -> None:
    q = scene.q.copy()
    q[0, 12] = scene.hand.upper[12] + 0.1
    found = refine(replace(scene, q=q), Config(FEW, starts=1, freeze=("thumb",)))
    np.testing.assert_array_equal(found.q[:, 13:], q[:, 13:])
    np.testing.assert_array_equal(found.q[:, 12], [scene.hand.upper[12], q[1, 12]])


@pytest.mark.parametrize("names", KINDS, ids="+".join)
def test_step_is_that_of_the_problem_without_frozen_columns(scene: Scene, names: tuple[str, ...]) -> None:
    """Damped least squares in the other unknowns alone, by numpy; no other bound holds."""
    rng, rows, damping = np.random.default_rng(1), np.arange(2), np.array([0.1, 2.0])
    unknowns = variables(scene, MaxMove(), names)
    point = Point(scene.T_world_root, scene.q)
    J, r = rng.normal(size=(2, 40, 22)), 1e-3 * rng.normal(size=(2, 40))
    metric, (lower, upper) = unknowns.metric(rows), unknowns.step_bounds(rows, point)
    dx, fall = bounded_step(J, r, damping, metric, lower, upper)
    translation, rotation, joints = KINDS[names]
    free = ~np.concatenate([np.repeat([translation, rotation], 3), joints])
    for k in rows:
        weights = np.diag(np.sqrt(damping[k] * metric[k]))[:, free]
        expected = np.zeros(22)
        expected[free] = np.linalg.lstsq(np.vstack([J[k][:, free], weights]), np.append(-r[k], np.zeros(22)))[0]
        np.testing.assert_allclose(dx[k], expected, rtol=1e-9, atol=1e-15)
        assert (dx[k][~free] == 0.0).all()
        after = r[k] + J[k] @ expected
        assert fall[k] == pytest.approx(r[k] @ r[k] - after @ after, rel=1e-9)


def test_frozen_translation_turns_the_palm_about_its_origin(scene: Scene) -> None:
    """A step of all unknowns at once, projected: the origin stays, the rotation is the step's."""
    unknowns, dx = variables(scene, MaxMove(), ("translation",)), np.full((2, 22), 0.01)
    found = unknowns.integrate(np.arange(2), Point(scene.T_world_root, scene.q), dx)
    np.testing.assert_array_equal(found.T[:, :3, 3], scene.T_world_root[:, :3, 3])
    turned = exp_so3(np.full(3, 0.01)) @ scene.T_world_root[:, :3, :3]
    np.testing.assert_allclose(found.T[:, :3, :3], turned, atol=1e-12)


@pytest.fixture(scope="module")
def arm_scene() -> Scene:
    """Grasps of the embedded hand on an arm."""
    hand, box = load_hand("allegro", candidates=64), load_object("box:0.06,0.06,0.12")
    whole = mount(load_hand("ur5e", candidates=32), hand)
    placed, _ = on_arm(sample_grasps(hand, box, 2, seed=2), whole, transform_from_rpy([-0.45, 0.05, -0.15, 0, 0, 20]))
    return Scene(whole, box, placed.hand_pose, placed.q)


@pytest.mark.parametrize("nearest", [False, True])
def test_frozen_palm_of_a_hand_on_an_arm_keeps_the_arm(arm_scene: Scene, nearest: bool) -> None:
    """Also with bounds on its movement, and from all starts; the fingers move."""
    arm = arm_scene.hand.arm_joints
    config = Config(FEW, starts=2, nearest=nearest, max_move=MaxMove(0.01, 0.1, 0.5))
    assert (refine(arm_scene, config).q[:, arm] != arm_scene.q[:, arm]).any()
    found = refine(arm_scene, replace(config, freeze=("palm", "thumb")))
    thumb = Frozen.of(arm_scene.hand, ("thumb",)).joints
    assert thumb.sum() == 4
    np.testing.assert_array_equal(found.T_world_root, arm_scene.T_world_root)
    np.testing.assert_array_equal(found.q[:, arm | thumb], arm_scene.q[:, arm | thumb])
    assert (found.q != arm_scene.q).any()


def test_arm_comes_back_to_a_frozen_palm(arm_scene: Scene) -> None:
    """From any joint values, and movements of the palm by inverse kinematics."""
    unknowns, rows, rng = variables(arm_scene, MaxMove(0.5, 2.0), ("palm",)), np.arange(2), np.random.default_rng(0)
    arm, dx = arm_scene.hand.arm_joints, 0.05 * rng.normal(size=(2, 6 + len(arm_scene.hand.joint_names)))
    first = Point(arm_scene.T_world_root, arm_scene.q)
    moved = Point(first.T, np.clip(first.q + dx[:, 6:], arm_scene.hand.lower, arm_scene.hand.upper))
    for found in (unknowns.project(rows, moved), unknowns.displace(rows, moved, dx)):
        np.testing.assert_array_equal(found.q[:, arm], first.q[:, arm])
        assert (found.q != first.q).any()


@pytest.mark.parametrize("name", ["translation", "rotation"])
def test_arm_cannot_keep_one_part_of_a_pose(arm_scene: Scene, name: str) -> None:
    with refused(HandError, "arm", "palm", name):
        refine(arm_scene, Config(freeze=(name,)))


def test_unknown_part_is_refused_with_parts_that_exist(scene: Scene) -> None:
    with refused(HandError, "thmb", "did you mean thumb", "palm", "translation", "rotation", "index", "joint_3.0"):
        refine(scene, Config(freeze=("palm", "thmb")))


def test_wrist_is_part_of_the_palm() -> None:
    """Joints that carry all fingers would move the palm; a finger has its own joints only."""
    hand = load_hand("shadow", candidates=32)
    frozen = [
        {joint for joint, still in zip(hand.joint_names, Frozen.of(hand, (name,)).joints, strict=True) if still}
        for name in ("palm", "little")
    ]
    assert frozen == [{"WRJ1", "WRJ2"}, {"LFJ1", "LFJ2", "LFJ3", "LFJ4", "LFJ5"}]


def test_joint_of_two_fingers_belongs_to_neither(tmp_path: Path) -> None:
    """Joints that follow it are no names; two jaws that follow each other have no joint of their own."""
    spread, franka = spread_gripper(tmp_path), load_hand("franka_hand", candidates=32)
    found = {finger: tuple(Frozen.of(spread, (finger,)).joints) for finger in spread.fingers}
    assert set(found.values()) == {tuple(np.arange(4) == joint) for joint in (1, 2, 3)}
    assert Frozen.of(franka, ("palm", "panda_finger_joint1")).unknowns.all()
    assert not Frozen.of(franka, ("palm",)).joints.any()
    with refused(HandError, "left", "panda_finger_joint1"):
        Frozen.of(franka, ("left",))
    with refused(HandError, "spread_mirror", "did you mean spread"):
        Frozen.of(spread, ("spread_mirror",))
