"""Complete viewer: server, controller, view and panels."""

from __future__ import annotations

from threading import Timer
from types import TracebackType

import viser

from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.page import SLOW_PERIOD_S, Drawer, address, close_server
from grasp_refine_apps.viewer.panels.page_panel import PagePanel
from grasp_refine_apps.viewer.view import View

BACKGROUND_DELAY_S = 4.0
"""Seconds until background work starts: browsers load the page first, with the same processor."""


class Viewer:
    """Server that shows the state of a controller; a context manager that closes both."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Put scene and panels on the page, the scene first."""
        self.server, self.controller = server, controller
        self.view = View(server, controller)
        self.view.draw(controller.state)
        # No browser should show buttons that cannot be used yet.
        with server.atomic():
            self.panel = PagePanel(server, controller, self.view)
            for draw in (*self.panel.draws, *self.panel.slow_draws):
                draw(controller.state)
        self._drawers = (
            Drawer([self.view.draw, *self.panel.draws], controller.state),
            Drawer(self.panel.slow_draws, controller.state, SLOW_PERIOD_S),
        )
        for drawer in self._drawers:
            controller.listen(drawer.draw)
        server.on_client_connect(lambda client: self._drawers[0].draw(controller.state))
        self._measuring = Timer(BACKGROUND_DELAY_S, self._prepare)
        self._measuring.daemon = True
        self._measuring.start()

    def _prepare(self) -> None:
        """Load what the first refinement needs, and measure grasps whose files have no measures."""
        import grasp_refine.hands.kinematics  # noqa: F401 - loads PyTorch

        self.controller.measure()

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return address(self.server)

    def __enter__(self) -> Viewer:
        """Return the viewer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the running job, and the server."""
        self.close()

    def close(self) -> None:
        """Stop the running job, and the server."""
        self._measuring.cancel()
        self.panel.close()
        self.controller.close()
        for drawer in self._drawers:
            drawer.close()
        close_server(self.server)
