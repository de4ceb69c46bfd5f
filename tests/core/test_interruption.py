"""Commands that are interrupted or killed in the midst of something: nothing of them goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_line import PROGRAM, interruptible, subprocess_environment
from grasp_refine.assets.embedded import resource_dir
from running_processes import PATIENCE_S, nothing_left, running_in_session, soon

pytestmark = [
    pytest.mark.usefixtures("workplace"),
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="there is no /proc to find processes in"),
]

Starter = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Starter]:
    """Starts a program as if from a terminal of its own; what is left of it is killed after the test."""
    started: list[subprocess.Popen[str]] = []
    (temporary := tmp_path / "temporary").mkdir()

    def start(program: str, *arguments: str | Path) -> subprocess.Popen[str]:
        # Their processes import `endless_job`, and what a test puts into the folder `instead`.
        paths = [str(tmp_path / "instead"), subprocess_environment()["PYTHONPATH"], str(Path(__file__).parents[1])]
        started.append(
            subprocess.Popen(
                [sys.executable, "-c", program, *map(str, arguments)],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(temporary)},
                start_new_session=True,
                preexec_fn=interruptible,
            )
        )
        return started[-1]

    yield start
    for process in started:
        for number in running_in_session(process):
            os.kill(number, signal.SIGKILL)
        process.communicate()


ENDLESS_COACD = """
import re
from pathlib import Path
set_log_level = Mesh = lambda *arguments: None
def run_coacd(mesh, **options):
    Path("cutting").touch()
    re.match("(a+)+$", "a" * 60 + "b")
"""
"""A CoACD in compiled code that never ends, and lets no other thread of Python run."""


@pytest.fixture
def ring(tmp_path: Path) -> tuple[str | Path, ...]:
    """Options: the example grasps on a ring, which never ends to be cut into pieces."""
    (tmp_path / "instead").mkdir()
    (tmp_path / "instead" / "coacd.py").write_text(ENDLESS_COACD)
    trimesh.creation.torus(0.04, 0.012).export(tmp_path / "ring.obj")
    with np.load(resource_dir("robots") / "allegro" / "example_rounded_box.npz") as example:
        np.savez(tmp_path / "ring.npz", **{**example, "object": np.array(["ring"] * len(example["object"]))})
    return (tmp_path / "ring.npz", "--hand", "allegro", "--objects", tmp_path)


def begun(process: subprocess.Popen[str], *files: str) -> bool:
    """Wait until these files are there, or a command has ended."""
    return soon(lambda: all(Path(file).exists() for file in files) or process.poll() is not None)


def ended(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """What a command said that was sent a signal; its exit code is right, and nothing of it is left running."""
    process.send_signal(number)
    out, error = process.communicate(timeout=PATIENCE_S)
    assert nothing_left(process), running_in_session(process)
    assert out == "" and "Traceback" not in error
    assert process.returncode == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    assert error.endswith("refine-grasp: interrupted\n") == (number != signal.SIGKILL)
    return error


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_in_the_midst_of_a_decomposition(
    tmp_path: Path, start: Starter, ring: tuple[str | Path, ...], number: signal.Signals
):
    """CoACD once went on alone after SIGTERM, and when the command was killed."""
    process = start(PROGRAM, "run", "--grasps", *ring)
    assert begun(process, "cutting")
    ended(process, number)
    assert [path.name for path in Path().iterdir()] == ["cutting"]
    if number != signal.SIGKILL:
        assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_in_the_midst_of_a_batch(start: Starter, ring: tuple[str | Path, ...], number: signal.Signals):
    """What its workers have started ends, too."""
    process = start(PROGRAM, "batch", *ring, "--workers", "1", "--out", "out")
    assert begun(process, "cutting")
    ended(process, number)


ENDLESS_SIMULATION = f"""
from pathlib import Path
from mujoco.batch import Batch
step = Batch.step
def endless(self, ids, nstep):
    Path("simulating").touch()
    step(self, ids, nstep=10**9)
Batch.step = endless
{PROGRAM}
"""
"""The command, whose first step of a simulation takes days, in C++ and without the GIL."""


@pytest.mark.parametrize("number", [signal.SIGHUP])
def test_in_the_midst_of_a_simulation(start: Starter, number: signal.Signals):
    """An interruption once waited for the end of what C++ had been told to simulate."""
    process = start(
        ENDLESS_SIMULATION, "run", "--object", "rounded_box", "--index", "0", "--geometry-only", "--validate"
    )
    assert begun(process, "simulating")
    ended(process, number)
    # Results are written before they are simulated.
    assert {path.name for path in Path().iterdir()} == {"simulating", "grasp-refine-results"}
    assert [path.suffix for path in Path("grasp-refine-results").iterdir()] == [".npz"]


BENCH = """
import sys, time
from pathlib import Path
from grasp_refine_apps.bench.jobs import run_jobs
from endless_job import endless_job

if __name__ == "__main__":
    *_, interrupted = run_jobs([endless_job(Path("0")), endless_job(Path("1"))], 2, lambda share, what: None)
    print("interrupted" if interrupted else "done")
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_in_the_midst_of_the_jobs_of_a_benchmark(start: Starter, number: signal.Signals):
    """Workers once waited for ever for a parent that was killed."""
    process = start(BENCH)
    assert begun(process, "0", "1")
    process.send_signal(number)
    out, error = process.communicate(timeout=PATIENCE_S)
    assert nothing_left(process), running_in_session(process)
    assert "Traceback" not in error
    assert ("interrupted" in out) == (number == signal.SIGINT)


NOHUP = """
import os, signal
from grasp_refine.core.interruption import SIGNALS, interruptible
signal.signal(signal.SIGHUP, signal.SIG_IGN)
for number in SIGNALS:
    try:
        with interruptible(lambda: os._exit(1)) as interrupted:
            os.kill(os.getpid(), number)
    except KeyboardInterrupt:
        pass
    print(number.name, interrupted.is_set())
print(signal.getsignal(signal.SIGINT) is signal.default_int_handler, signal.getsignal(signal.SIGTERM).name)
"""


def test_what_is_ignored_stays_ignored(start: Starter):
    """Under nohup a command goes on when its terminal is closed."""
    out, error = start(NOHUP).communicate(timeout=PATIENCE_S)
    assert error == ""
    assert out.splitlines() == ["SIGINT True", "SIGTERM True", "SIGHUP False", "True SIG_DFL"]


IMPORTING = """
import os, time
from grasp_refine.core.interruption import interruptible

def end():
    print("interrupted", flush=True)
    os._exit(0)

with interruptible(end):
    try:
        import interrupted_import
        print(interrupted_import.swallowed, flush=True)
        time.sleep(60.0)
        print("lost", flush=True)
    except KeyboardInterrupt:
        end()
"""


def test_what_is_imported_does_not_swallow_it(tmp_path: Path, start: Starter):
    """Ctrl-C just after "refining ..." was lost where a package that was being loaded caught everything."""
    (tmp_path / "workplace" / "interrupted_import.py").write_text(
        "import os, signal\nswallowed = False\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n    sum(range(1000))\n"
        "except BaseException:\n    swallowed = True\n"
    )
    out, error = start(IMPORTING).communicate(timeout=PATIENCE_S)
    assert error == "" and "True" not in out
    assert out.endswith("interrupted\n")
