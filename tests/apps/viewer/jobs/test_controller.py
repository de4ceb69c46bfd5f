"""The controller, without viser: commands in, states out."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, inverse, transform, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs import batches as batches_module
from grasp_refine_apps.viewer.jobs import controller as controller_module
from grasp_refine_apps.viewer.jobs import editor, many, refinement
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from grasp_refine_apps.viewer.model.choice import chosen
from grasp_refine_apps.viewer.model.listing import NO_MARK, Listing
from grasp_refine_apps.viewer.model.marks import marks_path
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.present import present
from grasp_refine_apps.viewer.model.state import DisplayOptions
from grasp_refine_apps.viewer.model.trace import Trace
from open_viewer import controller, example, settled
from refusals import assert_names
from running_processes import PATIENCE_S
from websocket_page import until

SLIPPING = 1
"""The first example grasp that holds with the usual friction: with little, the object turns in the hand."""


@pytest.fixture(scope="module")
def prepared(problem: Problem) -> HandObject:
    return HandObject.of(problem.groups[0].scene)


@pytest.fixture
def viewer(problem: Problem, prepared: HandObject, monkeypatch: pytest.MonkeyPatch) -> Iterator[Controller]:
    # Preparing takes a second.
    monkeypatch.setattr(controller_module, "HandObject", lambda hand, obj: prepared)
    made = controller(problem)
    yield made
    made.close()


def same(one: Pose, other: Pose) -> bool:
    return np.array_equal(one.T_object_root, other.T_object_root) and np.array_equal(one.q, other.q)


# refining


def test_a_refinement_ends_where_the_command_line_ends(viewer: Controller) -> None:
    states = []
    viewer.listen(states.append)
    viewer.refinement.start()
    settled(viewer)
    state = viewer.state
    alone = refine(state.collection.scene(0), Settings().config())
    # The pose went through quaternions.
    np.testing.assert_allclose(state.pose.T_object_root, alone.T_world_root[0], atol=1e-12)
    np.testing.assert_array_equal(state.pose.q, alone.q[0])
    trace = state.trace
    assert trace is not None and len(trace) > 20 and len(trace.label) == len(trace)
    assert same(trace.pose(len(trace) - 1), state.pose)
    np.testing.assert_array_equal(trace.pose(0).T_object_root, state.initial.T_object_root)
    assert trace.remaining[0] > 1e-3 and trace.remaining[-1] < 1e-5
    assert trace.penetration[0] > 1e-3 and trace.penetration[-1] < 1e-5
    assert state.outcome is not None and state.outcome.quality[0, 1] > 0.95 > state.outcome.quality[0, 0]
    # The remaining gap is of the links that touch in the end; the input grasp has contact links of its own.
    before, after = state.outcome["contact_error_m"][0]
    assert trace.remaining[0] > 2 * before
    assert trace.remaining[-1] == pytest.approx(after, abs=1e-9)
    assert viewer.contacts(state).contact_error == pytest.approx(after, abs=1e-9)
    viewer.player.scrub(0)
    assert viewer.contacts(viewer.state).contact_error == pytest.approx(before, abs=1e-9)
    # It was seen while it ran.
    seen = [state for state in states if state.job is not None and state.job.kind == "refine" and state.trace]
    assert len({len(state.trace) for state in seen}) > 3
    assert [state.change for state in states] == sorted({state.change for state in states})


def test_of_several_starts_the_timeline_shows_the_one_that_led_to_the_result(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It jumped between them."""
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)  # so that all starts are tried
    viewer.set(settings=Settings(starts=4))
    start = viewer.state.pose
    viewer.refinement.start()
    settled(viewer, 60.0)
    trace, outcome = viewer.state.trace, viewer.state.outcome
    assert outcome["starts"][0] > 1
    assert same(trace.pose(0), start) and same(trace.pose(len(trace) - 1), viewer.state.pose)
    tries = {label.partition(", ")[2] for label in trace.label[1:-1]}
    assert len(tries) == 1 and np.isfinite(trace.remaining).all() and np.isfinite(trace.penetration).all()
    # One way has no jumps but those at its beginning, to a start nearby, and at its end, to its best iteration.
    assert np.linalg.norm(np.diff(trace.T_root[1:-1, :3, 3], axis=0), axis=1).max() < 0.02


def test_stop_takes_effect_at_the_next_iteration_and_keeps_what_was_reached(viewer: Controller) -> None:
    viewer.set(settings=Settings(solver="descent", iterations=100_000, tolerance=0.0))
    viewer.refinement.start()
    until(lambda: viewer.state.trace is not None and len(viewer.state.trace) > 3)
    viewer.stop()
    assert viewer.state.job is None
    # All iterations would take hours, and the next job begins after this one.
    assert viewer.run_job("export", "next", lambda control: None)
    settled(viewer)
    assert viewer.state.trace is not None
    assert same(viewer.state.pose, viewer.state.trace.pose(len(viewer.state.trace) - 1))


def test_a_stopped_refinement_that_reports_late_changes_nothing(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, release, shown = (threading.Event() for _ in range(3))
    zero = np.zeros(1)
    measures = {"gap": np.zeros((1, 1)), "loss": zero, "remaining": zero, "penetration": zero}
    late = Trace.of(np.eye(4)[None], np.zeros((1, 16)), **measures, label=("late",))

    def refine_late(prepared: object, scene: object, pose: object, *given: Any) -> None:
        _, _, control, show, *_ = given
        began.set()
        release.wait(PATIENCE_S)
        show(late)
        shown.set()
        control.check()

    monkeypatch.setattr(refinement, "refine_grasp", refine_late)
    viewer.refinement.start()
    assert began.wait(PATIENCE_S)
    viewer.stop()
    assert viewer.run_job("export", "next", lambda control: None)
    release.set()
    assert shown.wait(PATIENCE_S)
    assert viewer.state.trace is None


def test_pause_holds_step_does_one_iteration_and_start_goes_on(viewer: Controller) -> None:
    def count() -> int:
        return 0 if viewer.state.trace is None else len(viewer.state.trace)

    viewer.refinement.step()
    until(lambda: count() == 1)
    time.sleep(0.05)
    assert count() == 1 and viewer.state.job.paused
    viewer.refinement.step()
    until(lambda: count() == 2)
    viewer.refinement.pause()
    until(lambda: not viewer.state.job or not viewer.state.job.paused)
    settled(viewer)
    assert count() > 20


def test_scrubbing_shows_an_iteration_and_starting_begins_there(viewer: Controller) -> None:
    viewer.refinement.start()
    settled(viewer)
    trace, end = viewer.state.trace, viewer.state.pose
    viewer.player.scrub(3)
    assert same(viewer.state.shown, trace.pose(3)) and same(viewer.state.pose, end)
    viewer.player.scrub(10_000)
    assert viewer.state.frame == len(trace) - 1
    viewer.player.scrub(None)
    assert same(viewer.state.shown, end)
    viewer.player.scrub(3)
    viewer.refinement.start()
    settled(viewer)
    assert same(viewer.state.trace.pose(0), trace.pose(3))
    viewer.editor.undo()
    assert same(viewer.state.pose, trace.pose(3))


def test_options_that_cannot_be_are_reported_and_nothing_begins(viewer: Controller) -> None:
    viewer.set(settings=Settings(margin=-1.0))
    viewer.refinement.start()
    notice = viewer.state.notice
    assert viewer.state.job is None and notice is not None and notice.bad
    assert_names(notice.text, "--margin", "-1")
    viewer.set(settings=Settings(contacts=("no_link",)))
    viewer.refinement.start()
    settled(viewer)
    assert viewer.state.notice.number == notice.number + 1 and "no_link" in viewer.state.notice.text


def test_reset_goes_back_to_the_grasp_as_it_came(viewer: Controller) -> None:
    first = viewer.state.pose
    viewer.refinement.start()
    settled(viewer)
    refined = viewer.state.pose
    viewer.editor.reset()
    assert same(viewer.state.pose, first) and viewer.state.trace is None and viewer.state.outcome is None
    viewer.editor.undo()
    assert same(viewer.state.pose, refined)


# editing


def test_joints_stay_within_their_limits_and_a_drag_is_one_step(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(editor, "MERGE_WINDOW_S", np.inf)
    hand, first = viewer.state.collection.hand, viewer.state.pose
    for value in (0.1, 0.2, 99.0):
        viewer.editor.set_joint(2, value)
    assert viewer.state.pose.q[2] == hand.upper[2]
    assert np.array_equal(np.delete(viewer.state.pose.q, 2), np.delete(first.q, 2))
    viewer.editor.undo()
    assert same(viewer.state.pose, first) and not viewer.state.undo_steps
    viewer.editor.redo()
    assert viewer.state.pose.q[2] == hand.upper[2]


def test_moving_the_object_leaves_the_hand_where_it_is_drawn(viewer: Controller) -> None:
    before = viewer.state.pose.T_object_root
    T = transform(exp_so3(np.array([0.1, -0.2, 0.3])), np.array([0.01, 0.02, -0.03]))
    viewer.editor.move_object(transform(exp_so3(np.array([0.0, 0.4, 0.0])), np.array([0.0, 0.05, 0.0])))
    viewer.editor.move_object(T)
    state = viewer.state
    np.testing.assert_allclose(state.T_world_object @ state.pose.T_object_root, before, atol=1e-12)
    np.testing.assert_allclose(state.pose.T_object_root, inverse(T) @ before, atol=1e-12)
    viewer.editor.undo()
    np.testing.assert_array_equal(viewer.state.T_world_object, np.eye(4))


def test_an_edit_ends_what_is_being_refined(viewer: Controller) -> None:
    viewer.set(settings=Settings(solver="descent", iterations=100_000, tolerance=0.0))
    viewer.refinement.start()
    until(lambda: viewer.state.trace is not None)
    viewer.editor.set_joint(0, 0.1)
    assert viewer.state.job is None and viewer.state.pose.q[0] == 0.1
    time.sleep(0.1)
    assert viewer.state.pose.q[0] == 0.1


# one contact error


def test_a_finger_that_is_moved_away_still_counts(viewer: Controller) -> None:
    """It was left out as soon as it was out of reach, so that the error became 0.00."""
    assert 1e-4 < viewer.contacts(viewer.state).contact_error < 0.02
    links = viewer.contacts(viewer.state).link
    for joint, name in enumerate(viewer.state.collection.hand.joint_names):
        viewer.editor.set_joint(joint, viewer.state.collection.hand.lower[joint])
        assert name
    found = viewer.contacts(viewer.state)
    assert found.contact_error > 0.03 and set(found.link) & set(links)
    viewer.editor.move_root(transform(np.eye(3), np.array([0.0, 0.0, 1.0])))
    assert viewer.contacts(viewer.state).contact_error > 0.5


def test_with_targets_before_and_the_first_iteration_are_the_same(viewer: Controller) -> None:
    viewer.targets.set_nearest()
    settled(viewer)
    start = viewer.contacts(viewer.state).contact_error
    viewer.refinement.start()
    settled(viewer, 60.0)
    trace, (before, after) = viewer.state.trace, viewer.state.outcome["contact_error_m"][0]
    assert trace.remaining[0] == pytest.approx(before, abs=1e-9)
    assert start == pytest.approx(before, abs=1e-9)
    assert viewer.contacts(viewer.state).contact_error == pytest.approx(after, abs=1e-9)


def test_a_result_file_has_one_contact_error(problem: Problem, tmp_path: Path) -> None:
    """The heading counted other links than the run: those within reach of the refined hand."""
    refine_problem(problem, Config(margin=0.001)).save(tmp_path / "refined.npz")
    viewer = controller(example(grasps=tmp_path / "refined.npz"))
    measured = viewer.state.collection.columns
    for number in range(4):
        viewer.grasps.show(number)
        error = viewer.contacts(viewer.state).contact_error
        assert error == pytest.approx(measured["contact_error_m_after"].values[number], abs=1e-7)
        viewer.editor.reset()
        error = viewer.contacts(viewer.state).contact_error
        assert error == pytest.approx(measured["contact_error_m_before"].values[number], abs=1e-7)
        viewer.editor.undo()
    viewer.close()


# targets


def test_a_target_set_by_clicks_is_reached(viewer: Controller) -> None:
    viewer.targets.set_nearest()
    settled(viewer)
    near = {target.link: target for target in viewer.state.targets}
    viewer.targets.clear()
    assert viewer.state.targets == ()
    link = "link_7.0_tip"  # in the middle of the wall
    viewer.targets.set_picking(True)
    viewer.targets.pick_object(near[link].point_object)
    assert viewer.state.notice is not None and viewer.state.targets == ()
    for name, target in near.items():
        viewer.targets.pick_link(name, target.point_link)
        assert viewer.state.picked[0] == name
        # On the side of the mug, a bit higher.
        viewer.targets.pick_object(target.point_object + (np.array([0.0, 0.0, 0.004]) if name == link else 0.0))
    assert [target.link for target in viewer.state.targets] == list(near) and viewer.state.picked is None
    viewer.refinement.start()
    settled(viewer, 60.0)
    state = viewer.state
    chain = Chain(state.collection.hand, [target.link for target in state.targets])
    T = chain(state.pose.T_object_root[None], state.pose.q[None]).T_world_link[0]
    reached = transform_points(T, np.array([target.point_link for target in state.targets]))
    wanted = np.array([target.point_object for target in state.targets])
    assert np.linalg.norm(reached - wanted, axis=1).max() < 1.5e-3


def test_targets_are_moved_replaced_deleted_and_brought_back(viewer: Controller) -> None:
    viewer.targets.set_picking(True)
    for place in (0.0, 0.01):
        viewer.targets.pick_link("link_3.0_tip", np.zeros(3))
        viewer.targets.pick_object(np.array([place, 0.0, 0.0]))
    assert len(viewer.state.targets) == 1 and viewer.state.targets[0].point_object[0] == 0.01
    viewer.targets.move(0, np.array([0.0, 0.02, 0.0]))
    assert viewer.state.targets[0].point_object[1] == 0.02
    viewer.targets.delete(0)
    viewer.targets.delete(7)
    assert viewer.state.targets == ()
    viewer.editor.undo()
    assert viewer.state.targets[0].point_object[1] == 0.02
    # A click on a hand that was replaced meanwhile.
    viewer.targets.pick_link("no link", np.zeros(3))
    assert viewer.state.picked is None and len(viewer.state.targets) == 1


# validation


def test_an_earlier_iteration_that_is_tested_can_be_undone(viewer: Controller) -> None:
    """The refined pose was in no step once."""
    viewer.refinement.start()
    settled(viewer)
    refined = viewer.state.pose
    viewer.player.scrub(1)
    tested = viewer.state.standing
    viewer.simulation.test("dexgraspbench", 0.15)
    settled(viewer)
    assert same(viewer.state.pose, tested) and not same(tested, refined) and viewer.state.trial is not None
    viewer.editor.undo()
    assert same(viewer.state.pose, refined)


def test_a_trial_says_what_held_and_is_of_one_pose_and_its_motion_is_only_looked_at(viewer: Controller) -> None:
    viewer.grasps.show(SLIPPING)
    first = viewer.state.pose
    viewer.simulation.test("dexgraspbench", 0.15)
    settled(viewer)
    trial = viewer.state.trial
    assert trial is not None and trial.directions == ("+x", "-x", "+y", "-y", "+z", "-z") and not trial.held
    # The table has it, too.
    assert present(viewer.state).columns["held"].values.tolist() == ["", "failed", "", ""]
    viewer.simulation.record("+z")
    settled(viewer)
    motion = viewer.state.motion
    assert len(motion) > 50 and viewer.state.motion_frame == 0
    viewer.player.show_frame(10_000)
    assert viewer.state.motion_frame == len(motion) - 1
    assert np.linalg.norm(viewer.state.T_shown_object[:3, 3]) > 0.01
    assert not same(viewer.state.shown, first) and same(viewer.state.standing, first)
    viewer.player.show(None)
    assert same(viewer.state.shown, first) and viewer.state.trial is trial
    # A new target leaves the trial of the pose, a moved joint does not.
    viewer.targets.set_nearest()
    settled(viewer)
    assert viewer.state.targets and viewer.state.trial is trial
    viewer.player.show(motion)
    viewer.player.show_frame(10_000)
    viewer.editor.set_joint(0, first.q[0] + 0.01)
    assert np.array_equal(viewer.state.pose.q[1:], first.q[1:]) and viewer.state.motion is None
    np.testing.assert_array_equal(viewer.state.pose.T_object_root, first.T_object_root)
    assert viewer.state.trial is None
    viewer.editor.undo()
    viewer.editor.undo()
    assert viewer.state.targets == ()
    viewer.simulation.test("dexgraspbench", -1.0)
    assert viewer.state.notice.bad
    assert_names(viewer.state.notice.text, "friction", "0", "-1")


# what is open


def test_another_grasp_has_a_history_of_its_own(viewer: Controller) -> None:
    viewer.editor.set_joint(0, 0.1)
    viewer.set(display=DisplayOptions(forces=True))
    viewer.grasps.show(2)
    state = viewer.state
    assert state.number == 2 and not state.undo_steps and state.display.forces
    np.testing.assert_array_equal(state.pose.q, state.collection.scene(2).q[0])
    viewer.grasps.show(99)
    assert viewer.state.number == 2


def test_what_was_made_of_a_grasp_is_there_again_and_in_the_table(viewer: Controller) -> None:
    """It was lost by Next and Previous, and never reached Browse."""
    viewer.refinement.start()
    settled(viewer)
    viewer.simulation.test()
    settled(viewer)
    made = viewer.state.work
    assert made.refined_at is not None and made.tested_at is not None
    viewer.grasps.show(1)
    assert viewer.state.outcome is None and viewer.state.trial is None and viewer.state.unsaved == (0,)
    columns = present(viewer.state).columns
    assert columns["quality_after"].values[0] == pytest.approx(made.outcome.quality[0, 1])
    assert columns["contact_error_m_before"].values[0] == pytest.approx(made.outcome["contact_error_m"][0, 0])
    assert columns["held"].values.tolist() == ["held" if made.trial.held else "failed", "", "", ""]
    assert columns["here"].values[0].startswith("refined") and columns["here"].values[1] == ""
    assert np.isnan(columns["quality_after"].values[1:]).all()
    viewer.grasps.show(0)
    assert viewer.state.work is made
    viewer.editor.undo()
    assert viewer.state.outcome is None and viewer.state.unsaved == ()


def test_an_edited_grasp_has_no_measures_of_its_file(viewer: Controller) -> None:
    viewer.background.measure()
    settled(viewer)
    viewer.editor.set_joint(0, 0.1)
    columns = present(viewer.state).columns
    assert np.isnan(columns["quality_after"].values).tolist() == [True, False, False, False]
    assert columns["here"].values.tolist() == ["edited", "", "", ""]
    viewer.editor.undo()
    assert present(viewer.state) is viewer.state.collection


def test_all_are_refined_as_each_alone_and_what_is_done_is_not_done_again(viewer: Controller) -> None:
    viewer.grasps.show(1)
    viewer.refinement.start()
    settled(viewer)
    alone = viewer.state.work
    viewer.editor.undo()
    viewer.grasps.show(2)
    viewer.targets.set_nearest()
    settled(viewer)
    aimed = viewer.state.targets
    viewer.grasps.show(0)
    viewer.many.refine(range(4))
    assert viewer.state.job.kind == "batch"
    settled(viewer, 60.0)
    works = viewer.state.works
    assert viewer.state.unsaved == (0, 1, 2, 3) and viewer.state.outcome is works[0].outcome
    np.testing.assert_allclose(works[1].pose.q, alone.pose.q, atol=1e-7)
    np.testing.assert_allclose(works[1].pose.T_object_root, alone.pose.T_object_root, atol=1e-7)
    assert not np.isnan(works[2].outcome.target_point_link).all() and works[2].targets is aimed
    assert np.isnan(works[3].outcome.target_point_link).all()
    before = {number: work.outcome for number, work in works.items()}
    viewer.many.refine(range(4))
    assert viewer.state.job is None and all(viewer.state.works[n].outcome is before[n] for n in range(4))
    viewer.editor.undo()
    assert viewer.state.outcome is None and viewer.state.unsaved == (1, 2, 3)
    viewer.many.test((1, 3))
    settled(viewer, 60.0)
    held = present(viewer.state).columns["held"].values.tolist()
    assert held[0] == held[2] == "" and {held[1], held[3]} <= {"held", "failed"}
    assert [viewer.state.works[n].trial is None for n in range(4)] == [True, False, True, False]
    viewer.grasps.mark_saved({1: viewer.state.works[1].pose})
    assert viewer.state.unsaved == (2, 3)


def test_many_that_are_stopped_keep_what_is_done_and_changed_ones_are_left_alone(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batches_module, "BATCH_SIZE", 1)
    viewer.grasps.show(3)
    refine_batch = many.refine_batch

    def refine_slowly(batch: Any, *given: Any) -> Any:
        if batch.numbers == (3,):
            # The user moves it just then.
            viewer.editor.set_joint(0, 0.1)
        found = refine_batch(batch, *given)
        if batch.numbers == (1,):
            assert viewer.state.works[0].outcome is not None
        return found

    monkeypatch.setattr(many, "refine_batch", refine_slowly)
    viewer.many.refine((0, 1, 3))
    settled(viewer, 60.0)
    works = viewer.state.works
    assert works[0].outcome is not None and works[1].outcome is not None
    assert works[3].outcome is None and works[3].pose.q[0] == 0.1 and len(works[3].undo_steps) == 1
    viewer.set(settings=Settings(solver="descent", iterations=100_000, tolerance=0.0))
    viewer.many.refine((2,))
    assert viewer.state.job.kind == "batch"
    viewer.grasps.show(1)
    assert viewer.state.job.kind == "batch"
    viewer.stop()
    assert viewer.state.job is None and 2 not in viewer.state.works and viewer.state.outcome is not None


def test_what_is_chosen_is_what_is_listed_or_marked(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(viewer.state.collection), "save_marks", lambda self, number: None)
    for number in (1, 3):
        viewer.grasps.mark(number, "good")
    assert chosen(viewer.state, "all") == (0, 1, 2, 3) and chosen(viewer.state, "marked good") == (1, 3)
    viewer.set(listing=Listing(descending=True, mark=NO_MARK))
    assert chosen(viewer.state, "listed") == (2, 0)


def test_a_mark_that_cannot_be_written_is_reported_and_kept(tmp_path: Path, problem: Problem) -> None:
    path = tmp_path / "mug.npz"
    path.write_bytes(problem.files[0].read_bytes())
    viewer = controller(example(grasps=path))
    viewer.grasps.mark(1, "good")
    assert viewer.state.collection.mark(1) == "good" and viewer.state.notice is None
    marks_path(path).unlink()
    marks_path(path).mkdir()
    viewer.grasps.mark(2, "bad")
    assert viewer.state.collection.mark(2) == "bad" and viewer.state.notice.bad
    viewer.close()


def test_what_is_not_finite_or_no_joint_is_ignored(viewer: Controller) -> None:
    first = viewer.state.pose
    viewer.editor.set_joint(0, np.nan)
    viewer.editor.set_joint(99, 0.1)
    viewer.editor.move_root(np.full((4, 4), np.inf))
    viewer.editor.move_object(np.full((4, 4), np.nan))
    assert viewer.state.pose is first and not viewer.state.undo_steps


def test_measuring_goes_on_after_what_came_first_and_while_others_are_shown(viewer: Controller) -> None:
    assert unmeasured(viewer.state.collection).all()
    viewer.background.measure()
    viewer.refinement.start()
    assert viewer.state.job.kind == "refine"
    viewer.grasps.show(1)
    settled(viewer)
    assert not unmeasured(viewer.state.collection).any() and viewer.state.number == 1
    quality = viewer.state.collection.columns["quality_after"].values
    assert np.isfinite(quality).all()


def test_measuring_that_is_stopped_stays_so(viewer: Controller) -> None:
    viewer.background.measure()
    viewer.stop()
    time.sleep(0.05)
    assert viewer.state.job is None


def test_a_job_that_breaks_is_reported_and_the_viewer_lives_on(
    viewer: Controller, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(control: object) -> None:
        raise RuntimeError("broken")

    viewer.run_job("export", "breaking", work)
    settled(viewer)
    assert viewer.state.notice.bad
    assert_names(viewer.state.notice.text, "RuntimeError", "broken")
    assert "Traceback" in capsys.readouterr().err
    viewer.refinement.start()
    settled(viewer)
    assert viewer.state.outcome is not None


def test_only_one_thing_is_done_at_a_time_but_measuring_gives_way(viewer: Controller) -> None:
    def wait(control: object) -> None:
        while True:
            control.check()
            time.sleep(0.002)

    assert viewer.run_job("export", "waiting", wait)
    viewer.refinement.start()
    assert viewer.state.job.kind == "export"
    viewer.stop()
    assert viewer.run_job("measure", "waiting", wait)
    viewer.refinement.start()
    assert viewer.state.job.kind == "refine"
    settled(viewer)


def test_the_collection_can_grow_while_a_grasp_is_refined(viewer: Controller) -> None:
    viewer.refinement.start()
    known = replace(viewer.state.collection)
    viewer.grasps.open(known, viewer.state.number)
    settled(viewer)
    assert viewer.state.collection is known and viewer.state.outcome is not None
