"""Plans of grasps: their legs, the directions that they try, and their obstacles, for hands alone and on an arm."""

from dataclasses import replace

import numpy as np
import pytest

import grasp_refine as gr
from ball_hand import AHEAD, BALL, FROM_ABOVE, PALM, TIP, ball_hand, body, grasp, thing
from grasp_refine.closing.motion import Motion
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import distances, exp_se3, exp_so3, inverse, transform
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.paths import HandPath, straight
from grasp_refine.motion.plan import TILT_RAD, MotionPlan, PlanStatus, TrajectoryOptions, plan_motions
from grasp_refine.motion.sweep import Sweep
from grasp_refine.motion.trajectory import trajectory
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import joint, link

T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Return the gripper, with a joint that turns without links that could meet anything."""
    turning = joint("t", "palm", "thumb", axis=(1, 0, 0), limits=(-0.5, 0.8))
    return ball_hand(tmp_path_factory.mktemp("balls"), link("thumb"), turning)


@pytest.fixture(scope="module")
def whole(hand: Hand) -> Hand:
    """Return it on an arm."""
    return mount(load_hand("ur5e", candidates=32), hand)


def on_the_arm(whole: Hand, *bodies: EnvironmentBody) -> tuple[Scene, Motion]:
    """Return the grasp of the ball by the hand on its arm."""
    alone, motion = grasp(whole.parts[1], *bodies)
    grasps = GraspSet.of(whole.parts[1], alone.T_world_root, alone.q)
    arm = on_arm(grasps, whole, T_BASE)[0].q[:, whole.arm_joints]
    q = np.concatenate([np.tile(arm, (3, 1)), motion.q[0]], axis=1)
    scene = Scene(whole, alone.object, T_BASE, q[1], task=alone.task)
    return scene, Motion(np.tile(T_BASE, (1, 3, 1, 1)), q[None])


def planned(scene: Scene, motion: Motion, **lengths: object) -> MotionPlan:
    (plan,) = plan_motions(scene, motion, TrajectoryOptions(**lengths))
    return plan


def in_link(whole: Hand, motion: Motion, name: str, *point: float) -> EnvironmentBody:
    """Return a ball around a point of a link at the pregrasp."""
    T = Chain(whole, [name])(motion.T_world_root[0, :1], motion.q[0, :1]).T_world_link[0, 0]
    x, y, z, _ = T @ [*point, 1.0]
    return body("post", (x, y, z, 0.015))


def test_palm_of_an_arm_moves_on_a_straight_line(whole: Hand) -> None:
    """To a micrometre and without turning, the base and the fingers still; it ends where the arm does."""
    _, motion = on_the_arm(whole)
    along = np.array([0.02, -0.03, 0.1])
    path, reached = straight(whole, T_BASE, motion.q[0, 1], along)
    T = palm_poses(whole, path.T_world_root, path.q)
    assert reached and (path.T_world_root == T_BASE).all()
    expected = T[0, :3, 3] + np.linspace(0.0, 1.0, len(path))[:, None] * along
    np.testing.assert_allclose(T[:, :3, 3], expected, atol=1e-6)
    assert distances(np.tile(T[:1], (len(T), 1, 1)), T)[1].max() < 1e-6
    assert (path.q[:, ~whole.arm_joints] == motion.q[0, 1, ~whole.arm_joints]).all()
    beyond, reached = straight(whole, T_BASE, motion.q[0, 1], np.array([2.0, 0.0, 0.0]))
    assert not reached and 2 < len(beyond) < 100 and np.abs(np.diff(beyond.q, axis=0)).max() < 0.3


@pytest.mark.parametrize("where", ["alone", "table", "turned", "arm"])
def test_free_plan_has_all_legs_and_passes_the_stages(hand: Hand, whole: Hand, where: str) -> None:
    """Straight to the pregrasp, the fingers still; close; squeeze; straight up against gravity."""
    up, task = np.array([0.0, 0.0, 1.0]), {}
    if where == "table":
        up = np.array([0.28, 0.0, 0.96])
        task = {"table": Plane(tuple(up), -0.05)}
    elif where == "turned":
        turn = exp_se3(np.array([0.3, 0.2, -0.4, 0.3, -0.2, 0.9]))
        up, task = turn[2, :3], {"turn": turn}
    far = body("far", (1.0, 1.0, 1.0, 0.01))
    which = whole if where == "arm" else hand
    scene, motion = on_the_arm(whole) if where == "arm" else grasp(hand, *[far] * (where == "turned"), **task)
    # Jaws press beyond their limits, joints that turn within theirs.
    motion.q[0, :, -1] = 0.1, 0.2, 2.0
    motion.q[0, 2, -3:-1] = -0.02
    plan = planned(scene, motion, approach=0.13, lift=0.07)
    assert plan.free and plan.why == "" and not plan.other_arm and plan.reach is None
    approach, close, squeeze, lift = plan.legs
    first, *_, last = palm_poses(which, approach.T_world_root, approach.q)
    np.testing.assert_allclose(last, FROM_ABOVE, atol=1e-6)
    np.testing.assert_allclose(plan.direction, [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(first[:3, 3] - last[:3, 3], [0.0, 0.0, 0.13], atol=1e-6)
    fingers = ~which.arm_joints
    assert (approach.q[:, fingers] == motion.q[0, 0, fingers]).all()
    np.testing.assert_array_equal(close.q, motion.q[0, :2])
    np.testing.assert_array_equal(squeeze.q[0], motion.q[0, 1])
    np.testing.assert_allclose(squeeze.q[1, fingers], [-0.02, -0.02, 0.8])
    np.testing.assert_array_equal(squeeze.q[1, which.arm_joints], motion.q[0, 1, which.arm_joints])
    assert (lift.q[:, fingers] == squeeze.q[1, fingers]).all()
    palm = palm_poses(which, lift.T_world_root, lift.q)
    np.testing.assert_allclose(palm[0], FROM_ABOVE, atol=1e-6)
    np.testing.assert_allclose(palm[-1, :3, 3] - palm[0, :3, 3], 0.07 * up, atol=1e-6)


def test_each_direction_is_tried_in_turn(hand: Hand) -> None:
    """Away from the tips, up, and between; then tilted to four sides; if none is free, the first is reported."""
    turn, half = np.eye(4), np.sqrt(0.5)
    turn[:3, :3] = [[0.6 * half, 0.6 * half, -0.8], [-half, half, 0.0], [0.8 * half, 0.8 * half, 0.6]]
    own, up = np.array([0.0, 0.0, 1.0]), turn[2, :3]
    middle = (own + up) / np.linalg.norm(own + up)
    spin = transform(exp_so3(np.array([0.0, 0.0, 0.2])), np.zeros(3))
    found: list[np.ndarray] = []

    def plan(ways: list[np.ndarray]) -> MotionPlan:
        blocks = [body(f"b{k}", (*FROM_ABOVE[:3, 3] + 0.13 * way, 0.004)) for k, way in enumerate(ways)]
        scene, motion = grasp(hand, *blocks, turn=turn)
        scene = replace(scene, T_world_root=spin @ scene.T_world_root)
        return planned(scene, Motion(spin @ motion.T_world_root, motion.q), approach=0.15, lift=0.0)

    for _ in range(7):
        free = plan([-own, *found])
        assert free.free, free.why
        found.append(np.array(free.direction))
    np.testing.assert_allclose(found[:3], [own, middle, up], atol=1e-9)
    sides = (np.array(found[3:]) - np.cos(TILT_RAD) * own) / np.sin(TILT_RAD)
    # Along the axes of the palm.
    axes = np.kron(np.eye(2), [[1.0], [-1.0]]) @ spin[:3, :2].T
    assert (np.abs(sides @ axes.T).max(axis=1) > 1 - 1e-9).all()
    np.testing.assert_allclose(sides @ sides.T, np.kron(np.eye(2), [[1, -1], [-1, 1]]), atol=1e-9)
    last = plan(found)
    assert last.status == PlanStatus.BLOCKED and last.why.startswith("approach: palm and b0")
    np.testing.assert_allclose(last.direction, own, atol=1e-9)


@pytest.mark.parametrize("grasp_depth", [0.0, 5e-4])
@pytest.mark.parametrize("excess", [-3e-4, 3e-4])
def test_links_may_be_deeper_by_a_millimetre_while_they_close_than_at_the_grasp(
    hand: Hand, grasp_depth: float, excess: float
) -> None:
    """A bump that the left tip passes as it closes, beside its place at the pregrasp and at the grasp."""
    overlap = grasp_depth + 1e-3 + excess
    bump = thing((0.0, -0.057, TIP + 0.004 - overlap, 0.004))
    scene, motion = grasp(hand, thing=bump, stages=(0.075, BALL + TIP - grasp_depth, 0.03))
    plan = planned(scene, motion)
    assert plan.free == (excess < 0)
    if not plan.free:
        assert plan.why.startswith("close: left and") and len(plan.legs) == 2
        assert plan.obstruction is not None and plan.obstruction.depth <= overlap + 1e-9


@pytest.mark.parametrize(("apart", "free"), [(0.0096, False), (0.0099, True)])
def test_links_may_touch_each_other_by_half_a_millimetre(hand: Hand, apart: float, free: bool) -> None:
    """Tips that meet below the ball, 0.8 mm or 0.2 mm deep."""
    scene, motion = grasp(hand, stages=(0.03, apart, apart))
    low = motion.T_world_root.copy()
    low[..., 2, 3] -= BALL + TIP + 0.001
    away = thing().with_body(
        build_body("thing", [p.transformed(exp_se3(np.array([0.5, 0, 0, 0, 0, 0]))) for p in thing().body.pieces])
    )
    plan = planned(replace(scene, object=away), Motion(low, motion.q))
    assert plan.free == free and (free or plan.why.startswith("close: left and right"))


@pytest.mark.parametrize(
    ("where", "why"),
    [
        ((0.0, 0.0, -BALL - 0.02 + 0.001, 0.02), ""),
        ((0.0, 0.0, AHEAD + PALM + 0.09, 0.015), "approach: palm and post"),
        ((0.0, -BALL - TIP - 0.016, 0.05, 0.015), ""),
        ((0.0, -BALL - TIP - 0.008, 0.05, 0.015), "lift: left and post"),
        ((0.035, 0.0, 0.055, 0.015), "lift: object and post"),
    ],
    ids=["shelf", "above", "beside", "tip", "object"],
)
def test_lifts_are_free_of_what_the_approach_passes(hand: Hand, where: tuple, why: str) -> None:
    """A shelf a millimetre in the object is left behind; others are in the way of a link, or of the carried object."""
    plan = planned(*grasp(hand, body("post", where), stages=(0.085, 0.04, 0.035)), lift=0.03)
    if why.startswith("approach"):
        assert plan.free and plan.direction is not None and plan.direction[2] < 0.9, "it comes from the side"
    else:
        assert plan.free == (not why) and plan.why.startswith(why) and len(plan.legs) == 4


def test_fingers_that_are_behind_a_rim_open_wider_for_the_approach(hand: Hand) -> None:
    """By twice the opening from the grasp, within their limits, and close to the pregrasp in place."""

    def rim(y: float) -> EnvironmentBody:
        return body("rim", *((x, side * y, 0.022, 0.006) for x in np.linspace(-0.1, 0.1, 21) for side in (-1, 1)))

    scene, motion = grasp(hand, rim(0.055), stages=(0.055, 0.045, 0.035))
    plan = planned(scene, motion, lift=0.005)
    approach = plan.legs[0]
    assert plan.free, plan.why
    np.testing.assert_allclose(approach.q[:-1, :2], 0.055 + 2 * 0.01)
    np.testing.assert_array_equal(approach.q[-1], motion.q[0, 0])
    np.testing.assert_array_equal(approach.T_world_root[-2:], motion.T_world_root[0, [0, 0]])
    limited = planned(*grasp(hand, rim(0.08), stages=(0.08, 0.04, 0.035)))
    assert limited.status == PlanStatus.BLOCKED and limited.why.startswith("approach") and "rim" in limited.why


def test_links_of_the_arm_are_swept_too(whole: Hand) -> None:
    """A post in the last wrist, where the palm has it, blocks all plans; the ground of the base does not."""
    stand = body("stand", (-0.5, 0.0, -0.15, 0.12))
    assert planned(*on_the_arm(whole, stand)).free
    _, motion = on_the_arm(whole)
    plan = planned(*on_the_arm(whole, in_link(whole, motion, "wrist_3_link", 0.0, 0.0, -0.02)))
    assert plan.status == PlanStatus.BLOCKED and "wrist_3_link and post" in plan.why and not plan.other_arm


def test_another_configuration_of_the_arm_has_the_same_palms(whole: Hand) -> None:
    """A post in the forearm blocks the arm at the grasp; another configuration passes, to 1e-9 at the palm."""
    _, motion = on_the_arm(whole)
    scene, motion = on_the_arm(whole, in_link(whole, motion, "forearm_link", -0.2, 0.0, 0.007))
    met = Sweep(scene, HandObject.of(scene)).obstruction(HandPath(motion.T_world_root[0], motion.q[0]), allowed=None)
    assert met is not None and (met.first, met.second) == ("forearm_link", "post")
    plan, fingers = planned(scene, motion), ~whole.arm_joints
    assert plan.free and plan.other_arm
    close = plan.legs[1]
    palms = [
        palm_poses(whole, path.T_world_root, path.q)
        for path in (close, HandPath(motion.T_world_root[0, :2], motion.q[0, :2]))
    ]
    np.testing.assert_allclose(palms[1], palms[0], atol=1e-9)
    np.testing.assert_array_equal(close.q[:, fingers], motion.q[0, :2][:, fingers])
    assert np.abs(close.q - motion.q[0, :2]).max() > 0.1
    np.testing.assert_array_equal(plan.legs[2].q[:, ~fingers], close.q[[1, 1]][:, ~fingers])


@pytest.mark.parametrize("blocked", [False, True])
def test_plans_move_with_the_whole_scene(whole: Hand, blocked: bool) -> None:
    """Object, bodies and base moved and turned by any motion, up included: all else stays, to 1e-9."""
    D = exp_se3(np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.5]))
    _, motion = on_the_arm(whole)
    at = ("wrist_3_link", 0.0, 0.0, -0.02) if blocked else ("forearm_link", -0.2, 0.0, -0.02)
    scene, motion = on_the_arm(whole, in_link(whole, motion, *at))
    assert scene.environment is not None
    there = Scene(
        whole,
        scene.object.with_body(build_body("thing", [piece.transformed(D) for piece in scene.object.body.pieces])),
        D @ scene.T_world_root,
        scene.q,
        task=Task(scene=Environment(scene.environment.bodies, inverse(D))),
    )
    # The world stays, and the frame of the object moves in it.
    first, second = planned(scene, motion), planned(there, Motion(D @ motion.T_world_root, motion.q))
    assert (first.status, first.other_arm, len(first.legs)) == (second.status, second.other_arm, len(second.legs))
    assert blocked == (first.status == PlanStatus.BLOCKED) and first.why.split(" at ")[0] == second.why.split(" at ")[0]
    np.testing.assert_allclose(D[:3, :3] @ first.direction, second.direction, atol=1e-9)
    for one, other in zip(first.legs, second.legs, strict=True):
        np.testing.assert_allclose(one.q, other.q, atol=1e-9)
        np.testing.assert_allclose(D @ one.T_world_root, other.T_world_root, atol=1e-9)


def test_grasps_without_a_plan_say_why_and_leave_others_alone(whole: Hand) -> None:
    """Out of reach, and no grasp; the third is as it is alone. Legs beyond the reach of the arm end where it does."""
    scene, motion = on_the_arm(whole)
    q, stages = np.repeat(scene.q, 3, axis=0), np.repeat(motion.q, 3, axis=0)
    q[0, 0], q[1], stages[0, :, 0], stages[1] = np.nan, np.nan, np.nan, np.nan
    many = replace(scene, T_world_root=np.repeat(scene.T_world_root, 3, axis=0), q=q)
    found = plan_motions(many, Motion(np.repeat(motion.T_world_root, 3, axis=0), stages))
    assert [plan.status.label for plan in found] == ["out of reach", "no grasp", "free"]
    alone = planned(scene, motion)
    np.testing.assert_array_equal(found[2].legs[0].q, alone.legs[0].q)
    high = planned(scene, motion, lift=1.0)
    rise = np.ptp(palm_poses(whole, high.legs[3].T_world_root, high.legs[3].q)[:, 2, 3])
    assert high.status == PlanStatus.OUT_OF_REACH and f"{rise:.2f} m" in high.why and 0.2 < rise < 1.0


def test_arm_comes_from_its_start_straight_in_its_joints(whole: Hand) -> None:
    """To the start of the approach with the fingers as there, before the same legs; a limit is a start."""
    scene, motion = on_the_arm(whole)
    arm = whole.arm_joints
    start = tuple(whole.rest[arm].tolist())
    plain, plan = planned(scene, motion), planned(scene, motion, start=start)
    assert plan.free and plan.reach is not None and plain.reach is None
    np.testing.assert_array_equal(plan.reach.q[0, arm], start)
    np.testing.assert_array_equal(plan.reach.q[1], plan.legs[0].q[0])
    np.testing.assert_array_equal(plan.reach.q[0, ~arm], plan.legs[0].q[0, ~arm])
    for one, other in zip(plan.legs, plain.legs, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
    assert planned(scene, motion, start=tuple(whole.upper[arm].tolist())).status in (
        PlanStatus.FREE,
        PlanStatus.BLOCKED,
    )


def test_start_behind_a_wall_is_named_as_blocked(whole: Hand) -> None:
    """The arm turns through a plate beside its trajectory that neither start nor approach touches."""
    place = transform(np.eye(3), np.array([-0.1, 0.3, 0.3]))
    plate = EnvironmentBody("plate", build_body("plate", [box([0.5, 0.01, 0.5])], candidates=16), place)
    scene, motion = on_the_arm(whole, plate)
    assert planned(scene, motion).free
    turned = whole.rest[whole.arm_joints] + [np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]
    plan = planned(scene, motion, start=tuple(turned.tolist()))
    assert plan.status == PlanStatus.BLOCKED and plan.why.startswith("reach: ") and "plate" in plan.why
    assert plan.legs == () and len(trajectory(whole, plan)) > 1


@pytest.mark.parametrize(
    ("start", "named"), [((0.0, 1.0), "2 joint values"), ((9.0,) + (0.0,) * 5, "shoulder_pan_joint")]
)
def test_starts_that_are_none_of_the_arm_are_refused(
    whole: Hand, hand: Hand, start: tuple[float, ...], named: str
) -> None:
    """The message names the number of joints, or the joint and its limits; a hand without an arm has none."""
    with pytest.raises(gr.GraspRefineError, match=named):
        planned(*on_the_arm(whole), start=start)
    with pytest.raises(gr.GraspRefineError, match="no arm"):
        planned(*grasp(hand), start=start)


@pytest.mark.parametrize("lengths", [{"approach": -0.1}, {"lift": np.inf}, {"start": (np.nan,)}])
def test_lengths_that_are_none_are_refused(lengths: dict) -> None:
    with pytest.raises(gr.GraspRefineError, match=next(iter(lengths))):
        TrajectoryOptions(**lengths)
