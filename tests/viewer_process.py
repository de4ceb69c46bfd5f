"""`refine-grasp view` in a process of its own, as a user starts it."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

from command_line import PROGRAM, interruptible, subprocess_environment
from running_processes import PATIENCE_S


@dataclass(frozen=True)
class Viewer:
    """`refine-grasp view` in a process of its own."""

    address: str
    """What a browser opens."""
    port: int
    process: subprocess.Popen[bytes]
    log: Path
    """What it printed, both streams."""
    started: float
    """When it was started, by time.monotonic."""

    def output(self) -> str:
        """Everything that it printed so far."""
        return self.log.read_text(encoding="utf-8")


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(port: int) -> bool:
    """Whether a page can be had on a port of this machine."""
    try:
        with urlopen(f"http://127.0.0.1:{port}", timeout=5.0) as response:
            return response.status == 200
    except OSError:
        return False


def start_viewer_process(folder: Path, *arguments: str | Path, seconds: float = PATIENCE_S) -> Viewer:
    """Start it in `folder` and return once it answers; the caller ends it."""
    port, log, started = free_port(), folder / "log.txt", time.monotonic()
    command = [sys.executable, "-c", PROGRAM, "view", *map(str, arguments), "--port", str(port), "--no-open"]
    with log.open("wb") as stream:
        process = subprocess.Popen(
            command,
            stdout=stream,
            stderr=subprocess.STDOUT,
            env=subprocess_environment(),
            cwd=folder,
            preexec_fn=interruptible,
        )
    viewer = Viewer(f"http://127.0.0.1:{port}", port, process, log, started)
    while not answers(port):
        assert process.poll() is None, f"it ended: {viewer.output()}"
        if time.monotonic() > started + seconds:
            process.kill()
            raise AssertionError(f"it does not answer: {viewer.output()}")
        time.sleep(0.05)
    return viewer
