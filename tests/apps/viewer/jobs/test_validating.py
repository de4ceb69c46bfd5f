"""Validation of one grasp: the same as `validate` finds, told in steps, and stopped at once."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import distances, pose_from_transform
from grasp_refine.grasps.grasp_set import Stage
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Group
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.robustness import judge
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.jobs.validating import (
    MakeWorld,
    PosedGrasp,
    protocol_of,
    record_direction,
    run_trial,
    world_cache,
)
from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from grasp_refine_apps.viewer.model.pose import Pose
from open_viewer import SHORT, ignored
from refusals import assert_names, refused

EXAMPLE = resource_dir("robots") / "allegro" / "example_mug.npz"


@pytest.fixture(scope="module")
def group() -> Group:
    """The second example grasp: it holds, but with little friction."""
    (found,) = load_problem(ProblemSpec(index=(1,), grasps=EXAMPLE)).groups
    return found


@pytest.fixture(scope="module")
def scene(group: Group) -> Scene:
    return group.scene


@pytest.fixture(scope="module")
def grasp(scene: Scene) -> PosedGrasp:
    """The grasp as in its file, with our own pregrasp and squeeze."""
    return PosedGrasp(scene, file_pose(scene), prepared=HandObject.of(scene))


@pytest.fixture(scope="module")
def make_world() -> MakeWorld:
    return world_cache()


def file_pose(scene: Scene) -> Pose:
    return Pose(scene.T_world_root[0], scene.q[0])


def posed(grasp: PosedGrasp, pose: Pose) -> PosedGrasp:
    return replace(grasp, pose=pose)


def lifted(scene: Scene, by: float) -> Pose:
    """The pose, moved along z."""
    T = scene.T_world_root[0].copy()
    T[2, 3] += by
    return Pose(T, scene.q[0])


def test_a_trial_says_what_validate_says(make_world: MakeWorld, group: Group, scene: Scene, grasp: PosedGrasp) -> None:
    protocol = SHORT.with_friction(0.15)
    told: list[tuple[float | None, str]] = []
    control = Control(lambda *report: told.append(report))
    trial = run_trial(make_world, replace(grasp, file_grasp=group.grasps), protocol, control)
    # What `validate` simulates; linear algebra may round otherwise the second time.
    assert trial.motion is not None
    np.testing.assert_allclose(trial.motion.q, group.motion().q, atol=1e-9)
    np.testing.assert_allclose(trial.motion.T_world_root, group.motion().T_world_root, atol=1e-9)
    expected = simulate(make_world(scene, protocol), trial.motion)
    # To the last bit.
    for d, result in enumerate(trial.results):
        assert result.direction == expected.directions[d]
        assert result.reason == expected.reason[0, d]
        values = np.array([result.time_s, result.displacement_m, result.angle_rad, result.peak_m, result.peak_rad])
        columns = ("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad")
        np.testing.assert_array_equal(values, [getattr(expected, name)[0, d] for name in columns])
        assert result.links == tuple(np.array(expected.links)[expected.contacts[0, d]])
    assert trial.held == expected.success[0] and not trial.held
    assert {result.reason for result in trial.results} > {Reason.HELD}
    assert trial.closing == {"pregrasp": "own", "squeeze": "own"}
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and (shares[0], shares[-1]) == (0.0, 1.0) and len(told) > 12
    # Preparing, closing, squeezing, pushing and the end: each has words of its own, and comes once.
    parts = [what for what, _ in groupby(what for _, what in told)]
    assert len(parts) == len(set(parts)) == 5
    assert_names(parts[3], "6")


def test_offsets_of_the_object_are_as_in_validate(make_world: MakeWorld, scene: Scene, grasp: PosedGrasp) -> None:
    protocol = replace(SHORT.with_friction(0.2), directions=("+z", "-z"), noise=Noise(4, 0.01), required_label=1.0)
    told: list[str] = []
    control = Control(lambda share, what: told.append(what))
    trial = run_trial(make_world, replace(grasp, row=7), protocol, control)
    assert trial.motion is not None
    world, motion, rows = make_world(scene, protocol), trial.motion, np.array([7, 0, 1])
    expected = judge(world, motion.select(np.zeros(3, dtype=int)), numbers=rows)
    assert expected.label is not None and len(set(expected.label)) > 1, "another row, another label"
    assert (trial.label, trial.held) == (expected.label[0], expected.success[0])
    assert "elsewhere" in told[-2] and f"{trial.label:.0%} of 4" in trial.verdict


def test_the_watched_motion_ends_as_the_trial_says(make_world: MakeWorld, scene: Scene, grasp: PosedGrasp) -> None:
    trial = run_trial(make_world, grasp, SHORT.with_friction(0.15), ignored())
    lost = next(result for result in trial.results if not result.held)
    motion = record_direction(make_world, grasp, trial, lost.direction, ignored())
    assert_names(motion.title, lost.direction, lost.reason.label)
    assert not motion.succeeds
    # What was found at a check is what is shown in the frame of that time.
    frame = int(np.searchsorted(motion.time - motion.time[0], 0.8 + lost.time_s + 1e-9)) - 1
    assert_names(motion.text(frame), f"{lost.time_s:.2f} s", f"{1e3 * lost.displacement_m:.1f} mm")
    moved, turned = distances(motion.T_object[:1], motion.T_object[frame : frame + 1])
    assert (moved[0], turned[0]) == pytest.approx((lost.displacement_m, lost.angle_rad), abs=1e-9)
    # The hand starts at its pregrasp.
    assert trial.motion is not None
    np.testing.assert_allclose(motion.T_root[0], trial.motion.T_world_root[0, 0], atol=1e-12)
    np.testing.assert_allclose(motion.q[0], trial.motion.q[0, 0], atol=1e-12)
    held = record_direction(make_world, grasp, replace(trial, motion=None), "+x", ignored())
    assert held.succeeds and held.lost is not None and not held.lost.any()


def test_pregrasp_and_squeeze_of_the_file_are_for_the_grasp_of_the_file(
    group: Group, scene: Scene, grasp: PosedGrasp
) -> None:
    own = closing_motion(scene, grasp.prepared)
    given = replace(
        group.grasps,
        pregrasp=Stage(pose_from_transform(own.T_world_root[:, 0]), own.q[:, 0] + 0.01),
        squeeze=Stage(pose_from_transform(own.T_world_root[:, 2]), own.q[:, 2] + 0.02),
    )
    motion, owners = replace(grasp, file_grasp=given).motion()
    assert owners == {"pregrasp": "file", "squeeze": "file"}
    np.testing.assert_array_equal(motion.q[0], [own.q[0, 0] + 0.01, own.q[0, 1], own.q[0, 2] + 0.02])
    motion, owners = replace(grasp, file_grasp=replace(given, pregrasp=None)).motion()
    assert owners == {"pregrasp": "own", "squeeze": "file"}
    np.testing.assert_array_equal(motion.q[0], [own.q[0, 0], own.q[0, 1], own.q[0, 2] + 0.02])
    moved = lifted(scene, 0.001)
    motion, owners = replace(grasp, pose=moved, file_grasp=given).motion()
    assert owners == {"pregrasp": "own", "squeeze": "own"}
    np.testing.assert_array_equal(motion.T_world_root[0, 1], moved.T_object_root)


def test_what_was_compiled_is_kept(make_world: MakeWorld, scene: Scene) -> None:
    world = make_world(scene, DEXGRASPBENCH)
    assert make_world(replace(scene, q=scene.q + 1.0), protocol_of("dexgraspbench")) is world
    assert make_world(scene, STRICT) is not world
    assert make_world(scene, STRICT).hand is world.hand
    # Only what is lifted stands on a table.
    low, high = (replace(scene, task=Task(table=offset)) for offset in (-0.05, -0.02))
    assert make_world(low, TABLETOP) is not make_world(high, TABLETOP)
    assert make_world(low, DEXGRASPBENCH) is make_world(high, DEXGRASPBENCH) is world


class Stopping(Control):
    """A control that counts checks and ends its job when a share of it is done."""

    def __init__(self, at: float) -> None:
        self.checks = 0
        super().__init__(lambda share, what: self.stop() if share is not None and share >= at else None)

    def check(self) -> None:
        self.checks += 1
        super().check()


def test_a_job_can_be_stopped_at_each_step_of_a_simulation(make_world: MakeWorld, grasp: PosedGrasp) -> None:
    before = run_trial(make_world, grasp, SHORT, ignored())
    steps = 2 * SHORT.moves * SHORT.steps_per_move + SHORT.checks * SHORT.steps_per_check
    for at in (0.1, 0.5, 0.9):
        for doing in (run_trial, lambda *given: record_direction(*given[:2], before, "+x", given[-1])):
            control = Stopping(at)
            with pytest.raises(Stopped):
                doing(make_world, grasp, SHORT, control)
            assert at * steps <= control.checks < at * steps + 60, "preparing is checked, too"
    # Nothing of it is left: the next trial is that from before.
    after = run_trial(make_world, grasp, SHORT, ignored())
    assert [result.reason for result in after.results] == [result.reason for result in before.results]
    moved = [[result.displacement_m for result in trial.results] for trial in (before, after)]
    np.testing.assert_allclose(*moved, atol=1e-6)


def test_a_grasp_that_cannot_start_is_reported_and_cannot_be_watched(
    make_world: MakeWorld, scene: Scene, grasp: PosedGrasp
) -> None:
    pose = file_pose(scene)
    inside = Pose(pose.T_object_root.copy(), pose.q)
    towards = np.array([0.0, 0.0, 0.05]) - pose.T_object_root[:3, 3]  # the middle of the mug
    inside.T_object_root[:3, 3] += 0.08 * towards / np.linalg.norm(towards)
    trial = run_trial(make_world, posed(grasp, inside), SHORT, ignored())
    assert trial.before_push == Reason.PENETRATES and not trial.watchable
    depth = f"{1e3 * trial.penetration_m:.1f} mm"
    assert_names(trial.verdict, depth)
    with refused(GraspRefineError, depth):
        record_direction(make_world, posed(grasp, inside), trial, "+x", ignored())


def test_a_direction_that_is_none_is_refused(make_world: MakeWorld, scene: Scene, grasp: PosedGrasp) -> None:
    trial = run_trial(make_world, posed(grasp, lifted(scene, 1.0)), SHORT, ignored())
    with refused(GraspRefineError, "lift", "+x, -x, +y, -y, +z, -z"):
        record_direction(make_world, posed(grasp, lifted(scene, 1.0)), trial, "lift", ignored())


def test_settings_and_friction_that_cannot_be_are_refused() -> None:
    assert protocol_of("strict") == STRICT
    assert protocol_of("dexgraspbench", 0.3).torsion == pytest.approx(0.01)
    with refused(GraspRefineError, "soft", "dexgraspbench, strict"):
        protocol_of("soft")
    for friction in (0.0, -1.0, 11.0, float("nan")):
        with refused(GraspRefineError, "friction", "0", "10", f"{friction:g}"):
            protocol_of("dexgraspbench", friction)
