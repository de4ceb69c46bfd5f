"""`refine-grasp view`: grasps in a browser, to be looked at, refined, steered, tested and taken away."""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.commands.inputs import Inputs
from grasp_refine.commands.settings import Settings
from grasp_refine.errors import GraspRefineError
from grasp_refine.report.progress import Reporter
from grasp_refine.report.screen import screen


@dataclass(frozen=True)
class Serving:
    """Where the page is."""

    host: str = "127.0.0.1"
    """Address to listen on. Whoever can reach it can do everything that the page can: only this machine by default."""
    port: int = 8080
    """Port to listen on; 0: any that is free."""
    open: bool = True
    """Open the page in a browser, where there is a screen."""


@dataclass(frozen=True)
class View:
    """Show grasps in a browser: refine them before your eyes, steer them, test them, compare them, take them away.

    Opens grasp files of any kind, what `run` and `validate` write, and tasks that `bench align --save` wrote. Without
    files, the example grasps of the embedded hand on the embedded mug. The page stays until Ctrl-C.
    """

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="[FILE ...]", help_behavior_hint="(default: an example)")] = ()
    """Result files or grasp files, instead of --grasps."""
    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    serving: Annotated[Serving, arg(name="")] = field(default_factory=Serving)

    def execute(self) -> int:
        """Show it until interrupted; returns the exit code.

        Raises:
            GraspRefineError: what should be opened cannot be used, the port is taken, or viser is not installed.
        """
        from grasp_refine.apps.viewer.page import open_server

        server = open_server(self.serving.host, self.serving.port)
        try:
            from grasp_refine.apps.viewer.app import Viewer
            from grasp_refine.apps.viewer.collection import Collection
            from grasp_refine.apps.viewer.controller import Controller

            self.settings.config()
            with Reporter(screen(stderr=True)) as reporter:
                inputs = self.inputs if not self.files else replace(self.inputs, grasps=self.files[0])
                problem = inputs.load(self.settings.seed, reporter.say, reporter.wait)
                for note in problem.notes:
                    reporter.say(f"note: {note}")
            with Viewer(server, Controller(Collection.of(problem), self.settings)) as viewer:
                screen().print(f"{viewer.address} shows it; Ctrl-C ends it", soft_wrap=True, highlight=False)
                if self.serving.open and _has_screen():
                    webbrowser.open(viewer.address)
                while True:
                    time.sleep(3600.0)
        except KeyboardInterrupt:
            return 0
        finally:
            server.stop()


def _has_screen() -> bool:
    """Whether a browser could open here."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
