"""What the tests of the viewer open."""

from __future__ import annotations

import time

from grasp_refine.apps.viewer.collection import Collection
from grasp_refine.apps.viewer.controller import Controller

from grasp_refine.commands.inputs import Inputs
from grasp_refine.commands.settings import Settings
from grasp_refine.problem import Problem


def example(**options: object) -> Problem:
    """The embedded example grasps of Allegro on the mug, or what the options say."""
    return Inputs(**options).load(0, lambda line: None)


def controller(problem: Problem | None = None, settings: Settings | None = None) -> Controller:
    """A controller of some grasps; the caller closes it."""
    return Controller(Collection.of(problem or example()), settings or Settings())


def settled(viewer: Controller, seconds: float = 30.0) -> None:
    """Wait until nothing is being done any more."""
    end = time.monotonic() + seconds
    while viewer.state.job is not None:
        assert time.monotonic() < end, f"still doing {viewer.state.job}"
        time.sleep(0.005)


def until(holds: object, seconds: float = 30.0) -> None:
    """Wait until a function returns something true."""
    end = time.monotonic() + seconds
    while not holds():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.002)
