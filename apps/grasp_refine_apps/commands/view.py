"""`refine-grasp view`: view, refine, edit, validate and export grasps in a browser."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.formats.listing import OURS
from grasp_refine.grasps.formats.reading import Reading
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.problem.load import Loader
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.validation.replay.replay import Stage
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.report.command_line import in_options, invocation
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.progress import Reporter
from grasp_refine_apps.report.screen import screen

if TYPE_CHECKING:
    import viser

    from grasp_refine.problem.problem import Problem
    from grasp_refine.validation.replay.replay import Replay
    from grasp_refine_apps.viewer.files.validation_file import ValidationFile
    from grasp_refine_apps.viewer.jobs.controller import Controller
    from grasp_refine_apps.viewer.model.collection import Collection
    from grasp_refine_apps.viewer.model.recording import Recording
    from grasp_refine_apps.viewer.panels.app import Viewer


PAGE_PATIENCE_S, PAGE_DRAWING_S = 10.0, 1.0
"""Longest wait until an opened page is there to show an error, and time in which it shows it, seconds."""

SIGNAL_POLL_S = 0.2
"""Longest delay until a signal is noticed, seconds."""

CLEANUP_LIMIT_S = 5.0
"""Time limit for cleaning up at the end, seconds."""


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
            loading.show("Opening: loading the viewer …")
            # Loads packages for seconds.
            from grasp_refine_apps.viewer.panels.app import Viewer

            try:
                controller = self._controller(lambda what: loading.show(f"Opening: {what} …"))
            except GraspRefineError as error:
                loading.show(f"error: {in_options(' '.join(str(error).split()))}", bad=True)
                # The page of a browser that was opened above comes first, and then its text.
                _wait_for_page(page.server, PAGE_PATIENCE_S if self.serving.open and _has_screen() else 0.0)
                raise
            loading.show("Opening: drawing …")
            with Viewer(page, controller, lambda: loading.show("")) as viewer:
                _wait(viewer)
        finally:
            close_server(page.server)
        return 0

    def _controller(self, report: Callable[[str], None] = lambda step: None) -> Controller:
        """Load the grasps of the files, with the results of documents about them; `report` is called with each step."""
        report("reading the grasps")
        from grasp_refine_apps.viewer.files.validation_file import read_validation
        from grasp_refine_apps.viewer.jobs.controller import Controller
        from grasp_refine_apps.viewer.jobs.replaying import is_replay

        documents = [read_validation(path) for path in self.files if path.suffix.lower() == ".json"]
        grasps = [path for path in self.files if path.suffix.lower() != ".json"]
        if len(grasps) > 1 or (grasps and self.inputs.grasps is not None):
            raise GraspRefineError(
                "one grasp file at a time, or a folder of them, such as the one that run wrote; "
                f"got {', '.join(map(str, [*grasps, *filter(None, [self.inputs.grasps])]))}"
            )
        inputs = self.inputs if not grasps else replace(self.inputs, grasps=grasps[0])
        with Reporter(screen(stderr=True)) as reporter:

            def say(line: str) -> None:
                reporter.say(line)
                report(line)

            def wait(what: str) -> None:
                reporter.wait(what)
                report(what)

            if grasps and is_replay(grasps[0]):
                if self.compare is not None:
                    raise GraspRefineError(f"--compare is for grasp files; {grasps[0]} is a replay")
                return self._replay_controller(grasps[0], reporter)
            if documents and inputs.grasps is None:
                inputs = replace(inputs, grasps=_grasp_file(documents[0]))
            collection = self._load(inputs, say, wait)
            compared = None
            if self.compare is not None:
                compared = self._load(replace(inputs, grasps=self.compare), say, wait, shown=False)
            opened = [each for each in (collection, compared) if each is not None]
            for note in dict.fromkeys(note for each in opened for note in each.problem.notes):
                reporter.note(note)
        for document in documents:
            collection = collection.with_trials(document.of(collection))
        return Controller(collection, self.settings, compared)

    def _load(
        self, inputs: Inputs, say: Callable[[str], None], wait: Callable[[str], None], *, shown: bool = True
    ) -> Collection:
        """Load grasps; all objects are read and checked, only the shown one is decomposed."""
        from grasp_refine_apps.viewer.model.collection import Collection, posed_in

        # A suspected convention is seen best.
        inputs = replace(inputs, as_is=True)
        loader = Loader(inputs, self.settings.seed, say, wait)
        problem = loader.problem()
        number = int(posed_in(problem).argmax())
        first = next((at for at, group in enumerate(problem.groups) if number in group.place), 0) if shown else None
        rough = [at for at, group in enumerate(problem.groups) if at != first and group.scene.object.takes_long]
        return Collection.of(loader.prepare(problem, rough=rough))

    def _replay_controller(self, path: Path, reporter: Reporter) -> Controller:
        """Load the grasp of a replay, with its motion."""
        from grasp_refine.validation.replay.replay import load_replay
        from grasp_refine.validation.validate import model_of
        from grasp_refine_apps.viewer.jobs.controller import Controller
        from grasp_refine_apps.viewer.jobs.replaying import replay_recording
        from grasp_refine_apps.viewer.model.collection import Collection

        replay = load_replay(path)
        loader = Loader(self.inputs, self.settings.seed, reporter.say)
        hand = loader.hands.load(self.inputs.hand or replay.hand, None)
        recording = replay_recording(hand, model_of(hand), replay)
        problem = loader.prepare(loader.of_grasps(_grasp_of(replay, recording, hand), path))
        # The grasp keeps the number that it had where it was simulated.
        number = re.search(r" (\d+)$", replay.name)
        if number is not None:
            groups = tuple(replace(group, index=np.array([int(number[1])])) for group in problem.groups)
            problem = replace(problem, groups=groups)
        controller = Controller(Collection.of(problem), self.settings)
        controller.player.show(recording)
        return controller


def show(grasps: RefinedGrasps | Problem) -> Viewer:
    """Show grasps in a browser, and return the viewer: the entry point of `grasp_refine.view`."""
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


def _grasp_file(document: ValidationFile) -> Path:
    """Return the grasp file that a document is about.

    Raises:
        GraspRefineError: it does not name exactly one existing file.
    """
    found = [Path(path) for path in document.files.values() if Path(path).exists()]
    if len(found) != 1:
        raise GraspRefineError(f"{document.path}: give the grasp file that it is about, too")
    return found[0]


def _grasp_of(replay: Replay, recording: Recording, hand: Hand) -> Reading:
    """Return the grasp of a simulation: the hand at the beginning of the squeeze."""
    squeezed = replay.time[replay.stage >= Stage.SQUEEZE]
    at = max(int(np.searchsorted(recording.time, squeezed[0] if len(squeezed) else np.inf)) - 1, 0)
    grasps = GraspSet(
        hand=replay.hand,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.array([replay.object]),
        scale=np.ones(1),
        hand_pose=pose_from_transform(recording.T_root[at : at + 1]),
        q=recording.q[at : at + 1],
    )
    return Reading(grasps, OURS, (), ())


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
