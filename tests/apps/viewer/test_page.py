"""The server: where it listens, whom it lets in, and the thread that draws."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.page import Drawer, address, close_server, open_server
from grasp_refine_apps.viewer.state import State
from open_viewer import controller
from refusals import refused
from running_processes import PATIENCE_S


@contextmanager
def served(host: str = "127.0.0.1") -> Iterator[viser.ViserServer]:
    server = open_server(host, 0)
    try:
        yield server
    finally:
        close_server(server)


def test_a_port_of_zero_is_any_that_is_free_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with served() as one, served() as other:
        assert one.get_port() != other.get_port()
        assert address(one) == f"http://127.0.0.1:{one.get_port()}"
    assert capfd.readouterr().out == ""


def test_a_port_that_is_taken_is_said_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with refused(GraspRefineError, f"127.0.0.1:{port}", "--port"):
            open_server("127.0.0.1", port)


@pytest.mark.parametrize(("host", "port"), [("203.0.113.7", 0), ("no such host", 0), ("127.0.0.1", 99999)])
def test_a_place_where_nothing_can_listen_is_refused_at_once(host: str, port: int) -> None:
    with refused(GraspRefineError, f"{host}:{port}"):
        open_server(host, port)


def test_only_pages_of_this_machine_are_let_in() -> None:
    with served() as server:
        port = server.get_port()
        for origin in (f"http://127.0.0.1:{port}", "http://localhost:8123", "http://[::1]:80", None):
            with connect(f"ws://127.0.0.1:{port}", origin=origin, subprotocols=[f"viser-v{viser.__version__}"]):
                pass
        for origin in ("http://evil.example", "http://127.0.0.1.evil.example", "null"):
            with pytest.raises(InvalidStatus):
                connect(f"ws://127.0.0.1:{port}", origin=origin, subprotocols=[f"viser-v{viser.__version__}"])


def test_nobody_can_have_a_tunnel_opened() -> None:
    with served() as server:
        handlers = server._websock_server._incoming_handlers
        assert viser._messages.ShareUrlRequest not in handlers or not handlers[viser._messages.ShareUrlRequest]


def test_the_newest_state_is_drawn_and_a_part_that_breaks_does_not_harm_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    drawn: list[int] = []
    release, last = threading.Event(), threading.Event()

    def slow(state: State) -> None:
        release.wait(PATIENCE_S)
        drawn.append(state.change)
        if state.change == 9:
            last.set()

    def broken(state: State) -> None:
        raise ValueError("broken")

    made = controller()
    states = [replace(made.state, change=change) for change in range(10)]
    made.close()
    drawer = Drawer([broken, slow], states[0])
    for state in states[1:]:
        drawer.draw(state)
    release.set()
    assert last.wait(PATIENCE_S)
    drawer.close()
    # The first may have begun before the others came.
    assert drawn in ([9], [0, 9])
    assert "ValueError: broken" in capsys.readouterr().err


def test_a_slow_drawer_draws_once_in_its_period_and_ends_at_once() -> None:
    drawn, first = [], threading.Event()

    def draw(state: State) -> None:
        drawn.append(state.change)
        first.set()

    made = controller()
    made.close()
    drawer = Drawer([draw], made.state, period=600.0)
    assert first.wait(PATIENCE_S)
    drawer.draw(replace(made.state, change=made.state.change + 1))
    drawer.close()
    assert drawn == [made.state.change]
