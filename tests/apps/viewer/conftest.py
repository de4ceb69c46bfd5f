"""Headless Chromium, pages in it, and viewers in processes of their own."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browser import ViserPage, chromium, headless
from command_line import PROGRAM, subprocess_environment

if TYPE_CHECKING:
    from playwright.sync_api import Browser


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
    """Whether somebody listens on a port of this machine."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One headless Chromium for all tests."""
    pytest.importorskip("viser", reason="the viewer comes with the extra 'viewer'")
    pytest.importorskip("playwright", reason="playwright comes with the extra 'test'")
    if chromium() is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    with headless() as opened:
        yield opened


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., ViserPage]]:
    """Opens addresses, each in a page of its own; no page may have complained when the test ends."""
    pages: list[ViserPage] = []

    def open_one(address: str, size: tuple[int, int] = (1400, 900)) -> ViserPage:
        page = ViserPage(browser, size)
        pages.append(page)
        page.open(address)
        return page

    yield open_one
    complaints = [page.errors for page in pages]
    for page in pages:
        page.close()
    assert not any(complaints), f"errors in the console: {complaints}"


@pytest.fixture(scope="module")
def start_viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Viewer]]:
    """Starts `refine-grasp view` with arguments and returns once it answers; ended with the module's last test."""
    viewers: list[Viewer] = []

    def start(*arguments: str | Path, seconds: float = 60.0) -> Viewer:
        port, log, started = free_port(), tmp_path_factory.mktemp("view") / "log.txt", time.monotonic()
        command = [sys.executable, "-c", PROGRAM, "view", *map(str, arguments), "--port", str(port)]
        with log.open("wb") as stream:
            process = subprocess.Popen(
                command, stdout=stream, stderr=subprocess.STDOUT, env=subprocess_environment(), cwd=log.parent
            )
        viewer = Viewer(f"http://127.0.0.1:{port}", port, process, log, started)
        viewers.append(viewer)
        while not answers(port):
            assert process.poll() is None, f"it ended: {viewer.output()}"
            assert time.monotonic() < started + seconds, f"it does not answer: {viewer.output()}"
            time.sleep(0.05)
        return viewer

    yield start
    for viewer in viewers:
        viewer.process.terminate()
    for viewer in viewers:
        try:
            viewer.process.wait(10.0)
        except subprocess.TimeoutExpired:
            viewer.process.kill()
            viewer.process.wait()
