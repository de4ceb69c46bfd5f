"""What the tests of the viewer open."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs import validating
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.validated import DirectionResult, TrialResult
from running_processes import PATIENCE_S

if TYPE_CHECKING:
    from websocket_page import Page

SHORT = replace(DEXGRASPBENCH, name="short", checks=2)
"""A protocol whose pushes take 0.4 s of simulation."""


def example(**options: object) -> Problem:
    """The embedded example grasps of Allegro on the mug, or what the options say."""
    return load_problem(ProblemSpec(**options))


def controller(problem: Problem | None = None, settings: Settings | None = None) -> Controller:
    """A controller of some grasps; the caller closes it."""
    return Controller(Collection.of(problem or example()), settings or Settings())


@contextmanager
def shown_panel(kind: type, made: Controller) -> Iterator[tuple[Any, Page]]:
    """A panel of this kind that shows what a controller has, and a page on it; all closed at the end."""
    # The controller's tests need no viser.
    import viser

    from grasp_refine_apps.viewer.server.page import Drawer
    from websocket_page import DRAWING, Page

    def alone(draw: Callable[[State], None], state: State) -> None:
        with DRAWING:
            draw(state)

    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    panel = kind(server, made)
    draws = [panel.draw, *getattr(panel, "slow_draws", ())]
    drawer = Drawer([partial(alone, draw) for draw in draws], made.state)
    made.listen(drawer.draw)
    page = Page(server)
    yield panel, page
    page.close()
    made.close()
    drawer.close()
    if hasattr(panel, "close"):
        panel.close()
    server.stop()


def settled(viewer: Controller, seconds: float = PATIENCE_S) -> None:
    """Wait until nothing is being done any more."""
    end = time.monotonic() + seconds
    while viewer.state.job is not None:
        assert time.monotonic() < end, f"still doing {viewer.state.job}"
        time.sleep(0.005)


def short_trials(patch: pytest.MonkeyPatch) -> str:
    """Let the viewer know `SHORT`; return its name."""
    patch.setattr(validating, "PROTOCOLS", {**PROTOCOLS, SHORT.name: SHORT})
    return SHORT.name


def ignored() -> Control:
    """The control of a job that nobody follows."""
    return Control(lambda share, what: None)


def made_trial(reason: Reason) -> TrialResult:
    """The result of a grasp that was pushed in one direction."""
    result = DirectionResult("+x", reason, 0.1, 0.01, 0.1, 0.01, 0.1, ())
    return TrialResult(DEXGRASPBENCH, (result,), {}, 0.0, 0.0, 0.0)
