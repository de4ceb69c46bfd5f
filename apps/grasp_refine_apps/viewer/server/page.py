"""Server of the page, and the thread that draws."""

from __future__ import annotations

import errno
import logging
import socket
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import rich
import viser

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.server.access import Access
from grasp_refine_apps.viewer.server.viser_private import forbid_sharing, guarded

if TYPE_CHECKING:
    # The page is served before what the state needs is loaded.
    from grasp_refine_apps.viewer.model.state import State

DRAW_PERIOD_S, SLOW_PERIOD_S = 1.0 / 30.0, 0.2
"""Minimum seconds between two drawings, and between two of plots and numbers."""

TITLE = "grasp-refine"

PANEL_WIDTH_PX = 384
"""Width of the panel in pixels, so that its tabs fit on one line: what viser calls large."""

Draw = Callable[["State"], None]
"""Function that shows a state on a part of the page."""


class Drawer:
    """Thread that draws: always the newest state, never two at once."""

    def __init__(self, draws: Sequence[Draw], first: State, period: float = DRAW_PERIOD_S) -> None:
        """Draw the first state, then newer ones; at most one in `period` seconds."""
        self._draws, self._state, self._period = tuple(draws), first, period
        self._wanted, self._closed = threading.Event(), threading.Event()
        self._asked, self._drawn, self._change = 1, 0, threading.Condition()
        self._wanted.set()
        self._thread = threading.Thread(target=self._run, name="viewer drawing", daemon=True)
        self._thread.start()

    def draw(self, state: State) -> None:
        """Draw this state, unless a newer one comes first."""
        with self._change:
            self._state = state
            self._asked += 1
        self._wanted.set()

    def settle(self, seconds: float) -> None:
        """Wait until the newest state is drawn, for so many seconds at most."""
        with self._change:
            asked = self._asked
            self._change.wait_for(lambda: self._drawn >= asked, seconds)

    def close(self) -> None:
        """Stop the thread after the present drawing."""
        self._closed.set()
        self._wanted.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while self._wanted.wait() and not self._closed.is_set():
            self._wanted.clear()
            began = time.monotonic()
            with self._change:
                asked, state = self._asked, self._state
            for draw in self._draws:
                try:
                    draw(state)
                except Exception:  # noqa: BLE001 - one part that cannot be drawn must not take the others with it
                    traceback.print_exc()
            with self._change:
                self._drawn = asked
                self._change.notify_all()
            self._closed.wait(max(0.0, self._period - (time.monotonic() - began)))


@dataclass(frozen=True)
class Page:
    """The server of the page, with the rules for requests to it."""

    server: viser.ViserServer
    """The server."""
    access: Access
    """Rules for requests."""

    @property
    def address(self) -> str:
        """Address to open in a browser, with its token."""
        return self.access.address(self.server.get_port())

    @property
    def frame_address(self) -> str:
        """Address for a frame in another page."""
        return self.access.frame_address(self.server.get_port())


def open_server(host: str, port: int, again: str = "") -> Page:
    """Start the server; port 0 is any that is free. Its page names the command `again` when the program has ended.

    Without the token of the address, nothing is answered.

    Raises:
        GraspRefineError: it cannot listen there.
    """
    # viser would silently take the next port or, for an invalid host, wait for ever.
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            advice = "give another --port, or --port 0 for any that is free"
            if isinstance(error, OverflowError):
                reason, advice = "no such port", "give a --port from 0 to 65535"
            elif isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                advice = "give a --host of this machine, such as 127.0.0.1, or 0.0.0.0 for all"
            raise GraspRefineError(f"cannot listen on {host}:{port} ({reason}): {advice}") from None
    # A client that connects without a request would cause a traceback on the terminal.
    logging.getLogger("websockets").addHandler(logging.NullHandler())
    access = Access.to(host)
    with without_greeting(), guarded(access, again):
        server = viser.ViserServer(host=host, port=port, label=TITLE, verbose=False)
    if port and server.get_port() != port:
        close_server(server)
        raise GraspRefineError(f"port {port} was taken meanwhile: give another --port, or 0 for any that is free")
    forbid_sharing(server)
    set_theme(server.gui)
    # Beside the scene, not in front of it.
    server.gui.main_panel.dock_right()
    # A page may dock the panel before it knows the width of its theme.
    server.gui.main_panel.set_width(PANEL_WIDTH_PX)
    server.scene.set_up_direction("+z")
    return Page(server, access)


def set_theme(gui: viser.GuiApi, *, dark: bool = False) -> None:
    """Set the look of all pages, or of one."""
    gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", dark_mode=dark)


def close_server(server: viser.ViserServer) -> None:
    """Stop listening."""
    with without_greeting():
        server.stop()


@contextmanager
def without_greeting() -> Iterator[None]:
    """Suppress the messages that viser prints at start and stop."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet
