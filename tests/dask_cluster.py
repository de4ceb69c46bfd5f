"""A Dask cluster on this machine, of real processes that tests may kill."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from distributed import Client

from command_line import subprocess_environment
from running_processes import PATIENCE_S


class DaskCluster:
    """A scheduler, and the workers that tests add."""

    def __init__(self, folder: Path) -> None:
        """Start the scheduler; the caller ends it."""
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", str(port))
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                return
            except OSError:
                assert time.monotonic() < until and self.scheduler.poll() is None, self.log("scheduler")
                time.sleep(0.1)

    def add_workers(self, *options: str, path: Path | None = None) -> subprocess.Popen[bytes]:
        """Start workers with these options, who find modules in `path` first."""
        folder = self._folder / "scratch"
        return self.start("worker", self.address, "--local-directory", str(folder), *options, path=path)

    def wait_for_workers(self, count: int) -> None:
        """Wait for so many workers."""
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=PATIENCE_S)

    def start(self, *command: str, path: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a part of the cluster, as a group of processes of its own."""
        environment = subprocess_environment()
        paths = [str(path) if path else "", str(Path(__file__).parent), environment["PYTHONPATH"]]
        with (self._folder / f"{command[0]}.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *command, "--no-dashboard"],
                env=environment | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
                stdout=log,
                stderr=log,
                cwd=self._folder,
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def log(self, part: str) -> str:
        """What the scheduler or the workers printed."""
        return (self._folder / f"{part}.log").read_text(encoding="utf-8", errors="replace")

    def end(self) -> None:
        """End everything, without ado."""
        for process in self._processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
