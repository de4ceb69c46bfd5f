"""The controller, without viser: commands in, states out."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import transform, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement.refine import refine
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs import batches as batches_module
from grasp_refine_apps.viewer.jobs import many
from grasp_refine_apps.viewer.jobs.batches import batches
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.choice import chosen
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.listing import NO_MARK, Listing
from grasp_refine_apps.viewer.model.marks import marks_path
from grasp_refine_apps.viewer.model.present import present
from grasp_refine_apps.viewer.model.state import MAX_SHELVED, DisplayOptions
from open_viewer import controller, example, made_trial, settled, short_trials
from refusals import assert_names
from websocket_page import until

SLIPPING = 1
"""The first example grasp that holds with the usual friction: with little, the object turns in the hand."""

ENDLESS = Settings(starts=100_000)
"""Settings of a refinement that takes hours where no start is good enough, see `never_good`."""

QUICK = Settings(geometry_only=True)


@pytest.fixture
def never_good(monkeypatch: pytest.MonkeyPatch) -> None:
    """All starts are tried."""
    monkeypatch.setattr(force_closure_search, "GOOD_SCORE", -1.0)


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
    assert trace.pose(len(trace) - 1).same(state.pose)
    np.testing.assert_array_equal(trace.pose(0).T_object_root, state.initial.T_object_root)
    assert trace.penetration[0] > 1e-3 and trace.penetration[-1] < 1e-5
    assert state.outcome is not None and state.outcome.quality[0, 1] > 0.95 > state.outcome.quality[0, 0]
    # The remaining gap is of the links that touch in the end; the input grasp has contact links of its own.
    before, after = state.outcome["contact_error_m"][0]
    assert trace.remaining[0] > max(2 * before, 1e-3) and trace.remaining[-1] == pytest.approx(after, abs=1e-9)
    assert viewer.contacts(state).contact_error == pytest.approx(after, abs=1e-9)
    viewer.player.scrub(0)
    assert viewer.contacts(viewer.state).contact_error == pytest.approx(before, abs=1e-9)
    # It was seen while it ran.
    seen = [state for state in states if state.job is not None and state.job.kind == "refine" and state.trace]
    assert len({len(state.trace) for state in seen}) > 2
    assert [state.change for state in states] == sorted({state.change for state in states})


def test_of_several_starts_the_timeline_shows_the_one_that_led_to_the_result(viewer: Controller, never_good) -> None:
    viewer.set(settings=Settings(starts=4, prefer="strongest"))
    start = viewer.state.pose
    viewer.refinement.start()
    settled(viewer)
    trace, outcome = viewer.state.trace, viewer.state.outcome
    assert outcome["starts"][0] > 1
    assert trace.pose(0).same(start) and trace.pose(len(trace) - 1).same(viewer.state.pose)
    tries = {label.partition(", ")[2] for label in trace.label[1:-1]}
    assert len(tries) == 1 and np.isfinite(trace.remaining).all() and np.isfinite(trace.penetration).all()
    # One run has no jumps but at its beginning, to a start nearby, and at its end, to its best iteration.
    assert np.linalg.norm(np.diff(trace.T_root[1:-1, :3, 3], axis=0), axis=1).max() < 0.02


@pytest.mark.parametrize("stop", [Controller.stop, lambda viewer: viewer.editor.set_joint(0, 0.1)])
def test_stop_and_edits_end_a_refinement_and_keep_what_was_reached(viewer: Controller, never_good, stop) -> None:
    viewer.set(settings=ENDLESS)
    viewer.refinement.start()
    until(lambda: viewer.state.trace is not None and len(viewer.state.trace) > 3)
    stop(viewer)
    state = viewer.state
    assert state.job is None
    # The next job begins after this one.
    assert viewer.run_job("export", "next", lambda control: None)
    settled(viewer)
    assert viewer.state.trace is state.trace is not None and viewer.state.pose is state.pose
    edited = 0.1 if stop is not Controller.stop else state.trace.q[-1, 0]
    assert state.pose.q[0] == edited and np.array_equal(state.pose.q[1:], state.trace.q[-1, 1:])


def test_pause_holds_step_does_one_iteration_and_start_goes_on(viewer: Controller) -> None:
    def count() -> int:
        return 0 if viewer.state.trace is None else len(viewer.state.trace)

    for steps in (1, 2):
        viewer.refinement.step()
        until(lambda steps=steps: count() == steps)
        assert viewer.state.job.paused
    viewer.refinement.pause()
    settled(viewer)
    assert count() > 20


def test_scrubbing_shows_an_iteration_and_starting_begins_there(viewer: Controller) -> None:
    viewer.set(settings=QUICK)
    viewer.refinement.start()
    settled(viewer)
    trace, end = viewer.state.trace, viewer.state.pose
    viewer.player.scrub(1)
    assert viewer.state.shown.same(trace.pose(1)) and viewer.state.pose.same(end)
    viewer.player.scrub(10_000)
    assert viewer.state.frame == len(trace) - 1
    viewer.player.scrub(None)
    assert viewer.state.shown.same(end)
    viewer.player.scrub(1)
    viewer.refinement.start()
    settled(viewer)
    assert viewer.state.trace.pose(0).same(trace.pose(1))
    viewer.editor.undo()
    assert viewer.state.pose.same(trace.pose(1))


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


# one contact error


def test_a_finger_that_is_moved_away_still_counts(viewer: Controller) -> None:
    """It was left out as soon as it was out of reach, so that the error became 0.00."""
    before = viewer.contacts(viewer.state)
    assert 1e-4 < before.contact_error < 0.02
    for joint, lower in enumerate(viewer.state.collection.hand.lower):
        viewer.editor.set_joint(joint, lower)
    found = viewer.contacts(viewer.state)
    assert found.contact_error > 0.03 and set(found.link) & set(before.link)
    viewer.editor.move_root(transform(np.eye(3), np.array([0.0, 0.0, 1.0])))
    assert viewer.contacts(viewer.state).contact_error > 0.5


def test_with_targets_before_and_the_first_iteration_are_the_same(viewer: Controller) -> None:
    viewer.set(settings=Settings(geometry_only=True))
    viewer.targets.set_nearest()
    settled(viewer)
    start = viewer.contacts(viewer.state).contact_error
    viewer.refinement.start()
    settled(viewer)
    trace, (before, after) = viewer.state.trace, viewer.state.outcome["contact_error_m"][0]
    assert trace.remaining[0] == pytest.approx(before, abs=1e-9) and start == pytest.approx(before, abs=1e-9)
    assert viewer.contacts(viewer.state).contact_error == pytest.approx(after, abs=1e-9)


def test_a_result_file_has_one_contact_error(problem: Problem, tmp_path: Path) -> None:
    """The heading counted other links than the run: those within reach of the refined hand."""
    quick = Settings(margin=0.001, geometry_only=True).config()
    refine_problem(example(index=(0, 2)), quick).save(tmp_path / "refined.npz")
    viewer = controller(example(grasps=tmp_path / "refined.npz"))
    for number in range(2):
        viewer.grasps.show(number)
        for side, act in (("after", lambda: None), ("before", viewer.editor.reset)):
            act()
            measured = viewer.state.collection.columns[f"contact_error_m_{side}"].values[number]
            assert viewer.contacts(viewer.state).contact_error == pytest.approx(measured, abs=1e-7)
        viewer.editor.undo()
    viewer.close()


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
    settled(viewer)
    state = viewer.state
    chain = Chain(state.collection.hand, [target.link for target in state.targets])
    T = chain(state.pose.T_object_root[None], state.pose.q[None]).T_world_link[0]
    reached = transform_points(T, np.array([target.point_link for target in state.targets]))
    wanted = np.array([target.point_object for target in state.targets])
    assert np.linalg.norm(reached - wanted, axis=1).max() < 1.5e-3


# simulation


def test_an_earlier_iteration_that_is_tested_can_be_undone(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refined pose was in no step once."""
    name = short_trials(monkeypatch)
    viewer.set(settings=QUICK)
    viewer.refinement.start()
    settled(viewer)
    refined = viewer.state.pose
    viewer.player.scrub(1)
    tested = viewer.state.standing
    viewer.simulation.test(name, 0.15)
    settled(viewer)
    assert viewer.state.pose.same(tested) and not tested.same(refined) and viewer.state.trial is not None
    viewer.editor.undo()
    assert viewer.state.pose.same(refined)


def test_a_trial_is_of_one_pose_and_its_motion_is_only_looked_at(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer.grasps.show(SLIPPING)
    first = viewer.state.pose
    viewer.simulation.test(short_trials(monkeypatch), 0.15)
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
    assert not viewer.state.shown.same(first) and viewer.state.standing.same(first)
    viewer.player.show(None)
    assert viewer.state.shown.same(first) and viewer.state.trial is trial
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
    viewer.simulation.test("dexgraspbench", -1.0)
    assert viewer.state.notice.bad
    assert_names(viewer.state.notice.text, "friction", "0", "-1")


# open grasps


def test_another_grasp_has_a_history_of_its_own(viewer: Controller) -> None:
    viewer.editor.set_joint(0, 0.1)
    left = viewer.state.work
    viewer.set(display=DisplayOptions(forces=True), gizmo="hand", side_by_side=True, protocol=("strict", 0.5))
    viewer.grasps.show(2)
    state = viewer.state
    assert state.number == 2 and not state.undo_steps
    assert (state.display.forces, state.gizmo, state.side_by_side) == (True, "hand", True)
    assert state.protocol == ("strict", 0.5)
    np.testing.assert_array_equal(state.pose.q, state.collection.scene(2).q[0])
    viewer.grasps.show(99)
    assert viewer.state.number == 2
    viewer.grasps.show(0)
    assert viewer.state.work is left and viewer.state.unsaved == (0,)


def test_the_shelf_keeps_the_last_files_and_all_with_unsaved_grasps(viewer: Controller, problem: Problem) -> None:
    collections = [controller(replace(problem)).state.collection for _ in range(MAX_SHELVED + 3)]
    viewer.editor.set_joint(0, 0.1)
    first = viewer.state.collection
    for collection in collections:
        viewer.grasps.open(collection, 1)
    shelf = viewer.state.shelf
    kept = [collections[k] for k in range(len(collections) - 2, 1, -1)]
    assert [each.collection for each in shelf] == [*kept[:MAX_SHELVED], first]
    assert shelf[-1].unsaved == (0,) and viewer.state.num_unsaved == 1 and viewer.state.number == 1
    viewer.grasps.reopen(len(shelf) - 1)
    assert viewer.state.unsaved == (0,) and viewer.state.number == 0
    assert [each.collection for each in viewer.state.shelf] == [collections[-1], *kept[: MAX_SHELVED - 1]]


def test_results_of_a_grasp_are_listed_and_gone_with_undo(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were lost by Next and Previous, and never reached Browse."""
    viewer.set(settings=QUICK, protocol=(short_trials(monkeypatch), None))
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
    assert present(viewer.state) is viewer.state.collection


def test_an_edited_grasp_has_no_measures_and_no_verdict_of_its_file(viewer: Controller) -> None:
    viewer.background.measure()
    settled(viewer)
    known = viewer.state.collection.with_trials({n: made_trial(Reason.HELD) for n in (0, 1)})
    viewer.grasps.open(known, 0)
    viewer.editor.set_joint(0, 0.1)
    columns = present(viewer.state).columns
    assert np.isnan(columns["quality_after"].values).tolist() == [True, False, False, False]
    assert columns["here"].values.tolist() == ["edited", "", "", ""]
    assert columns["held"].values.tolist() == ["", "held", "", ""]


def test_a_collection_can_grow_while_a_grasp_is_refined(viewer: Controller) -> None:
    viewer.set(settings=QUICK)
    viewer.refinement.start()
    known = replace(viewer.state.collection)
    viewer.grasps.open(known, viewer.state.number)
    settled(viewer)
    assert viewer.state.collection is known and viewer.state.outcome is not None


# many grasps


def test_batches_hold_grasps_of_one_kind_as_they_stand(viewer: Controller) -> None:
    collection = viewer.state.collection
    gap = np.full(len(viewer.state.scene.links), 0.001)
    works = {number: collection.work(number) for number in range(4)}
    viewer.targets.set_nearest()
    settled(viewer)
    works[2] = replace(works[2], targets=viewer.state.targets)
    works[1] = replace(works[1], counted=Counted(gap), pose=works[0].pose)
    plain, aimed = batches(collection, works)
    assert plain.numbers == (0, 1, 3) and aimed.numbers == (2,)
    for batch in (plain, aimed):
        for i, number in enumerate(batch.numbers):
            np.testing.assert_array_equal(batch.group.scene.q[i], works[number].pose.q)
            np.testing.assert_array_equal(batch.group.scene.T_world_root[i], works[number].pose.T_object_root)
            np.testing.assert_array_equal(batch.group.grasps.q[i], collection.group(number).grasps.q[number])
            assert batch.group.index[i] == number
    assert plain.group.scene.target_object is None and aimed.group.scene.target_object is not None
    np.testing.assert_array_equal(plain.group.scene.contact_gap[1], gap)
    assert np.isnan(plain.group.scene.contact_gap[[0, 2]]).all()


def test_all_are_refined_as_each_alone_and_what_is_done_is_not_done_again(
    viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer.set(settings=QUICK)
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
    settled(viewer)
    works = viewer.state.works
    assert viewer.state.unsaved == (0, 1, 2, 3) and viewer.state.outcome is works[0].outcome
    np.testing.assert_allclose(works[1].pose.q, alone.pose.q, atol=1e-7)
    np.testing.assert_allclose(works[1].pose.T_object_root, alone.pose.T_object_root, atol=1e-7)
    assert not np.isnan(works[2].outcome.target_point_link).all() and works[2].targets is aimed
    assert np.isnan(works[3].outcome.target_point_link).all()
    viewer.many.refine(range(4))
    assert viewer.state.job is None and all(viewer.state.works[n].outcome is works[n].outcome for n in range(4))
    viewer.editor.undo()
    assert viewer.state.outcome is None and viewer.state.unsaved == (1, 2, 3)
    viewer.set(protocol=(short_trials(monkeypatch), None))
    viewer.many.test((1, 3))
    settled(viewer)
    held = present(viewer.state).columns["held"].values.tolist()
    assert held[0] == held[2] == "" and {held[1], held[3]} <= {"held", "failed"}
    trials = [viewer.state.works[n].trial for n in range(4)]
    assert [trial is None for trial in trials] == [True, False, True, False]
    viewer.many.test((1, 3))
    assert viewer.state.job is None, "they are tested"
    viewer.grasps.mark_saved({1: viewer.state.works[1].pose})
    assert viewer.state.unsaved == (2, 3)


def test_many_that_are_stopped_keep_what_is_done_and_changed_ones_are_left_alone(
    viewer: Controller, never_good, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batches_module, "BATCH_SIZE", 1)
    viewer.set(settings=QUICK)
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
    settled(viewer)
    works = viewer.state.works
    assert works[0].outcome is not None and works[1].outcome is not None
    assert works[3].outcome is None and works[3].pose.q[0] == 0.1 and len(works[3].undo_steps) == 1
    viewer.set(settings=ENDLESS)
    viewer.many.refine((2,))
    viewer.grasps.show(1)
    assert viewer.state.job.kind == "batch"
    viewer.stop()
    assert viewer.state.job is None and 2 not in viewer.state.works and viewer.state.outcome is not None


def test_grasps_are_chosen_by_list_and_by_mark(viewer: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
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
