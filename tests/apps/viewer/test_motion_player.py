"""Motions are played in real time, not too fast, and end by themselves."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from grasp_refine_apps.viewer.motion_player import FRAME_RATE_HZ, MotionPlayer
from grasp_refine_apps.viewer.shown_motion import ShownMotion
from running_processes import PATIENCE_S, soon


def still(seconds: float, rate: float = 50.0) -> ShownMotion:
    """A motion in which nothing moves."""
    time = np.arange(round(seconds * rate) + 1) / rate
    count = len(time)
    poses, zeros = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count)
    return ShownMotion(
        hand="hand",
        object="object",
        direction="+x",
        setting="force-closure",
        reason="held",
        time=time + 3.0,
        stage=np.zeros(count, dtype=int),
        since_stage=time,
        T_root=poses,
        q=np.zeros((count, 2)),
        T_object=poses,
        displacement_m=zeros,
        angle_rad=zeros,
        force=np.zeros(3),
        contacts=(),
    )


class Screen:
    """Remembers what it was shown, and when."""

    def __init__(self) -> None:
        self.frames: list[tuple[float, int]] = []
        self.ended = threading.Event()
        self.player = MotionPlayer(lambda frame: self.frames.append((time.monotonic(), frame)), self.ended.set)


@pytest.fixture
def screen() -> Screen:
    return Screen()


def test_it_takes_as_long_as_the_motion_took(screen: Screen) -> None:
    began = time.monotonic()
    screen.player.play(still(0.6))
    assert screen.player.playing and screen.ended.wait(PATIENCE_S)
    assert time.monotonic() - began >= 0.6
    times, frames = zip(*screen.frames, strict=True)
    assert (frames[0], frames[-1]) == (0, 30) and list(frames) == sorted(frames)
    assert len(frames) <= 0.6 * FRAME_RATE_HZ + 3 and np.diff(times).min() > 0.9 / FRAME_RATE_HZ
    # Each frame comes when it happened, or a little later.
    late = np.array(times) - began - np.array(frames) / 50.0
    assert late.min() > -0.02
    assert not screen.player.playing


def test_it_goes_on_where_it_was_held(screen: Screen) -> None:
    motion = still(600.0)
    screen.player.play(motion, 20)
    assert soon(lambda: len(screen.frames) > 1)
    screen.player.pause()
    held = len(screen.frames)
    assert not screen.player.playing and 20 <= screen.frames[-1][1] < 30000
    time.sleep(0.1)
    assert len(screen.frames) == held and not screen.ended.is_set()
    screen.player.play(motion, 29990)
    assert screen.ended.wait(PATIENCE_S) and screen.frames[held][1] == 29990 and screen.frames[-1][1] == 30000
    # From the end it begins again.
    count = len(screen.frames)
    screen.player.play(motion, 30000)
    assert soon(lambda: len(screen.frames) > count)
    screen.player.pause()
    assert screen.frames[count][1] == 0


def test_another_motion_takes_its_place(screen: Screen) -> None:
    screen.player.play(still(600.0))
    assert soon(lambda: screen.frames)
    screen.player.play(still(0.1))
    assert screen.ended.wait(PATIENCE_S) and screen.frames[-1][1] == 5
    count = len(screen.frames)
    time.sleep(0.1)
    assert len(screen.frames) == count
