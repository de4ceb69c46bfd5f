"""`refine-grasp view`: view, refine, edit, validate and export grasps in a browser."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
import warnings
import webbrowser
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.report.command_line import in_options, invocation
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

if TYPE_CHECKING:
    import viser

    from grasp_refine.problem.problem import Problem
    from grasp_refine.problem.refined import RefinedGrasps
    from grasp_refine_apps.viewer.panels.app import Viewer


PAGE_PATIENCE_S, PAGE_DRAWING_S = 10.0, 1.0
"""Longest wait until an opened page is there to show an error, and time in which it shows it, seconds."""

SIGNAL_POLL_S = 0.2
"""Longest delay until a signal is noticed, seconds."""

CLEANUP_LIMIT_S = 5.0
"""Time limit for cleaning up at the end, seconds."""

M_ARENA_MAX = -8
"""Parameter of glibc's mallopt: largest number of arenas."""


@dataclass(frozen=True)
class Serving:
    """Address of the page."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("page"),)

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0: all of this machine. By default only this machine can open the page. Whoever has
    the printed address with its token can do everything that the page can."""
    port: int = 8080
    """Port to listen on; 0: any that is free."""
    open: bool = True
    """Open the page in a browser, if there is a screen."""
    json: OptionalFile = None
    """Write the address to this file once the page is served."""
    overwrite: Overwrite = False


@dataclass(frozen=True)
class View:
    """Show grasps in a browser: watch their refinement, edit, validate, compare and export them.

    Opens grasp files of any format, and the files of `run` and `validate`. Without files, the example grasps of the
    embedded hand on the embedded mug. The page is served until Ctrl-C.
    """

    files: Annotated[
        Positional[tuple[Path, ...]], arg(metavar="[FILE ...]", help_behavior_hint="(default: an example)")
    ] = ()
    """A grasp file or a folder of them, instead of --grasps, optionally with the `validate --json` or `run --json` file
    about it; or a replay of `validate --replays`."""
    compare: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Draw the grasp of the same number of another grasp file as a ghost, with a line of its numbers."""
    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    serving: Annotated[Serving, arg(name="")] = field(default_factory=Serving)

    def execute(self) -> int:
        """Serve the page until interrupted; return the exit code.

        Raises:
            GraspRefineError: a file cannot be used, or the port is taken.
        """
        from grasp_refine_apps.viewer.panels.banner import Banner
        from grasp_refine_apps.viewer.server.access import PUBLIC_WARNING, is_local
        from grasp_refine_apps.viewer.server.page import close_server, open_server

        check_writable(self.serving.json, overwrite=self.serving.overwrite)
        use_few_arenas()
        # viser warns of what is drawn while a page is closed.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
        # Refused before anything is shown.
        self.settings.config()
        # First, so that a browser can load the page, and show the progress, while the rest loads.
        page = open_server(self.serving.host, self.serving.port, invocation("view", self))
        try:
            screen().print(f"{page.address} shows it; Ctrl-C ends it", soft_wrap=True, highlight=False)
            sys.stdout.flush()
            if not is_local(self.serving.host):
                screen(stderr=True).print(f"Warning: {PUBLIC_WARNING}", highlight=False)
            where = {"address": page.address, "host": page.server.get_host(), "port": page.server.get_port()}
            save_document(self.serving.json, "view", where)
            if self.serving.open and _has_screen():
                webbrowser.open(page.address)
            loading = Banner(page.server.gui)

            def report(step: str) -> None:
                loading.show(f"Opening: {step} …")

            report("loading the viewer")
            # Loads packages for a second.
            from grasp_refine_apps.commands.view_files import open_files
            from grasp_refine_apps.viewer.panels.app import Viewer

            try:
                controller = open_files(self.files, self.inputs, self.settings, self.compare, report)
            except GraspRefineError as error:
                loading.show(f"error: {in_options(' '.join(str(error).split()))}", bad=True)
                # The page of a browser that was opened above comes first, and then its text.
                _wait_for_page(page.server, PAGE_PATIENCE_S if self.serving.open and _has_screen() else 0.0)
                raise
            report("drawing")
            with Viewer(page, controller, lambda: loading.show("")) as viewer:
                _wait(viewer)
        finally:
            close_server(page.server)
        return 0


def use_few_arenas() -> None:
    """Let glibc keep the memory of all threads in two arenas.

    Each page has threads of its own. With an arena for each, pages that come and go for 20 minutes took 1.3 GB; with
    two they take 0.6. Other C libraries do as they do.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(M_ARENA_MAX, 2)


def show(grasps: RefinedGrasps | Problem) -> Viewer:
    """Show grasps in a browser, and return the viewer: the entry point of `grasp_refine.view`."""
    from grasp_refine.problem.refined import RefinedGrasps
    from grasp_refine_apps.viewer.jobs.controller import Controller
    from grasp_refine_apps.viewer.model.collection import Collection
    from grasp_refine_apps.viewer.panels.app import Viewer
    from grasp_refine_apps.viewer.server.page import open_server

    collection = Collection.of_refined(grasps) if isinstance(grasps, RefinedGrasps) else Collection.of(grasps)
    viewer = Viewer(open_server(Serving.host, 0), Controller(collection, Settings()))
    screen().print(f"{viewer.address} shows it", soft_wrap=True, highlight=False)
    if _has_screen():
        webbrowser.open(viewer.address)
    return viewer


def _wait(viewer: Viewer) -> None:
    """Wait for an interrupt; from then on, the time for cleaning up is limited.

    The first Ctrl-C only warns of unsaved grasps, if there are any.
    """
    asked = False
    while True:
        try:
            while True:
                # If another thread gets the signal, this one is not woken by it.
                time.sleep(SIGNAL_POLL_S)
        except KeyboardInterrupt as interrupt:
            count = viewer.num_unsaved
            if asked or not count or interrupt.args != (signal.SIGINT,):
                break
            asked = True
            screen(stderr=True).print(
                f"{count_text(count, 'grasp')} edited or refined and not saved: save them in the page, tab Files, or "
                "press Ctrl-C again to end",
                highlight=False,
            )
    last = threading.Timer(CLEANUP_LIMIT_S, os._exit, (0,))
    last.daemon = True
    last.start()


def _wait_for_page(server: viser.ViserServer, seconds: float) -> None:
    """Wait until there is a page, for some seconds at most, and then until it shows what was sent."""
    end = time.monotonic() + seconds
    while not server.get_clients() and time.monotonic() < end:
        time.sleep(SIGNAL_POLL_S)
    if server.get_clients():
        time.sleep(PAGE_DRAWING_S)


def _has_screen() -> bool:
    """Return True if a browser can open here."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
