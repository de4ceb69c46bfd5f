"""Real worker processes that fail in all ways: the rest comes out, failures say why, and nothing stays behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from command_line import interruptible, subprocess_environment
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.processes import local
from grasp_refine_apps.processes.dispatch import dispatch
from grasp_refine_apps.processes.local import ONE_THREAD, LocalPool
from refusals import assert_names, refused
from running_processes import PATIENCE_S, alive, children, soon
from worker_tasks import FakeTask, Slow, Unknown, some_tasks, work


def results(
    tasks: list[FakeTask], workers: int = 1, *, patience_s: float = PATIENCE_S, work: Callable = work, tries: int = 2
) -> Generator[tuple[FakeTask, Any], None, None]:
    with closing(LocalPool(work, workers, patience_s)) as pool:
        yield from dispatch(tasks, pool, tries=tries, patience_s=patience_s, heartbeat=lambda *_: None)


def outcomes(folder: Path, *verbs: Any, workers: int = 1, **limits: Any) -> dict[int, Any]:
    """Number -> result or failure."""
    found = {task.number: end for task, end in results(some_tasks(folder, *verbs), workers, **limits)}
    assert multiprocessing.active_children() == []
    return found


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a program that has two workers work on tasks, as if from a terminal of its own; ended after the test."""
    started: list[subprocess.Popen[str]] = []
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)

    def start(*tasks: str) -> subprocess.Popen[str]:
        paths = [str(Path(__file__).parents[2]), subprocess_environment()["PYTHONPATH"]]
        started.append(
            subprocess.Popen(
                [sys.executable, path, tmp_path, *tasks],
                env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
                preexec_fn=interruptible,
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


PROGRAM = """
import sys
from contextlib import closing
from pathlib import Path
from grasp_refine_apps.processes.dispatch import dispatch
from grasp_refine_apps.processes.local import LocalPool
from worker_tasks import some_tasks, work

if __name__ == "__main__":
    try:
        print("begun", flush=True)
        tasks = some_tasks(Path(sys.argv[1]), *sys.argv[2:])
        with closing(LocalPool(work, 2)) as pool:
            for task, _ in dispatch(tasks, pool, tries=2, patience_s=None, heartbeat=lambda *_: None):
                print(task.number, flush=True)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
"""


@pytest.fixture(scope="module")
def patience_s(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Little patience, but many times what a worker takes to start, as busy as this machine is: 1 s on a quiet one."""
    began = time.monotonic()
    assert len(outcomes(tmp_path_factory.mktemp("start"), "write")) == 1
    return max(1.0, round(10.0 * (time.monotonic() - began)))


def test_there_are_no_more_workers_than_tasks(tmp_path: Path):
    given = results(some_tasks(tmp_path, "write"), 8)
    assert next(given)[1] == "0.txt"
    assert len(multiprocessing.active_children()) == 1
    assert list(given) == []
    assert multiprocessing.active_children() == []


def test_a_task_that_always_crashes_fails_and_says_where(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    found = outcomes(tmp_path, "a:crash SIGSEGV", "b:crash exit", "c:crash SIGKILL", "d:write", "e:print", workers=2)
    assert capfd.readouterr() == ("", ""), "workers are quiet"
    segfault, left, killed, well, _ = (found[number] for number in range(5))
    assert [(each.reason, each.tries) for each in (segfault, left, killed)] == [("crashed", 2)] * 3
    # The signal twice: what ended the worker, and what the shard was doing.
    assert_names(segfault.message, "25%", "crash SIGSEGV")
    assert segfault.message.count("SIGSEGV") == 2
    assert segfault.traceback.startswith("about to crash\nFatal Python error: Segmentation fault")
    assert "in _crash" in segfault.traceback
    assert_names(left.message, "code 3", "25%", "crash exit")
    assert left.traceback == "about to crash"
    assert_names(killed.message, "25%", "crash SIGKILL", "memory")
    assert killed.message.count("SIGKILL") == 2
    assert well == "3.txt"


def test_a_task_that_no_worker_can_load_fails_at_once(tmp_path: Path):
    """Its worker once waited for ever."""
    (failure,) = outcomes(tmp_path, Unknown()).values()
    assert_names(failure.message, "code 1")
    assert failure.traceback.endswith("ModuleNotFoundError: No module named 'no_such_module'")


def test_a_worker_that_hangs_is_replaced_and_says_where(tmp_path: Path, patience_s: float):
    """Asleep, or stopped so that it can say nothing; one that gives signs of life may take as long as it likes."""
    tasks = ("a:sleep 3600", "b:crash SIGSTOP", f"c:beat {1.5 * patience_s}", "d:write")
    found = outcomes(tmp_path, *tasks, workers=3, patience_s=patience_s, tries=1)
    asleep, stopped = found[0], found[1]
    assert [(each.reason, each.tries) for each in (asleep, stopped)] == [("hung", 1)] * 2
    assert_names(asleep.message, f"{patience_s:g} s", "25%", "sleep 3600")
    assert "in _sleep" in asleep.traceback
    assert stopped.traceback == "about to crash"
    assert (found[2], found[3]) == ("2.txt", "3.txt")


def test_a_caller_who_stops_early_leaves_nothing_behind(tmp_path: Path):
    half, child = tmp_path / "half", tmp_path / "child"
    given = results(some_tasks(tmp_path, f"a:tidy {half}", f"b:child {child}", "c:write"), 3)
    next(given)
    assert soon(lambda: half.exists() and child.exists() and child.read_text() != "")
    given.close()
    assert multiprocessing.active_children() == []
    assert not half.exists(), "work is given time to clean up"
    assert soon(lambda: not alive(int(child.read_text())))


def test_workers_have_one_thread_and_the_environment_of_the_caller_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before = dict(os.environ)
    outcomes(tmp_path, f"threads {tmp_path}/threads")
    assert (tmp_path / "threads").read_text() == " ".join(f"{name}=1" for name in ONE_THREAD)
    assert dict(os.environ) == before


def test_workers_that_cannot_start_end_the_batch_with_a_reason(tmp_path: Path):
    reason = "ModuleNotFoundError: No module named 'no_such_module'"
    with refused(GraspRefineError, "3 worker", "code 1", reason, "refine-grasp doctor"):
        list(results(some_tasks(tmp_path, "write"), work=Unknown()))
    assert multiprocessing.active_children() == []


def test_workers_end_with_a_caller_who_is_killed(tmp_path: Path, program: Callable[..., subprocess.Popen[str]]):
    """Also one that is deep in compiled code."""
    deep, asleep = tmp_path / "deep", tmp_path / "asleep"
    process = program(f"a:compute {deep}", f"b:tidy {asleep}")
    assert soon(lambda: deep.exists() and deep.read_text() != "" and asleep.exists())
    workers = list(map(int, children(process.pid)))
    assert int(deep.read_text()) in workers
    process.kill()
    assert soon(lambda: not any(map(alive, workers)))


def test_workers_that_take_too_long_to_start_end_the_batch_with_a_reason(tmp_path: Path):
    with refused(GraspRefineError, "3 worker", "1 s"):
        list(results(some_tasks(tmp_path, "write"), work=Slow(), patience_s=1.0))


def test_an_interrupt_in_a_terminal_ends_everything_without_a_word(
    tmp_path: Path, program: Callable[..., subprocess.Popen[str]]
):
    half = tmp_path / "half"
    process = program(f"a:tidy {half}", "b:sleep 3600")
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    # One child is not a worker: it looks after what processes share, and ends with this one, too.
    assert soon(half.exists)
    workers = children(process.pid)
    assert len(workers) >= 2
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=PATIENCE_S) == ("interrupted\n", "")
    assert soon(lambda: not any(alive(int(worker)) for worker in workers))
    assert not half.exists()


class Startup:
    """A process that starts or fails, as it was told."""

    started = 0

    def __init__(self, work: bytes) -> None:
        self.pid = type(self).started = type(self).started + 1
        self.ready, self.age_s, self.connection = False, 0.0, None
        read, write = os.pipe()
        os.write(write, b"x")
        os.close(write)
        self.sources = (read,)

    def receive(self) -> tuple[list[Any], bool]:
        self.ready = self.pid == 1
        return [], not self.ready

    def kill(self) -> tuple[int, str]:
        os.close(self.sources[0])
        return 1, "no memory"

    def terminate(self) -> None: ...


def test_workers_that_cannot_be_started_are_not_started_for_ever(monkeypatch: pytest.MonkeyPatch):
    """While one worked, all others were started again and again: 134 times in 12 seconds."""
    monkeypatch.setattr(local, "_Process", Startup)
    pool = LocalPool(work, 3)
    for _ in range(40):
        pool.workers(3)
        pool.listen()
    assert pool.workers(3) == ["1"]
    assert Startup.started <= 1 + local.MAX_FAILED_STARTS + 2
    pool._processes.clear()
