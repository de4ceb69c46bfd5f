"""Timeline of a refinement: a slider over all iterations, which also plays them, and their measures."""

from __future__ import annotations

import numpy as np
import viser

from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.panels.play_bar import PlayBar


class Timeline:
    """Slider, play button and a line of numbers."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        """Make the widgets in the container that is open."""
        self._controller = controller
        self.slider = gui.add_slider("Iteration", 0, 1, 1, 0, hint="Drag to see the hand in each iteration")
        self.bar = PlayBar(gui, self.slider, lambda: _shown(controller.state), self._scrub)
        self._numbers = gui.add_markdown("")

    def draw(self, state: State) -> None:
        """Show a state."""
        count = 1 if state.trace is None else len(state.trace)
        self.bar.enable(count > 1)
        self.bar.draw(np.arange(count), _shown(state)[1])
        self._numbers.content = numbers(state)

    def close(self) -> None:
        """Stop playing."""
        self.bar.close()

    def _scrub(self, frame: int) -> None:
        """Show an iteration; at the last one of a refinement that runs, follow it."""
        state = self._controller.state
        follows = state.job is not None and state.job.kind == "refine" and state.trace is not None
        at_end = state.trace is not None and frame >= len(state.trace) - 1
        self._controller.player.scrub(None if follows and at_end else frame)


def _shown(state: State) -> tuple[Trace | None, int]:
    """The iterations, and the number of the shown one."""
    last = 0 if state.trace is None else len(state.trace) - 1
    return state.trace, last if state.frame is None else min(state.frame, last)


def numbers(state: State) -> str:
    """Text on the measures of the shown iteration."""
    trace, k = _shown(state)
    if trace is None:
        return "Each iteration of a refinement can be shown here."
    if state.frame is None and state.job is None and not state.pose.same(trace.pose(k)):
        return "The hand was moved since: drag the timeline to see the refinement again."
    label = trace.label[k]
    return f"**{label[:1].upper()}{label[1:]}**: {trace.text(k)}"
