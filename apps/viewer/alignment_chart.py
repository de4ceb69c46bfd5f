"""Error of each method against iterations or CPU time, as a chart of uplot."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..bench.align.saved import AlignmentTask, Trajectory
from .alignment_scene import method_color

Against = Literal["iterations", "CPU time"]
"""What the error is drawn against."""
STEPS = 240
"""Places along the axis at which curves are drawn."""
SOLVED = 1e-3
"""A task whose error is less than the square of this (metres) counts as solved."""
SMALLEST = 1e-4
"""Errors below this (mm) are drawn there."""
INK = "#24292f"


def millimetres(error: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Errors in m^2 as lengths in mm, as a chart shows them; where there is none, NaN."""
    return np.maximum(1e3 * np.sqrt(error), SMALLEST)


def best_so_far(run: Trajectory) -> Float[np.ndarray, " K"]:
    """The smallest error (m^2) up to each iterate; infinite before the first that is known."""
    return np.minimum.accumulate(np.nan_to_num(run.error, nan=np.inf))


class Chart:
    """The curves of a task."""

    def __init__(self, task: AlignmentTask, against: Against) -> None:
        """Prepare the curves.

        Args:
            task: What is drawn.
            against: The horizontal axis.
        """
        self.task, self.against = task, against
        self.x = [run.iteration + 1.0 if against == "iterations" else 1e3 * run.cpu_s for run in task.trajectories]
        end = max(x[-1] for x in self.x)
        first = 1.0 if against == "iterations" else max(min(x[min(1, len(x) - 1)] for x in self.x), 1e-3 * end)
        self.grid = np.unique(np.geomspace(first, max(end, 1.01 * first), STEPS))
        self.y = [millimetres(best_so_far(run)) for run in task.trajectories]
        self.raw = [millimetres(run.error) for run in task.trajectories]
        top = max(float(np.nanmax(raw[np.isfinite(raw)], initial=1.0)) for raw in self.raw)
        low = min(float(y[-1]) for y in self.y if np.isfinite(y[-1]))
        self.limits = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(top))

    def data(self, method: int, frame: int) -> tuple[np.ndarray, ...]:
        """Columns: x, the best so far of each method, the present method's error itself, where it is, and 1 mm."""
        now = float(np.clip(self.x[method][frame], self.grid[0], self.grid[-1]))
        grid = np.insert(self.grid, np.searchsorted(self.grid, now), now)
        columns = [self._at(x, y, grid) for x, y in zip(self.x, self.y, strict=True)]
        here = np.where(grid == now, self.raw[method][frame], np.nan)
        return grid, *columns, self._at(self.x[method], self.raw[method], grid), here, np.full(len(grid), 1e3 * SOLVED)

    def series(self, method: int) -> tuple[dict[str, Any], ...]:
        """How the columns look."""
        none = {"show": False}

        def line(label: str, color: str, width: float, **more: Any) -> dict[str, Any]:
            return {"label": label, "stroke": color, "width": width, "points": none, **more}

        runs = [
            line(run.label, css(method_color(number)), 3.0 if number == method else 1.5)
            for number, run in enumerate(self.task.trajectories)
        ]
        here = {"label": "shown", "stroke": INK, "width": 0, "points": {"show": True, "size": 9, "fill": INK}}
        raw = line("each iterate", f"{css(method_color(method))}55", 1.0)
        return {"label": self.against}, *runs, raw, here, line("solved", "#7a828e", 1.0, dash=(5, 4))

    def scales(self) -> dict[str, dict[str, Any]]:
        """Both axes are logarithmic."""
        return {"x": {"time": False, "distr": 3}, "y": {"distr": 3, "range": self.limits}}

    def axes(self) -> tuple[dict[str, Any], ...]:
        """Labels of the axes."""
        what = "iterations" if self.against == "iterations" else "CPU time, ms"
        return {"label": what, "labelSize": 18, "size": 34}, {
            "label": "best error so far, mm",
            "labelSize": 18,
            "size": 50,
        }

    @staticmethod
    def _at(x: np.ndarray, y: np.ndarray, grid: np.ndarray) -> np.ndarray:
        """The last value of a curve at each place; it stays where it ended."""
        found = y[np.clip(np.searchsorted(x, grid, side="right") - 1, 0, None)]
        return np.where(np.isfinite(found), found, np.nan)


def css(color: tuple[int, int, int]) -> str:
    """A colour as browsers write it."""
    return "#" + bytes(color).hex()
