"""Live plots of a refinement: how far contacts are off, how deep links are in the object, and the loss."""

from __future__ import annotations

from threading import Lock, Timer
from time import monotonic

import numpy as np
import viser
from jaxtyping import Float

from ..trace import Trace

PERIOD = 0.2
"""Seconds between two updates."""
MOST = 400
"""Most points of a curve."""
LEAST_MM = 1e-4
"""Lengths below this, in mm, are drawn as this: a logarithmic axis has no zero."""
LEAST_LOSS = 1e-16
"""The same of losses, in m^2."""

_ERROR, _DEPTH, _LOSS, _MARK = "#1c7ed6", "#e8590c", "#2b8a3e", "#c2255c"

Curve = Float[np.ndarray, " P"]


class Plots:
    """Two plots over the iterations, with a dot at the one that is shown."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Make them, unseen until there is something to plot."""
        none = np.array([0.0])
        mark = {"label": "shown", "stroke": _MARK, "width": 0, "points": {"show": True, "size": 9, "fill": _MARK}}
        plain = {"show": False}
        scales = {"x": {"time": False}, "y": {"distr": 3, "log": 10}}
        self._lengths = gui.add_uplot(
            (none, none, none, none),
            (
                {"label": "iteration"},
                {"label": "contact error", "stroke": _ERROR, "width": 2, "points": plain},
                {"label": "penetration", "stroke": _DEPTH, "width": 2, "points": plain},
                mark,
            ),
            title="Contact error and penetration, mm",
            scales=scales,
            height=150,
            visible=False,
        )
        self._loss = gui.add_uplot(
            (none, none, none),
            ({"label": "iteration"}, {"label": "loss", "stroke": _LOSS, "width": 2, "points": plain}, mark),
            title="Loss, m²",
            scales=scales,
            height=120,
            visible=False,
        )
        self._lock = Lock()
        self._wanted: tuple[Trace | None, int | None] = (None, None)
        self._drawn = self._wanted
        self._last = float("-inf")
        self._timer: Timer | None = None

    def show(self, trace: Trace | None, frame: int | None) -> None:
        """Plot a trace, with a dot at an iteration; what comes fast is drawn every `PERIOD`, the last always."""
        with self._lock:
            self._wanted = trace, frame
            if self._wanted == self._drawn or self._timer is not None:
                return
            wait = self._last + PERIOD - monotonic()
            if wait <= 0:
                self._draw()
                return
            self._timer = Timer(wait, self._late)
            self._timer.daemon = True
            self._timer.start()

    def close(self) -> None:
        """Plot nothing any more."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()

    def _late(self) -> None:
        with self._lock:
            self._timer = None
            self._draw()

    def _draw(self) -> None:
        self._last, self._drawn = monotonic(), self._wanted
        trace, frame = self._wanted
        seen = trace is not None and len(trace) > 1
        if seen:
            self._lengths.data, self._loss.data = curves(trace, frame)
        self._lengths.visible = self._loss.visible = seen


def curves(trace: Trace, frame: int | None) -> tuple[tuple[Curve, Curve, Curve, Curve], tuple[Curve, Curve, Curve]]:
    """What is plotted of a trace, at most `MOST` points: all iterations or some of them, with the one that is shown.

    Args:
        trace: At least one iteration.
        frame: The iteration with a dot; None: the last one.

    Returns:
        Iteration, contact error and penetration in mm, dot; and iteration, loss in m^2, dot. Dots are NaN elsewhere.
    """
    last = len(trace) - 1
    frame = last if frame is None else min(frame, last)
    kept = np.unique(np.linspace(0, last, min(last + 1, MOST - 1)).round().astype(int))
    kept = np.union1d(kept, [frame])
    error, depth = (np.maximum(1e3 * values[kept], LEAST_MM) for values in (trace.contact_error, trace.penetration))
    loss = np.maximum(trace.loss[kept], LEAST_LOSS)
    x, at = kept.astype(float), kept == frame
    return (x, error, depth, np.where(at, error, np.nan)), (x, loss, np.where(at, loss, np.nan))
