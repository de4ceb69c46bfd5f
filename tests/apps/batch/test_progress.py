"""Progress of a batch: plain lines in a file, a bar and what each worker does in a terminal, and numbers that fit."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from batch_rows import shard
from grasp_refine_apps.batch.progress import PRINT_INTERVAL_S, Progress
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.processes.task import Failed


class Clock:
    """Time that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def done(number: int, grasps: int, good: int, held: tuple[int, int] | None = None) -> tuple[Shard, Done]:
    return shard(number, Path(), grasps), Done(grasps, grasps, (0, good), held, 1.0, 1.0, 0)


def shards(count: int, size: int = 10) -> list:
    return [shard(number, Path(f"{number}.npz"), size) for number in range(count)]


@pytest.fixture
def clock() -> Clock:
    return Clock()


def plain() -> Console:
    return Console(file=io.StringIO(), width=80, highlight=False)


def said(console: Console) -> list[str]:
    return console.file.getvalue().splitlines()


def picture(progress: Progress, width: int = 80) -> list[str]:
    """What a terminal would show now."""
    console = Console(file=io.StringIO(), width=width, highlight=False, force_terminal=True, color_system=None)
    console.print(progress)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


# In a file


def test_a_file_gets_a_line_now_and_then_and_at_each_failure(clock: Clock):
    console = plain()
    with Progress(console, shards(4), 2, skipped=20, clock=clock) as progress:
        assert said(console) == ["refining 40 grasps in 4 shards with 2 workers, 20 were done before"]
        for _ in range(50):
            clock.now += 0.2
            progress.heartbeat(0, "refining", 0.4)
        assert len(said(console)) == 1, "10 s are no news"
        progress.failed(shard(1, Path(), 10), Failed("crashed", "ended with SIGSEGV", "", 2))
        assert said(console)[1:] == ["job, part 1 failed (crashed, tried 2 times): ended with SIGSEGV"]
        clock.now += PRINT_INTERVAL_S
        progress.done(*done(0, 10, 9))
        # 10 grasps in 40 s, and 20 more to come.
        assert said(console)[2:] == [
            "30/60 grasps refined, 15.0 grasps/min, 1 min 20 s left, 90.0 % good, 1 shard failed"
        ]
        progress.done(*done(2, 10, 9))
        assert len(said(console)) == 3


# In a terminal


def test_a_terminal_sees_the_whole_and_what_each_worker_does(clock: Clock):
    progress = Progress(plain(), shards(4), 2, skipped=10, clock=clock)
    assert picture(progress)[1:] == ["10/50 grasps refined", "⠋ starting the workers"]
    progress.heartbeat(0, "decomposing [mug]", 0.0)
    progress.heartbeat(1, "refining", 0.5)
    clock.now += 10.0
    assert picture(progress)[1] == "10/50 grasps refined", "no speed and no time left before a grasp is refined"
    progress.heartbeat(1, "refining", 0.5, 3)
    bar, facts, *workers = picture(progress)
    # 10 grasps were done before, and half a shard of 10 is: 15 of 50, at 5 in 10 s.
    assert bar == "━" * 24
    assert facts == "13/50 grasps refined · 30.0 grasps/min · 1 min 10 s left"
    assert workers == ["  0 % job, part 0: decomposing [mug]", " 50 % job, part 1: refining"]
    progress.done(*done(1, 10, 10))
    assert picture(progress)[1:] == [
        "20/50 grasps refined · 1.00 grasps/s · 30 s left · 100 % good",
        "  0 % job, part 0: decomposing [mug]",
    ]
    progress.heartbeat(1, "late", 0.9)
    assert len(picture(progress)) == 3, "a sign of life that comes late is none"
    progress.wait("writing the index")
    assert picture(progress)[-1] == "⠋ writing the index"


def test_no_line_is_wider_than_the_terminal_and_many_workers_are_counted(clock: Clock):
    progress = Progress(plain(), shards(30), 20, clock=clock)
    for number in range(20):
        progress.heartbeat(number, "refining " * 20, 0.3)
    for number in range(20, 25):
        progress.done(*done(number, 10, 3))
    clock.now += 1e5
    shown = picture(progress, 60)
    assert len(shown) == 2 + 8 + 1 and max(map(len, shown)) <= 60
    assert shown[-1].strip() == "and 12 more" and shown[2].endswith("…")


# Speed


def test_the_speed_is_that_of_the_last_minutes(clock: Clock):
    progress = Progress(plain(), shards(1000), 1, clock=clock)
    assert progress.speed == 0.0 and progress.remaining_s is None
    for number in range(100):
        clock.now += 10.0
        progress.done(*done(number, 10, 1))
    assert progress.speed == pytest.approx(1.0)
    for number in range(100, 150):
        clock.now += 100.0
        progress.done(*done(number, 10, 1))
    assert progress.speed == pytest.approx(0.1, rel=0.01)
    assert progress.remaining_s == pytest.approx(8500 / 0.1, rel=0.01)
