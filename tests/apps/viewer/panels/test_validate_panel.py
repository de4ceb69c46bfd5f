"""The panel that tests a grasp in MuJoCo, with the real controller and viser server, on the embedded example."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.panels.play_bar import PLAY
from grasp_refine_apps.viewer.panels.validate_panel import ValidatePanel
from open_viewer import controller, example, shown_panel
from websocket_page import Page, until


@dataclass
class Shown:
    """A page with the panel."""

    controller: Controller
    panel: ValidatePanel
    page: Page

    def widget(self, name: str) -> Any:
        return getattr(self.panel, name)

    @property
    def play(self) -> Any:
        return self.panel.replay.button

    def press(self, name: str) -> None:
        self.page.change(self.widget(name), True)

    def tested(self) -> None:
        """Test it, and wait for what comes of it."""
        self.press("test")
        until(lambda: self.controller.state.trial is not None and self.widget("watch").visible)

    def watched(self, direction: str) -> None:
        """Watch a direction, and wait until it is there."""
        self.page.change(self.widget("watch"), direction)
        until(lambda: self.controller.state.motion is not None and self.widget("slider").visible)


def seconds_of(motion: Recording) -> float:
    return float(motion.time[-1] - motion.time[0])


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The first example grasp that holds with the usual friction."""
    return example(index=(1,))


@pytest.fixture
def shown(problem: Problem) -> Iterator[Shown]:
    made = controller(problem)
    with shown_panel(ValidatePanel, made) as (panel, page):
        yield Shown(made, panel, page)


def test_a_grasp_that_fails_is_tested_and_its_failure_is_watched(shown: Shown) -> None:
    assert shown.widget("notes").content == "" and not shown.widget("watch").visible
    shown.page.change(shown.widget("friction"), 0.15)
    shown.tested()
    result = shown.widget("result").content
    assert "gr-no" in result and "1 of 6" in result and "(+z)" in result
    assert "friction 0.15" in shown.widget("notes").content
    assert shown.widget("watch").options == ("+x", "-x", "+y", "-y", "+z", "-z")
    # While it was simulated, it said how far it was.
    bars = shown.page.told(shown.widget("bar"))
    assert bars == sorted(bars) and len(bars) > 3 and bars[-1] > 50
    until(lambda: not shown.widget("bar").visible and not shown.widget("stop").visible)
    assert any("6 directions" in text for text in shown.page.told(shown.widget("doing"), "content"))

    shown.watched("+z")
    motion = shown.controller.state.motion
    assert motion is not None and "+z" in motion.title and not motion.succeeds
    # It is watched until the object fell far enough.
    assert 0.8 < seconds_of(motion) < 2.8
    until(lambda: shown.widget("slider").max == pytest.approx(seconds_of(motion)))
    # It plays at once, in real time, and ends by itself.
    until(lambda: shown.controller.state.motion_frame == len(motion) - 1)
    until(lambda: shown.play.label == PLAY and shown.widget("slider").value == pytest.approx(seconds_of(motion)))
    line = shown.widget("line").content
    assert f"+z, {seconds_of(motion) - 0.8:.2f} s" in line
    seconds = shown.page.told(shown.widget("slider"))
    assert seconds == sorted(seconds) and len(seconds) > 2

    # Scrubbing shows that moment.
    shown.page.change(shown.widget("slider"), 0.5)
    frame = int(np.searchsorted(motion.time - motion.time[0], 0.5 + 1e-9)) - 1
    until(lambda: shown.controller.state.motion_frame == frame)
    np.testing.assert_array_equal(shown.controller.state.shown.q, motion.q[frame])
    np.testing.assert_array_equal(shown.controller.state.T_shown_object, motion.T_object[frame])
    until(lambda: ", 0.10 s" in shown.widget("line").content)

    shown.press("end")
    until(lambda: shown.controller.state.motion is None and not shown.widget("slider").visible)
    assert not any(shown.widget(name).visible for name in ("line", "end")) and not shown.play.visible
    assert shown.widget("watch").visible


def test_a_setting_brings_its_friction(shown: Shown) -> None:
    untested = shown.widget("result").content
    shown.page.change(shown.widget("protocol"), "strict")
    until(lambda: shown.widget("friction").value == 0.3)
    shown.tested()
    assert shown.widget("result").content != untested
    trial = shown.controller.state.trial
    assert trial is not None and trial.protocol.name == "strict"
    # That of the protocol, with its torsion, which is not in proportion to that of others.
    assert (trial.protocol.friction, trial.protocol.torsion) == (0.3, 0.002)
    # An edited grasp is no longer the one that was tested.
    T = shown.controller.state.pose.T_object_root.copy()
    T[2, 3] += 0.001
    shown.controller.editor.move_root(T)
    until(lambda: shown.widget("result").content == untested and not shown.widget("watch").visible)


def test_a_lift_has_one_direction(shown: Shown) -> None:
    shown.page.change(shown.widget("protocol"), "tabletop")
    until(lambda: shown.widget("friction").value == 0.6)
    shown.press("test")
    until(lambda: shown.controller.state.trial is not None and shown.widget("watch").options == ("lift",))
    # The table is where the hand is: there is nothing to watch.
    until(lambda: "pregrasp" in shown.widget("result").content)
    assert not shown.widget("watch").visible


def test_a_test_is_stopped(shown: Shown) -> None:
    for _ in range(3):
        shown.press("test")
        until(lambda: shown.widget("stop").visible and shown.widget("test").disabled)
        shown.press("stop")
        until(lambda: shown.controller.state.job is None and not shown.widget("stop").visible)
        until(lambda: not shown.widget("test").disabled)
