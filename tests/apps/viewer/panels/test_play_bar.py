"""Frames are played in real time, not too fast, until the end or until something else moves the state."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from grasp_refine_apps.viewer.panels.play_bar import FRAME_RATE_HZ, PAUSE, PLAY, PlayBar
from running_processes import soon
from websocket_page import Page, until

TIMES = np.arange(31) / 50.0
LONG = np.arange(30001) / 50.0


class Shown:
    """A bar whose state is the number of a frame, and when each was shown."""

    def __init__(self, server: Any) -> None:
        self.source, self.frame = SimpleNamespace(time=TIMES), 0
        self.seen: list[tuple[float, int]] = []
        self.slider = server.gui.add_slider("Seconds", 0.0, 1.0, 0.02, 0.0)
        self.bar = PlayBar(server.gui, self.slider, lambda: (self.source, self.frame), self.show)
        self.page = Page(server)

    @property
    def button(self) -> Any:
        return self.bar.button

    def show(self, frame: int) -> None:
        self.frame = frame
        self.seen.append((time.monotonic(), frame))

    def ended(self) -> bool:
        return self.button.label == PLAY

    def draw(self, times: np.ndarray, frame: int = 0) -> None:
        self.source, self.frame = SimpleNamespace(time=times), frame
        self.bar.draw(times, frame)


@pytest.fixture
def shown(server: Any) -> Shown:
    return Shown(server)


def test_it_takes_as_long_as_the_motion_took(shown: Shown) -> None:
    # A shorter recording that was drawn before does not end it.
    shown.draw(TIMES[:5])
    shown.source = SimpleNamespace(time=TIMES)
    began = time.monotonic()
    shown.page.change(shown.button, True)
    until(lambda: shown.button.label == PAUSE)
    until(shown.ended)
    assert time.monotonic() - began >= 0.6
    times, frames = zip(*shown.seen, strict=True)
    assert (frames[0], frames[-1]) == (0, 30) and list(frames) == sorted(frames)
    assert len(frames) <= 0.6 * FRAME_RATE_HZ + 3 and np.diff(times).min() > 0.9 / FRAME_RATE_HZ
    # Each frame comes when it happened, or a little later.
    assert (np.array(times) - began - TIMES[list(frames)]).min() > -0.02


def test_it_is_paused_goes_on_there_and_begins_again_from_the_end(shown: Shown) -> None:
    shown.draw(LONG, 20)
    shown.bar.play()
    assert soon(lambda: len(shown.seen) > 1)
    shown.page.change(shown.button, True)
    until(shown.ended)
    held = len(shown.seen)
    assert 20 <= shown.frame < 30000
    time.sleep(0.1)
    assert len(shown.seen) == held
    shown.draw(LONG, 29990)
    shown.bar.play()
    until(shown.ended)
    assert (shown.seen[held][1], shown.frame) == (29990, 30000)
    count = len(shown.seen)
    shown.bar.play()
    assert soon(lambda: len(shown.seen) > count)
    shown.bar.close()
    assert shown.seen[count][1] == 0


def test_the_slider_shows_its_frame_and_ends_the_playing(shown: Shown) -> None:
    shown.draw(LONG)
    assert shown.slider.max == 600.0
    shown.bar.play()
    assert soon(lambda: shown.seen)
    shown.page.change(shown.slider, 300.01)
    until(lambda: shown.frame > 14000 and shown.ended())
    time.sleep(0.1)
    assert shown.frame == 15000
    shown.draw(LONG, 500)
    until(lambda: shown.slider.value == 10.0)


@pytest.mark.parametrize("moved", [{"frame": 12000}, {"source": None}])
def test_whatever_moves_the_state_ends_the_playing(shown: Shown, moved: dict[str, Any]) -> None:
    shown.draw(LONG)
    shown.bar.play()
    assert soon(lambda: shown.seen)
    for name, value in moved.items():
        setattr(shown, name, value)
    until(shown.ended)
    count = len(shown.seen)
    time.sleep(0.1)
    assert len(shown.seen) == count
