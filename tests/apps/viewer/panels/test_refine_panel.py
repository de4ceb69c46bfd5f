"""The panel that refines, with the real controller, refinement and viser server, on the embedded example."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from grasp_refine.measures.measures import COMPARED
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.panels.plots import MAX_POINTS, MIN_LENGTH_MM, curves
from grasp_refine_apps.viewer.panels.refine_panel import RefinePanel, job_text, outcome_text
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


@dataclass
class Shown:
    """A page with the panel."""

    controller: Controller
    panel: RefinePanel
    page: Page

    def press(self, name: str) -> None:
        self.page.change(getattr(self.panel, name), True)

    def disabled(self) -> set[str]:
        """Names of the buttons that cannot be pressed."""
        return {name for name in ("start", "pause", "step", "stop", "reset") if getattr(self.panel, name).disabled}

    @property
    def slider(self) -> Any:
        return self.panel.timeline.slider


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem, Settings(geometry_only=True))
    with shown_panel(RefinePanel, made) as (panel, page):
        until(lambda: "pause" in Shown(made, panel, page).disabled())
        yield Shown(made, panel, page)


def test_a_refinement_from_start_to_timeline(shown: Shown):
    assert shown.disabled() == {"pause", "stop", "reset"}
    assert shown.slider.disabled and not shown.panel.plot.handle.visible
    shown.press("start")
    until(lambda: shown.controller.state.outcome is not None)
    count = len(shown.controller.state.trace)
    assert count > 2
    until(lambda: shown.slider.max == count - 1 and shown.slider.value == count - 1)
    assert until(lambda: shown.disabled() == {"pause", "stop"})
    assert "**Converged**" in shown.panel.text.content

    # The plot is drawn at the latest a moment later, to the last iteration.
    plot = shown.panel.plot.handle
    until(lambda: plot.visible and plot.data[0][-1] == count - 1)
    error = plot.data[1]
    assert error[-1] < 0.01 * error[0]  # mm
    # A user drags the timeline: the hand is where it was then.
    shown.page.change(shown.slider, 1)
    until(lambda: shown.controller.state.frame == 1)
    assert shown.controller.state.shown.q.tolist() == shown.controller.state.trace.q[1].tolist()
    until(lambda: plot.data[0][np.nanargmax(plot.data[4])] == 1)

    shown.press("reset")
    until(lambda: shown.disabled() == {"pause", "stop", "reset"})
    # Buttons are drawn before the timeline.
    assert until(lambda: shown.slider.disabled and shown.slider.max == 1)
    until(lambda: not plot.visible)


def test_step_by_step(shown: Shown):
    pause = shown.panel.pause.label
    shown.press("step")
    until(lambda: shown.controller.state.trace is not None and len(shown.controller.state.trace) == 1)
    assert until(lambda: shown.disabled() == set())
    assert shown.panel.pause.label != pause and "**Paused**" in shown.panel.text.content
    shown.press("step")
    until(lambda: len(shown.controller.state.trace) == 2)
    until(lambda: shown.slider.value == 1)
    shown.press("pause")
    until(lambda: shown.controller.state.outcome is not None)


def test_iterations_are_played_to_the_end(shown: Shown):
    seen: list[int] = []
    shown.press("start")
    until(lambda: shown.controller.state.outcome is not None)
    last = len(shown.controller.state.trace) - 1
    play = shown.panel.timeline.bar.button
    until(lambda: not play.disabled and shown.controller.state.job is None)
    label = play.label
    # The last changes of the run, in which no frame is shown, may still come.
    shown.controller.listen(lambda state: None if state.frame is None else seen.append(state.frame))
    shown.page.change(play, True)
    until(lambda: seen[-1:] == [last] and play.label == label)
    assert seen[0] == 0 and seen == sorted(seen)


def test_settings_go_to_the_controller_and_mistakes_to_the_user(shown: Shown):
    form = shown.panel.form
    shown.page.change(form.handles["solver"], "descent")
    until(lambda: shown.controller.state.settings.solver == "descent")
    # What only levenberg-marquardt has is hidden, and at its default: `config` would refuse it.
    assert shown.controller.state.settings == Settings(solver="descent")
    shown.page.change(form.handles["margin"], "wide")
    notice = until(lambda: shown.controller.state.notice)
    assert_names(notice.text, "Margin", "'wide'")
    assert notice.bad
    shown.page.change(shown.panel.defaults, True)
    until(lambda: shown.controller.state.settings == Settings(geometry_only=True))
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
    form = shown.panel.form
    margin, move = (form.handles[name] for name in ("margin", "max_move"))
    assert margin.label == "Margin, mm" and form.handles["reach"].value == "10"
    shown.page.change(margin, "1")
    assert until(lambda: shown.controller.state.settings.margin == 0.001)
    assert shown.controller.state.settings.config().margin == 0.001
    assert "degrees" in move.label
    shown.page.change(move, "10, 6, 12")
    until(lambda: shown.controller.state.settings.max_move is not None)
    np.testing.assert_allclose(shown.controller.state.settings.max_move, [0.01, np.radians(6.0), np.radians(12.0)])
    shown.controller.set(settings=Settings(margin=0.0025))
    until(lambda: margin.value == "2.5" and move.value == "")
    for name in ("margin", "reach", "other_link_distance", "max_move", "scales.rotation"):
        hint = form.handles[name].hint
        assert "metres" not in hint and "radians" not in hint, hint
    assert "(default: 3)" in form.handles["other_link_distance"].hint


def test_the_outcome_is_reported_with_advice(shown: Shown):
    shown.controller.set(settings=Settings(solver="descent", iterations=3))
    shown.controller.refinement.start()
    outcome = until(lambda: shown.controller.state.outcome)
    head, *_, advice, table = outcome_text(outcome).split("\n\n")
    assert_names(head, "**Budget**", "3 iterations")
    assert "iterations" in advice
    for measure in COMPARED:
        # Measures of scenes, regions and arms are left out where there is none.
        without = measure.name in ("scene_penetration_m", "region_miss_m", "arm_dexterity_m")
        assert (f"| {measure.headline} |" in table) != without
