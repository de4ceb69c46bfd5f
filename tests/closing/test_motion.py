"""The motion that closes a hand: ours, and that of a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import STAGES, Motion, closing_motion, motion_of
from grasp_refine.closing.pregrasp import open_hand
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.forces.squeeze import squeezed
from grasp_refine.grasps.grasp_set import GraspSet, Stage, load_grasps
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.objects.object import load_object
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.refine import refine_problem
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.scene import Scene
from refusals import refused
from sliding_gripper import sliding_gripper


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro", candidates=16)


@pytest.fixture(scope="module")
def grasps() -> GraspSet:
    return load_grasps(resource_dir("robots") / "allegro" / "example_rounded_box.npz").select(range(3))


def test_the_stages_are_open_grasp_and_squeeze(hand: Hand, grasps: GraspSet) -> None:
    box = load_object("rounded_box", scale=float(grasps.scale[0]), candidates=16)
    T, q = transform_from_pose(grasps.hand_pose), grasps.q.copy()
    q[1, 3] = np.nan
    scene = Scene(hand, box, T, q)
    motion = closing_motion(scene)
    assert len(motion) == 3 and STAGES == ("pregrasp", "grasp", "squeeze")
    T_open, q_open = open_hand(scene)
    good = [0, 2]
    np.testing.assert_array_equal(motion.T_world_root, np.where(np.isnan(q[:, 3])[:, None, None, None], np.nan,
                                                                np.stack([T_open, T, T], axis=1)))  # fmt: skip
    np.testing.assert_array_equal(motion.q[good], np.stack([q_open, q, squeezed(scene)], axis=1)[good])
    assert np.isnan(motion.q[1]).all(), "half a grasp is none"
    assert np.abs(motion.q[good, 2] - q[good]).max() > 0.05
    chosen = motion.select(np.array([2, 0]))
    np.testing.assert_array_equal(chosen.q, motion.q[[2, 0]])


def test_the_motion_of_a_file_has_its_joints_by_name(hand: Hand, grasps: GraspSet) -> None:
    names = grasps.joint_names[::-1]
    pregrasp = Stage(grasps.hand_pose + [0.01, 0, 0, 0, 0, 0, 0], grasps.q[:, ::-1] - 0.1)
    squeeze = Stage(grasps.hand_pose, grasps.q[:, ::-1] + 0.2)
    mirrored = replace(grasps, joint_names=names, q=grasps.q[:, ::-1], pregrasp=pregrasp, squeeze=squeeze)
    motion = motion_of(mirrored, hand)
    np.testing.assert_allclose(motion.q - grasps.q[:, None], np.broadcast_to([[-0.1], [0.0], [0.2]], motion.q.shape))
    T = transform_from_pose(grasps.hand_pose)
    np.testing.assert_array_equal(motion.T_world_root[:, 1], T)
    np.testing.assert_array_equal(motion.T_world_root[:, 2], T)
    np.testing.assert_allclose(motion.T_world_root[:, 0, :3, 3], T[:, :3, 3] + [0.01, 0, 0])


@pytest.mark.parametrize("lacking", [("pregrasp",), ("squeeze",), ("pregrasp", "squeeze")])
def test_a_file_without_a_stage_has_no_motion(hand: Hand, grasps: GraspSet, lacking: tuple[str, ...]) -> None:
    stage = Stage(grasps.hand_pose, grasps.q)
    some = replace(grasps, **{name: stage for name in ("pregrasp", "squeeze") if name not in lacking})
    with refused(GraspFileError, *lacking) as caught:
        motion_of(some, hand)
    assert [name for name in ("pregrasp", "squeeze") if name in str(caught.value)] == list(lacking)


@pytest.mark.parametrize("lacking", [("pregrasp",), ("squeeze",), ("pregrasp", "squeeze")])
def test_stages_that_a_file_lacks_are_ours(hand: Hand, grasps: GraspSet, lacking: tuple[str, ...]) -> None:
    """Fingers were closed first only where the squeeze is ours."""
    given = {name: Stage(grasps.hand_pose, grasps.q + 0.3) for name in ("pregrasp", "squeeze") if name not in lacking}
    rng = np.random.default_rng(0)
    own = Motion(rng.normal(size=(3, 3, 4, 4)), rng.normal(size=(3, 3, 16)), closed_m=rng.random(3))
    found = motion_of(replace(grasps, **given), hand, own)
    for at, name in enumerate(STAGES):
        expected = own.q[:, at] if name in lacking else grasps.q + 0.3 * (name != "grasp")
        np.testing.assert_allclose(found.q[:, at], expected)
        T = own.T_world_root[:, at] if name in lacking else transform_from_pose(grasps.hand_pose)
        np.testing.assert_allclose(found.T_world_root[:, at], T)
    assert (found.closed_m is own.closed_m) == ("squeeze" in lacking) and found.forces is None


def test_grasps_out_of_reach_of_an_arm_keep_what_is_known(tmp_path: Path) -> None:
    """The base and the joints of the hand; those of the arm are not known in any stage."""
    hand = mount(load_hand("ur5e", candidates=16), sliding_gripper(tmp_path, candidates=16))
    q = np.tile(hand.rest, (2, 1))
    q[1, hand.arm_joints] = np.nan
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 0, 3] = 2.0
    found = closing_motion(Scene(hand, load_object("sphere:0.03", candidates=16), T, q))
    np.testing.assert_array_equal(found.q[:, 1], q)
    np.testing.assert_array_equal(found.T_world_root[:, 1], T)
    assert np.isfinite(found.q[0]).all() and np.isnan(found.q[1, [0, 2]]).all()


def test_squeezes_press_as_much_as_the_settings_say(hand: Hand, grasps: GraspSet) -> None:
    """Twice the pressure is twice the offset of the set points, where no actuator is at its limit."""
    box = load_object("rounded_box", scale=float(grasps.scale[0]), candidates=16)
    strong = replace(hand, actuator=replace(hand.actuator, force_limit=np.full(len(hand.lower), np.inf)))
    problem = problem_of(strong, box, grasps)
    single, double = (
        refine_problem(problem, Config(solver=LevenbergMarquardt(iterations=1), starts=1, pressure=pressure)).outcome
        for pressure in (10.0, 20.0)
    )
    ahead = [outcome.stage_q[:, 2] - outcome.stage_q[:, 1] for outcome in (single, double)]
    assert np.abs(ahead[0]).max() > 0.05
    np.testing.assert_allclose(ahead[1], 2.0 * ahead[0], atol=1e-9)
