"""Error of each method against iterations or CPU time, as a chart of uplot."""

from __future__ import annotations

from math import ceil, floor
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from grasp_refine_apps.bench.align.saved import AlignmentTask, Trajectory
from grasp_refine_apps.viewer.alignment_scene import method_color

Against = Literal["iterations", "CPU time"]
"""Horizontal axis of the error chart."""
NUM_SAMPLES = 240
"""Number of samples of each curve along the horizontal axis."""
SOLVED_DISTANCE_M = 1e-3
"""A task whose error is less than the square of this (metres) counts as solved."""
MIN_ERROR_MM, MAX_ERROR_MM = 1e-3, 1e3
"""Range of drawn errors in mm; errors beyond it are clipped."""
INK_COLOR = "#24292f"


def millimetres(error: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Lengths in mm of errors in m^2, clipped to the range of the chart; NaN where unknown."""
    return np.where(np.isfinite(error), np.clip(1e3 * np.sqrt(error), MIN_ERROR_MM, MAX_ERROR_MM), np.nan)


def best_so_far(run: Trajectory) -> Float[np.ndarray, " K"]:
    """The smallest error (m^2) up to each iterate; infinite before the first that is known."""
    return np.minimum.accumulate(np.nan_to_num(run.error, nan=np.inf))


class Chart:
    """The curves of a task."""

    def __init__(self, task: AlignmentTask, against: Against) -> None:
        """Prepare the curves.

        Args:
            task: The task to draw.
            against: The horizontal axis.
        """
        self.task, self.against = task, against
        self.x = [run.iteration + 1.0 if against == "iterations" else 1e3 * run.cpu_s for run in task.trajectories]
        end = max(x[-1] for x in self.x)
        first = min(x[min(1, len(x) - 1)] for x in self.x) if against == "CPU time" else 1.0
        self.start = float(np.clip(first, 1e-5 * end, 0.5 * end)) or 1.0
        self.grid = np.geomspace(self.start, max(end, 2.0 * self.start), NUM_SAMPLES)
        self.y = [millimetres(best_so_far(run)) for run in task.trajectories]
        self.raw = [millimetres(run.error) for run in task.trajectories]

    def data(self, method: int, frame: int) -> tuple[np.ndarray, ...]:
        """Return columns: x, best error so far of each method, error of the shown method, its iterate, and 1 mm."""
        now = float(np.clip(self.x[method][frame], self.grid[0], self.grid[-1]))
        grid = np.insert(self.grid, np.searchsorted(self.grid, now), now)
        columns = [self._at(x, y, grid) for x, y in zip(self.x, self.y, strict=True)]
        here = np.where(grid == now, self.raw[method][frame], np.nan)
        return (
            grid,
            *columns,
            self._at(self.x[method], self.raw[method], grid),
            here,
            np.full(len(grid), 1e3 * SOLVED_DISTANCE_M),
        )

    def series(self, method: int) -> tuple[Any, ...]:
        """Return the series of the chart: label, colour and width of each column."""
        none = {"show": False}

        def line(label: str, color: str, width: float, **more: Any) -> dict[str, Any]:
            return {"label": label, "stroke": color, "width": width, "points": none, **more}

        runs = [
            line(run.label, css(method_color(number)), 3.0 if number == method else 1.5)
            for number, run in enumerate(self.task.trajectories)
        ]
        here = {
            "label": "shown",
            "stroke": INK_COLOR,
            "width": 0,
            "points": {"show": True, "size": 9, "fill": INK_COLOR},
        }
        raw = line("each iterate", f"{css(method_color(method))}55", 1.0)
        return {"label": self.against}, *runs, raw, here, line("solved", "#7a828e", 1.0, dash=(5, 4))

    def scales(self) -> dict[str, Any]:
        """Return the scales of both axes, which are logarithmic."""
        x, y = self._ranges()
        return {"x": {"time": False, "distr": 3, "range": x}, "y": {"distr": 3, "range": y}}

    def axes(self) -> tuple[Any, ...]:
        """Labels of the axes."""
        names = ("poses tried" if self.against == "iterations" else "CPU time, ms"), "best error so far, mm"
        return tuple(
            {"label": name, "labelSize": 18, "size": size, **_ticks(*ends)}
            for name, size, ends in zip(names, (32, 46), self._ranges(), strict=True)
        )

    def _ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ends of both axes."""
        top = max(float(np.nanmax(raw, initial=1.0)) for raw in self.raw)
        return (float(self.grid[0]), float(self.grid[-1])), (MIN_ERROR_MM, 1.5 * top)

    @staticmethod
    def _at(x: np.ndarray, y: np.ndarray, grid: np.ndarray) -> np.ndarray:
        """Last value of a curve at or before each grid point; constant beyond its end."""
        found = y[np.clip(np.searchsorted(x, grid, side="right") - 1, 0, None)]
        return np.where(np.isfinite(found), found, np.nan)


def _ticks(low: float, high: float) -> dict[str, tuple[Any, ...]]:
    """Tick marks at the powers of ten between two ends; by default, minor ticks are drawn, too."""
    powers = [10.0**k for k in range(ceil(np.log10(low) - 1e-9), floor(np.log10(high) + 1e-9) + 1)]
    return {"splits": tuple(powers), "values": tuple(f"{power:g}" for power in powers)}


def css(color: tuple[int, int, int]) -> str:
    """Colour in CSS notation."""
    return "#" + bytes(color).hex()
