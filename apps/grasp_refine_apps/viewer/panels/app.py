"""The viewer: a session for each page that is open, on a server."""

from __future__ import annotations

import html
from collections.abc import Callable
from threading import RLock, Timer
from types import TracebackType

import viser

from grasp_refine_apps.viewer.drawing.shapes import visual_shapes
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.panels.session import Session
from grasp_refine_apps.viewer.server.page import Page, close_server

BACKGROUND_DELAY_S = 4.0
"""Seconds until background work starts: browsers load the page first, with the same processor."""

NOTEBOOK_HEIGHT_PX = 640
"""Height of the page in a notebook, pixels."""


class Viewer:
    """Server whose pages choose their grasps and share their work; a context manager that closes all."""

    def __init__(self, page: Page, controller: Controller, drawn: Callable[[], None] = lambda: None) -> None:
        """Serve pages; the first one shows the state of `controller`. `drawn` is called when a page is drawn."""
        self.page, self.server, self.controller = page, page.server, controller
        self.controllers = [controller]
        """Controllers of all pages, also of pages that were closed: their jobs go on."""
        self.sessions: dict[int, Session] = {}
        """Sessions by the numbers of their pages."""
        self._free, self._changing, self._closed = [controller], RLock(), False
        self._drawn = drawn
        # Read while the browser loads the page: every session needs them.
        visual_shapes(controller.state.scene.hand)
        controller.contacts(controller.state)
        self.server.on_client_connect(self._join)
        self.server.on_client_disconnect(self._leave)
        self._measuring = Timer(BACKGROUND_DELAY_S, controller.background.measure)
        self._measuring.daemon = True
        self._measuring.start()

    def _join(self, page: viser.ClientHandle) -> None:
        """Give a page the controller of the last closed page, so that pages can be loaded again, or a new one."""
        with self._changing:
            if self._closed or page.client_id not in self.server.get_clients():
                return
            if not self._free:
                self._free.append(self.controllers[-1].for_another_page())
                self.controllers += self._free
            session = self.sessions[page.client_id] = Session(page, self._free.pop())
            self._drawn()
        session.complete()

    def _leave(self, page: viser.ClientHandle) -> None:
        """Keep the controller of a closed page; nobody pulls any more, other jobs go on."""
        with self._changing:
            session = self.sessions.pop(page.client_id, None)
            if session is not None:
                session.close()
                job = session.controller.state.job
                if job is not None and job.kind == "pull":
                    session.controller.stop()
                self._free.append(session.controller)

    @property
    def num_unsaved(self) -> int:
        """Largest number of unsaved grasps in any page."""
        return max(controller.state.num_unsaved for controller in self.controllers)

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return self.page.address

    def _repr_html_(self) -> str:
        """Return the page in a frame, for a notebook."""
        return (
            f'<iframe src="{html.escape(self.page.frame_address)}" width="100%" height="{NOTEBOOK_HEIGHT_PX}"></iframe>'
        )

    def __enter__(self) -> Viewer:
        """Return the viewer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the running jobs, and the server."""
        self.close()

    def close(self) -> None:
        """Stop the running jobs, and the server."""
        self._measuring.cancel()
        with self._changing:
            self._closed = True
            for session in self.sessions.values():
                session.close()
            self.sessions.clear()
        for controller in self.controllers:
            controller.close()
        close_server(self.server)
