"""The panel that tests a grasp in MuJoCo, with the real controller and viser server, on the embedded example."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.panels.play_bar import PLAY
from grasp_refine_apps.viewer.panels.validate_panel import ValidatePanel
from open_viewer import controller, example, shown_panel
from websocket_page import Page, until

Shown = tuple[Controller, ValidatePanel, Page]


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The first example grasp that holds with the usual friction."""
    return example(index=(1,))


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem)
    with shown_panel(ValidatePanel, made) as (panel, page):
        yield made, panel, page


def test_a_grasp_that_fails_is_tested_and_its_failure_is_watched(shown: Shown) -> None:
    made, panel, page = shown
    assert panel.notes.content == "" and not panel.watch.visible
    page.change(panel.friction, 0.15)
    page.change(panel.test, True)
    until(lambda: made.state.trial is not None and panel.watch.visible)
    assert made.state.trial.protocol.friction == 0.15
    assert made.state.trial.verdict in panel.result.content and "gr-no" in panel.result.content
    assert "friction 0.15" in panel.notes.content
    assert panel.watch.options == ("+x", "-x", "+y", "-y", "+z", "-z")
    # While it was simulated, it said how far it was.
    bars = page.told(panel.bar)
    assert bars == sorted(bars) and len(bars) > 3 and bars[-1] > 50
    until(lambda: not panel.bar.visible and not panel.stop.visible)
    page.change(panel.watch, "+z")
    until(lambda: made.state.motion is not None and panel.slider.visible)
    motion = made.state.motion
    seconds = float(motion.time[-1] - motion.time[0])
    assert "+z" in motion.title and not motion.succeeds and 0.8 < seconds < 2.8
    # It plays at once, in real time, and ends by itself.
    until(lambda: made.state.motion_frame == len(motion) - 1)
    until(lambda: panel.replay.button.label == PLAY and panel.slider.value == pytest.approx(seconds))
    assert panel.slider.max == pytest.approx(seconds) and f"+z, {seconds - 0.8:.2f} s" in panel.line.content
    told = page.told(panel.slider)
    assert told == sorted(told) and len(told) > 2
    # Scrubbing shows that moment.
    page.change(panel.slider, 0.5)
    frame = int(np.searchsorted(motion.time - motion.time[0], 0.5 + 1e-9)) - 1
    until(lambda: made.state.motion_frame == frame)
    np.testing.assert_array_equal(made.state.shown.q, motion.q[frame])
    np.testing.assert_array_equal(made.state.T_shown_object, motion.T_object[frame])
    until(lambda: ", 0.10 s" in panel.line.content)
    page.change(panel.end, True)
    until(lambda: made.state.motion is None and not panel.slider.visible)
    assert not any(widget.visible for widget in (panel.line, panel.end, panel.replay.button)) and panel.watch.visible
    # An edited grasp is no longer the one that was tested.
    made.editor.set_joint(0, 0.1)
    until(lambda: made.state.trial is None and not panel.watch.visible)


@pytest.mark.parametrize(("name", "friction", "torsion"), [("strict", 0.3, 0.002), ("tabletop", 0.6, 0.02)])
def test_a_protocol_brings_its_friction(shown: Shown, name: str, friction: float, torsion: float) -> None:
    made, panel, page = shown
    page.change(panel.protocol, name)
    until(lambda: panel.friction.value == friction and made.state.protocol == (name, None))
    page.change(panel.test, True)
    until(lambda: made.state.trial is not None)
    protocol = made.state.trial.protocol
    assert (protocol.name, protocol.friction, protocol.torsion) == (name, friction, torsion)
    directions = ("lift",) if name == "tabletop" else ("+x", "-x", "+y", "-y", "+z", "-z")
    until(lambda: panel.watch.options == directions and made.state.trial.verdict in panel.result.content)


def test_a_test_is_stopped(shown: Shown) -> None:
    made, panel, page = shown

    def buttons() -> tuple[Any, ...]:
        return panel.stop.visible, panel.test.disabled, made.state.job is not None

    for _ in range(2):
        page.change(panel.test, True)
        until(lambda: buttons() == (True, True, True))
        page.change(panel.stop, True)
        until(lambda: buttons() == (False, False, False))
