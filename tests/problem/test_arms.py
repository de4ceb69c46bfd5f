"""Grasps of a hand on an arm: from the options to the simulation, in which the arm holds the hand and lifts it."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import read_pose, transform_from_rpy
from grasp_refine.core.se3 import distances, transform_from_pose
from grasp_refine.hands.palm import palm_poses
from grasp_refine.problem.problem import Problem
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions, Rows
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.simulation import close, push
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import model_of

CONFIG = gr.Config(LevenbergMarquardt(iterations=12), starts=1)
"""Few iterations: what moves matters here, not how far it comes."""

BASE = "-0.55,0,-0.06,0,0,0"


def spec(**changes: object) -> gr.ProblemSpec:
    """Return new grasps of a gripper on a box on a table, on an arm."""
    given = {
        "hand": "franka_hand",
        "arm": "ur5e",
        "base": BASE,
        "object": "box:0.05,0.06,0.12",
        "grasps": Path("sample:4"),
        "table": -0.06,
    }
    return gr.ProblemSpec(**(given | changes))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Return the problem."""
    return gr.load_problem(spec())


@pytest.fixture(scope="module")
def refined(problem: Problem) -> gr.RefinedGrasps:
    """Return it refined."""
    return gr.refine(problem, config=CONFIG)


def test_grasps_on_an_arm_are_at_the_palms_of_the_hand_alone(problem: Problem) -> None:
    """On the arm, sampled palms are where they are without it."""
    alone = gr.load_problem(spec(arm=None, base=None)).groups[0].scene
    scene = problem.groups[0].scene
    reached = ~scene.out_of_reach
    assert reached.sum() >= 2
    T = palm_poses(scene.hand, scene.T_world_root, scene.q)
    moved, turned = distances(alone.T_world_root[reached], T[reached])
    assert moved.max() < 1e-6 and turned.max() < 1e-6
    np.testing.assert_allclose(scene.T_world_root[0], read_pose(BASE, "`base`"), atol=1e-12)
    # No link of the arm that moves is below the table, though the base stands on it.
    assert problem.hand.name == "franka_hand_on_ur5e"


def test_grasps_out_of_reach_have_a_status_and_no_measures() -> None:
    """A base 3 m away; simulated before and after refinement, they are out of reach there, too."""
    problem = gr.load_problem(spec(base="-3,0,0", grasps=Path("sample:2")))
    (note,) = (note for note in problem.notes if note.startswith("grasp 0 out of reach"))
    millimetres = float(note.split(" mm")[0].split()[-1])
    assert 1500.0 < millimetres < 2500.0 and "degrees" in note, "how far the palm is from its place"
    found = gr.refine(problem, config=CONFIG)
    trials = gr.simulate(found, "tabletop")
    for part in (trials.before, trials.after):
        assert (part.outcome == Reason.OUT_OF_REACH).all() and not part.success.any()
    assert (found.outcome.status == Status.OUT_OF_REACH).all() and set(found.status) == {"out of reach"}
    assert np.isnan(found.quality).all()
    assert "out of reach" in str(found)


def test_grasps_out_of_reach_say_what_is_in_the_way(tmp_path: Path) -> None:
    """A wall across the arm is met by one of its links, in all solutions."""
    file = tmp_path / "walled.toml"
    file.write_text(
        '[object]\nname = "box:0.05,0.06,0.12"\n[[body]]\nname = "wall"\nbox = [0.02, 4.0, 4.0]\n'
        "position = [-0.25, 0.0, 0.0]\n"
    )
    blocked = gr.load_problem(spec(object=None, table=None, scene=str(file), grasps=Path("sample:1")))
    (note,) = (note for note in blocked.notes if note.startswith("grasp 0 out of reach"))
    arm = blocked.hand.arm
    assert arm is not None and "'wall'" in note and " mm" in note and any(link in note for link in arm.links)


def test_results_are_read_again_on_the_same_arm(refined: gr.RefinedGrasps, tmp_path: Path) -> None:
    """They hold the joints of both by name, and begin at the base of the arm, which needs not be told again."""
    (path,) = refined.save(tmp_path / "refined.npz")
    again = gr.load_problem(gr.ProblemSpec(hand="franka_hand", arm="ur5e", object="box:0.05,0.06,0.12", grasps=path))
    scene = again.groups[0].scene
    np.testing.assert_array_equal(scene.q, refined.outcome.q)
    assert again.hand.joint_names == refined.problem.hand.joint_names and scene.hand.arm is not None
    with pytest.raises(GraspRefineError, match="`hand='franka_hand'` and `arm='ur5e'`"):
        gr.load_problem(gr.ProblemSpec(object="box:0.05,0.06,0.12", grasps=path))


def test_base_of_the_arm_never_moves(refined: gr.RefinedGrasps) -> None:
    """Not in the refinement, nor in pregrasp and squeeze; the squeeze moves no joint of the arm."""
    outcome = refined.outcome
    at = outcome.status != Status.OUT_OF_REACH
    arm = refined.problem.hand.arm_joints
    np.testing.assert_array_equal(outcome.hand_pose[at], outcome.hand_pose_before[at])
    np.testing.assert_array_equal(outcome.stage_pose[at], np.repeat(outcome.hand_pose[at, None], 3, axis=1))
    np.testing.assert_array_equal(outcome.stage_q[at, 2][:, arm], outcome.q[at][:, arm])


@pytest.fixture(scope="module")
def world(refined: gr.RefinedGrasps) -> World:
    """Return the world in which the arm lifts."""
    scene = refined.problem.groups[0].scene
    return build_world(model_of(scene.hand), scene.object, Task(load_protocol("tabletop"), table=scene.table))


def test_arm_holds_the_grasp_and_lifts_the_box(refined: gr.RefinedGrasps, world: World) -> None:
    """In simulation its base has no joint, and its palm rises by the height of the protocol."""
    outcome, hand = refined.outcome, refined.problem.hand
    at = np.flatnonzero(outcome.status != Status.OUT_OF_REACH)[:1]
    assert world.root_at is None and world.model.nv == 6 + len(world.hand.joints)
    T = transform_from_pose(outcome.stage_pose[at])
    from grasp_refine.closing.motion import Motion

    motion = Motion(T, outcome.stage_q[at])
    closed = close(world, motion, Conditions.nominal(world, 1), threads=1)
    heights: list[float] = []
    data = mujoco.MjData(world.model)

    def watch(batch: mujoco.batch.Batch) -> None:
        batch.get_data(0, data)
        mujoco.mj_kinematics(world.model, data)
        heights.append(float(data.body("hand/panda_hand").xpos[2]))
        base = data.body(f"hand/{hand.base_link}")
        np.testing.assert_allclose(base.xpos, outcome.hand_pose[at[0], :3], atol=1e-12)

    trials = push(world, closed, threads=1, on_step=watch, engine=Rows)
    protocol: Protocol = world.protocol
    assert abs(heights[-1] - heights[0] - protocol.lift) < 2e-3
    assert trials.success.all()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"base": None}, ("`base`", "base_link")),
        ({"arm": None, "mount": "tool0", "base": None}, ("`mount='tool0'`", "`arm`")),
        ({"mount": "tool9"}, ("tool9", "tool0")),
        ({"arm": "ur6"}, ("ur6", "ur5e")),
        ({"base": "1,2"}, ("`base` 1,2",)),
        ({"base": "1,2,x"}, ("`base` 1,2,x", "degrees")),
        ({"base": "550,0,0"}, ("`base` 550,0,0", "metres")),
        ({"mount_pose": "0,0,nan"}, ("`mount_pose` 0,0,nan",)),
        ({"arm": None}, ("`arm`", "`base_link`")),
    ],
)
def test_wrong_options_are_refused_with_the_way_out(changes: dict, named: tuple[str, ...]) -> None:
    """In one line that names the value."""
    with pytest.raises(GraspRefineError) as error:
        gr.load_problem(spec(**changes))
    assert all(part in str(error.value) for part in named) and "\n" not in str(error.value)


def test_base_stands_in_the_world_of_a_scene_and_on_its_table() -> None:
    """Its pose is the world's; that it stands on the table, in the margin of this, is no penetration of the scene."""
    problem = gr.load_problem(
        spec(object=None, table=None, scene="box-in-corner", base="-0.5,0,0.7", grasps=Path("sample:2"))
    )
    scene = problem.groups[0].scene
    assert scene.environment is not None
    T = scene.environment.T_world_object @ scene.T_world_root[0]
    np.testing.assert_allclose(T, read_pose("-0.5,0,0.7", "`base`"), atol=1e-12)
    found = gr.evaluate(problem)
    at = ~scene.out_of_reach
    assert at.any() and (found.validated.metrics.scene_penetration_m[at] < 0.03).all()
    arms = problem.hand.arm
    assert arms is not None and arms.standing == {"base_link", "base"}


@pytest.mark.slow
def test_grasps_on_an_arm_move_with_their_whole_scene() -> None:
    """World, object, bodies, in another order, and base moved, up kept: the same grasps and trajectories, to 1e-9."""
    scene, hand = gr.load_scene("box-in-corner"), gr.load_hand("franka_hand", candidates=32)
    box, whole = gr.load_object(scene.object or ""), gr.mount(gr.load_hand("ur5e", candidates=32), hand)
    grasps = gr.sample_grasps(hand, box, 3, task=gr.Task(scene=scene))
    T_base = read_pose("0,-0.55,0.7,0,0,90", "`base`")
    G = transform_from_rpy([3.0, -2.0, 1.0, 0.0, 0.0, 130.0])
    bodies = tuple(replace(body, T_world_body=G @ body.T_world_body) for body in scene.bodies)
    there = replace(scene, bodies=bodies[::-1], T_world_object=G @ scene.T_world_object)
    (first, its), (second, others) = (
        (found, gr.plan_trajectories(found))
        for found in (
            gr.refine(whole, box, grasps, CONFIG, task=gr.Task(scene=one, base=base))
            for one, base in ((scene, T_base), (there, G @ T_base))
        )
    )
    assert its.free.any() and (first.status == second.status).all()
    for name in ("hand_pose", "q", "q_before", "stage_q", "quality"):
        np.testing.assert_allclose(getattr(first.outcome, name), getattr(second.outcome, name), atol=1e-9, err_msg=name)
    for one, other in zip(its.plans, others.plans, strict=True):
        assert (one.status, one.other_arm) == (other.status, other.other_arm)
        for leg, same in zip(one.legs, other.legs, strict=True):
            np.testing.assert_allclose(leg.q, same.q, atol=1e-9)
