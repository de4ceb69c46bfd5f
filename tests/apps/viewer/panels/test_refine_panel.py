"""The panel that refines, with the real controller, refinement and viser server, on the embedded example."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from grasp_refine.measures.measures import COMPARED
from grasp_refine.problem.problem import Problem
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.panels.form import plain
from grasp_refine_apps.viewer.panels.plots import MAX_POINTS, MIN_LENGTH_MM, curves
from grasp_refine_apps.viewer.panels.refine_panel import AS_OPENED, RefinePanel, job_text, outcome_text
from grasp_refine_apps.viewer.panels.timeline import numbers
from open_viewer import controller, shown_panel
from refusals import assert_names
from websocket_page import Page, until


def trace_of(count: int, n: int = 2) -> Trace:
    falling = 0.01 * 0.9 ** np.arange(count)
    return Trace.of(
        np.broadcast_to(np.eye(4), (count, 4, 4)),
        np.zeros((count, n)),
        gap=np.zeros((count, 1)),
        loss=falling**2,
        remaining=falling,
        penetration=np.zeros(count),
        label=("slide",) * count,
    )


Shown = tuple[Controller, RefinePanel, Page]


def disabled(panel: RefinePanel) -> set[str]:
    """Names of the buttons that cannot be pressed."""
    return {name for name in ("start", "pause", "step", "stop", "reset") if getattr(panel, name).disabled}


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem, Settings(geometry_only=True))
    with shown_panel(RefinePanel, made) as (panel, page):
        until(lambda: "pause" in disabled(panel))
        yield made, panel, page


def test_a_refinement_from_start_to_timeline(shown: Shown):
    made, panel, page = shown
    slider, plot, play = panel.timeline.slider, panel.plot.handle, panel.timeline.bar.button
    assert disabled(panel) == {"pause", "stop", "reset"} and slider.disabled and not plot.visible
    page.change(panel.start, True)
    until(lambda: made.state.outcome is not None)
    trace = made.state.trace
    last = len(trace) - 1
    until(lambda: slider.max == last == slider.value and disabled(panel) == {"pause", "stop"})
    assert "**Converged**" in panel.text.content
    # The plot is drawn at the latest a moment later, to the last iteration.
    until(lambda: plot.visible and plot.data[0][-1] == last)
    np.testing.assert_allclose(plot.data[1][-1], max(1e3 * trace.remaining[-1], MIN_LENGTH_MM))
    # A user drags the timeline: the hand is where it was then.
    page.change(slider, 1)
    until(lambda: made.state.frame == 1)
    assert made.state.shown.q.tolist() == trace.q[1].tolist()
    until(lambda: plot.data[0][np.nanargmax(plot.data[4])] == 1)
    seen: list[int] = []
    label = play.label
    page.change(slider, last)
    until(lambda: made.state.frame == last)
    made.listen(lambda state: None if state.frame is None else seen.append(state.frame))
    page.change(play, True)
    until(lambda: seen[-1:] == [last] and seen[0] == 0 and play.label == label)
    assert seen == sorted(seen)
    page.change(panel.reset, True)
    until(lambda: disabled(panel) == {"pause", "stop", "reset"} and slider.disabled and slider.max == 1)
    until(lambda: not plot.visible)


def test_step_by_step(shown: Shown):
    made, panel, page = shown
    pause = panel.pause.label
    page.change(panel.step, True)
    until(lambda: made.state.trace is not None and len(made.state.trace) == 1 and disabled(panel) == set())
    assert panel.pause.label != pause and "**Paused**" in panel.text.content
    page.change(panel.step, True)
    until(lambda: len(made.state.trace) == 2 and panel.timeline.slider.value == 1)
    # The last iteration of a refinement that runs follows it; an earlier one stays.
    for frame, expected in ((0, 0), (1, None)):
        page.change(panel.timeline.slider, frame)
        until(lambda expected=expected: made.state.frame == expected)
    page.change(panel.pause, True)
    until(lambda: made.state.outcome is not None)


def test_settings_go_to_the_controller_and_mistakes_to_the_user(shown: Shown):
    made, panel, page = shown
    form = panel.form
    page.change(form.handles["solver"], "descent")
    until(lambda: made.state.settings.solver == "descent")
    # What only levenberg-marquardt has is hidden, and at its default: `config` would refuse it.
    assert made.state.settings == Settings(solver="descent")
    page.change(form.handles["margin"], "wide")
    notice = until(lambda: made.state.notice)
    assert_names(notice.text, "Margin", "'wide'")
    assert notice.bad
    page.change(panel.defaults, True)
    until(lambda: made.state.settings == Settings(geometry_only=True))
    until(lambda: form.handles["solver"].value == "levenberg-marquardt")


def unused(settings: Settings) -> set[str]:
    """Names of the fields without effect."""
    return {name for name, _ in settings.unused()}


@pytest.mark.parametrize("solver", ["levenberg-marquardt", "descent", "adam"])
@pytest.mark.parametrize("change", [{}, {"geometry_only": True}, {"derivative": "analytical"}, {"starts": 9}])
def test_with_unused_settings_at_their_defaults_nothing_is_refused(solver: str, change: dict[str, Any]):
    settings = replace(Settings(), solver=solver, **change)
    plain = Settings()
    usable = replace(settings, **{name: getattr(plain, name) for name in unused(settings) if "." not in name})
    usable.config()


def test_what_is_unused_is_refused_when_it_is_set():
    assert {"starts", "weights.wrench"} <= unused(Settings(geometry_only=True))
    assert "scales" in unused(Settings()) and "neighborhood" in unused(Settings(solver="adam", derivative="analytical"))
    assert "neighborhood" not in unused(Settings(solver="adam"))
    assert "starts" in unused(Settings(weights=replace(Settings().weights, wrench=0.0)))


def test_curves_are_thin_and_keep_the_shown_iteration():
    data = curves(trace_of(5000), 1234)
    x, error, depth, loss, line = data
    assert len(x) <= MAX_POINTS and x[0] == 0 and x[-1] == 4999
    assert np.all(np.diff(x) >= 0) and list(x).count(1234) >= 2
    # An upright line at the shown iteration: one value, between two without.
    (at,) = np.flatnonzero(~np.isnan(line))
    assert x[at - 1] == x[at] == x[at + 1] == 1234
    np.testing.assert_allclose(error[:2], 10.0 * 0.9 ** x[:2])  # mm
    np.testing.assert_allclose(loss[0], 10.0)
    assert np.all(depth == MIN_LENGTH_MM) and error[-1] == MIN_LENGTH_MM  # zeros on a logarithmic axis


@pytest.mark.parametrize("count, frame", [(1, None), (2, 0), (2, None), (3, 99)])
def test_short_traces_have_curves_too(count: int, frame: int | None):
    data = curves(trace_of(count), frame)
    shown = count - 1 if frame is None else min(frame, count - 1)
    assert data[0][np.flatnonzero(~np.isnan(data[4]))].tolist() == [shown]


def test_words_say_what_comes_next(problem: Problem):
    made = controller(problem)
    state = made.state
    assert "**Start**" in job_text(state) and " mm" not in numbers(state)
    moved = state.evolve(trace=trace_of(4, len(state.pose.q)))
    assert " mm" not in numbers(moved) and numbers(moved) != numbers(state)
    assert_names(numbers(moved.evolve(frame=2)), "**Slide**", "8.10 mm", "0.00 mm")
    assert "**Start**" in job_text(moved) and job_text(moved) != job_text(state)
    made.close()


def test_lengths_are_typed_in_millimetres_and_angles_in_degrees(shown: Shown):
    """A margin of 1 was a metre."""
    made, panel, page = shown
    margin, move, reach = (panel.form.handles[name] for name in ("margin", "max_move", "reach"))
    assert margin.label == "Margin, mm" and reach.value == "10" and "degrees" in move.label
    page.change(margin, "1")
    until(lambda: made.state.settings.margin == 0.001)
    page.change(move, "10, 6, 12")
    until(lambda: made.state.settings.max_move is not None)
    np.testing.assert_allclose(made.state.settings.max_move, [0.01, np.radians(6.0), np.radians(12.0)])
    made.set(settings=Settings(margin=0.0025))
    until(lambda: margin.value == "2.5" and move.value == "")
    for name in ("margin", "reach", "other_link_distance", "max_move", "scales.rotation"):
        hint = panel.form.handles[name].hint
        assert "metres" not in hint and "radians" not in hint, hint
    assert "(default: 3)" in panel.form.handles["other_link_distance"].hint


def test_the_outcome_is_reported_with_advice(shown: Shown):
    made, *_ = shown
    made.set(settings=Settings(iterations=3, geometry_only=True))
    made.refinement.start()
    outcome = until(lambda: made.state.outcome)
    verdict, _, head, *_, table = outcome_text(outcome).split("\n\n")
    status = Status(outcome.status[0])
    good = outcome.quality[0, 1] >= HOLDS
    assert_names(verdict, "**Should hold**" if good else "**May slip**", f"{HOLDS:.3f}")
    assert_names(head, f"**{status.label.capitalize()}**", f"{outcome['iterations'][0]} iterations")
    assert plain(status.advice) in outcome_text(outcome)
    assert f"**{outcome.change[0]}** (displacement {1e3 * outcome['displacement_m'][0]:.2f} mm" in outcome_text(outcome)
    for measure in COMPARED:
        # Measures of scenes, regions, arms and scans are left out where there is none.
        without = np.isnan(outcome[measure.name][0]).all()
        assert (f"| {measure.headline} |" in table) != without


def test_another_task_sets_what_is_refined_and_tested_for_and_returns(shown: Shown):
    made, panel, page = shown
    before = made.state.scene.demand
    page.change(panel.task, "tabletop")
    until(lambda: made.state.scene.task.protocol is not None)
    assert made.state.scene.task.protocol.name == made.state.protocol[0] == "tabletop" == panel.task.value
    assert made.state.scene.demand != before
    made.grasps.show(1)
    assert made.state.scene.task.protocol.name == "tabletop", "of all open grasps"
    page.change(panel.task, AS_OPENED)
    until(lambda: made.state.scene.task.protocol is None)
    assert made.state.scene.demand == before
