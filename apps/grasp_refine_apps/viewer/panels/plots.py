"""Live plot of a refinement: remaining gap, penetration, and loss."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine_apps.viewer.model.counted import REMAINING
from grasp_refine_apps.viewer.model.recording import subsample
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.trace import Trace

MAX_POINTS = 400
"""Maximum points of a curve."""
MIN_LENGTH_MM = 1e-3
"""Smallest length drawn, in mm: a logarithmic axis has no zero, and uPlot writes no smaller number."""

_GRID: Any = {"stroke": "rgba(128, 128, 128, 0.15)", "width": 1}
_SERIES = ((REMAINING, "#1c7ed6"), ("penetration", "#e8590c"), ("total error", "#2b8a3e"))
_SHOWN: Any = {"label": "shown now", "stroke": "#868e96", "width": 2, "points": {"show": False}}


class Plot:
    """A plot over the iterations, in mm, with a line at the one that is shown."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Make the plot, hidden until there is something to plot."""
        none = np.array([0.0])
        curve: dict[str, Any] = {"width": 2, "points": {"show": False}}
        series: tuple[Any, ...] = tuple({"label": name, "stroke": color, **curve} for name, color in _SERIES)
        self.handle = gui.add_uplot(
            (none,) * 5,
            ({"label": "iteration"}, *series, _SHOWN),
            title="Distance from the goal, mm",
            scales={"x": {"time": False}, "y": {"distr": 3, "log": 10}},
            axes=({"grid": _GRID, "ticks": {"width": 1}}, {"grid": _GRID, "ticks": {"show": False}}),
            legend={"live": False},
            height=190,
            padding=(10, 16, 0, 0),
            visible=False,
        )
        self._drawn: tuple[Trace | None, int | None] = (None, None)

    def draw(self, state: State) -> None:
        """Plot the iterations of a state, with a line at the one that is shown."""
        trace, frame = state.trace, state.frame
        if (trace, frame) == self._drawn:
            return
        self._drawn = trace, frame
        if trace is not None and len(trace) > 1:
            self.handle.data = tuple(curves(trace, frame))
        self.handle.visible = trace is not None and len(trace) > 1


def curves(trace: Trace, frame: int | None) -> Float[np.ndarray, "5 P"]:
    """Return the plotted data of a trace, at most `MAX_POINTS` points: all or some iterations, and the shown one.

    That one occurs three times, so that the last curve, which has a value only at the second, is a vertical line.

    Args:
        trace: At least one iteration.
        frame: The iteration with a line; None: the last one.

    Returns:
        Iteration; remaining gap, penetration and total error (root of the loss), in mm; the line, NaN elsewhere.
    """
    last = len(trace) - 1
    frame = last if frame is None else min(frame, last)
    kept = np.union1d(subsample(last + 1, MAX_POINTS - 3), [frame])
    kept = np.sort(np.append(kept, [frame, frame]))
    lengths = np.stack((trace.remaining, trace.penetration, np.sqrt(np.maximum(trace.loss, 0.0))))[:, kept]
    lengths = np.maximum(1e3 * lengths, MIN_LENGTH_MM)
    line = np.full(len(kept), np.nan)
    line[np.searchsorted(kept, frame) + 1] = np.nanmax(lengths)
    return np.stack((kept.astype(float), *lengths, line))
