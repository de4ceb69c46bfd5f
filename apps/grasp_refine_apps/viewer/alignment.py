"""Page of a saved task of `bench align`: the iterates of each method for two bodies."""

from __future__ import annotations

import threading
import time
import traceback
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_args

import numpy as np
import viser

from grasp_refine_apps.bench.align.saved import AlignmentTask
from grasp_refine_apps.viewer import alignment_words as words
from grasp_refine_apps.viewer.alignment_chart import Against, Chart
from grasp_refine_apps.viewer.alignment_scene import AlignmentScene, Layers

PLAY_DURATION_S = 10.0
"""Duration of a played trajectory in seconds; short ones take less."""
MIN_FRAME_S, MAX_FRAME_S = 0.04, 0.4
"""Shortest and longest time between two played iterates, seconds."""
CHART_PERIOD_S = 0.25
"""Seconds between two updates of the chart while the page scrubs or plays."""
JUMP_LABELS = ("start", "best", "end")
"""Labels of the jump buttons."""
LAYERS = tuple(one.name for one in fields(Layers))
"""Fields of `Layers`, and attributes of their widgets on the page."""


@dataclass(frozen=True)
class Shown:
    """State of the page."""

    method: int
    """Index of the trajectory."""
    iteration: int = 0
    """Number of the iterate; between two recorded ones, the earlier is shown."""
    playing: bool = False
    """Whether the trajectory plays."""
    against: Against = "iterations"
    """Horizontal axis of the chart."""
    layers: Layers = field(default_factory=Layers)
    """Layers shown beside the bodies."""


class AlignmentPage:
    """Widgets and scene of one task; all pages of the server show the same."""

    def __init__(self, server: viser.ViserServer, task: AlignmentTask) -> None:
        """Make everything and show the start of the method that did best.

        Args:
            server: A server that shows nothing else.
            task: The task to show.
        """
        self.server, self.task = server, task
        errors = np.nan_to_num([run.error[run.result] for run in task.trajectories], nan=np.inf)
        self.shown = Shown(int(errors.argmin()))
        self.charts = {against: Chart(task, against) for against in get_args(Against)}
        self.scene = AlignmentScene(server, task)
        self._drawn: Shown | None = None
        self._charted: Shown | None = None
        self._charted_at = 0.0
        self._changed = threading.Condition()
        self._closed = False
        self._make_widgets()
        self._listen()
        self._draw(self.shown)
        self._thread = threading.Thread(target=self._keep_drawing, name="alignment", daemon=True)
        self._thread.start()

    def change(self, **changes: Any) -> None:
        """Change fields of `Shown`; the newest state is drawn soon after."""
        with self._changed:
            self.shown = replace(self.shown, **changes)
            self._changed.notify()

    def close(self) -> None:
        """Stop drawing."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def frame(self, shown: Shown) -> int:
        """Return the index of the recorded iterate that is shown."""
        iteration = self.task.trajectories[shown.method].iteration
        return max(int(np.searchsorted(iteration, shown.iteration, side="right")) - 1, 0)

    def _make_widgets(self) -> None:
        gui, labels = self.server.gui, self._labels()
        gui.add_html(words.STYLE + words.intro(self.task))
        self.method = gui.add_dropdown(
            "Method",
            labels,
            initial_value=labels[self.shown.method],
            hint="Method whose run is shown: how it moves body B.",
        )
        self.slider = gui.add_slider(
            "Iteration", 0, max(self._last(self.shown), 1), 1, 0, hint="Drag to see each step of the run."
        )
        self.play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="Play the run, or stop it.")
        self.jump = gui.add_button_group(
            "Go to", JUMP_LABELS, hint="The first iterate, the one that the method returned, or the last one."
        )
        self.where = gui.add_html("")
        self.against = gui.add_dropdown(
            "Chart over",
            get_args(Against),
            initial_value="iterations",
            hint="CPU time is that of this task alone, without start-up.",
        )
        chart = self.charts["iterations"]
        self.plot = gui.add_uplot(
            chart.data(self.shown.method, 0),
            chart.series(self.shown.method),
            scales=chart.scales(),
            axes=chart.axes(),
            legend={"show": False},
            height=230,
        )
        self.results = gui.add_html(words.results(self.task, self.shown.method))
        with gui.add_folder("Scene"):
            layers = self.shown.layers
            self.see_through = gui.add_checkbox("See through", layers.see_through, hint="Make the bodies transparent.")
            self.path = gui.add_checkbox(
                "Path of B", layers.path, hint="Path of the target on body B over the last steps."
            )
            self.others = gui.add_checkbox(
                "Other methods", layers.others, hint="Result of the other methods for body B, in their colours."
            )
        with gui.add_folder("Legend"):
            gui.add_html(words.legend())

    def _listen(self) -> None:
        def connect(handle: Any, change: Any) -> None:
            def on_update(event: viser.GuiEvent) -> None:
                # Values that the page sets itself come without a client.
                if event.client is not None:
                    change(event.target.value)

            handle.on_update(on_update)

        def layer(name: str) -> Any:
            return lambda value: self.change(layers=replace(self.shown.layers, **{name: value}))

        connect(self.method, lambda label: self.change(method=self._labels().index(label)))
        connect(self.slider, lambda value: self.change(iteration=int(value), playing=False))
        connect(self.against, lambda value: self.change(against=value))
        for name in LAYERS:
            connect(getattr(self, name), layer(name))
        self.play.on_click(lambda event: self._play_or_stop())
        self.jump.on_click(lambda event: self._jump(event.target.value))

    def _play_or_stop(self) -> None:
        shown = self.shown
        over = shown.iteration >= self._last(shown)
        self.change(playing=not shown.playing, iteration=0 if over and not shown.playing else shown.iteration)

    def _jump(self, to: str) -> None:
        run = self.task.trajectories[self.shown.method]
        frame = {"start": 0, "best": run.result, "end": len(run) - 1}[to]
        self.change(iteration=int(run.iteration[frame]), playing=False)

    def _keep_drawing(self) -> None:
        """Draw the newest state until the page is closed."""
        while True:
            with self._changed:
                if self.shown is self._drawn:
                    self._changed.wait(self._patience())
                if self._closed:
                    return
                if self.shown is self._drawn and self.shown.playing:
                    self.shown = self._next(self.shown)
                shown = self.shown
            try:
                if shown is not self._drawn:
                    self._draw(shown)
                if shown is not self._charted and time.monotonic() - self._charted_at >= CHART_PERIOD_S:
                    self._draw_chart(shown)
            except Exception:  # noqa: BLE001 - one state that cannot be drawn must not be the last
                traceback.print_exc()
                self._drawn = self._charted = shown

    def _patience(self) -> float | None:
        """Seconds until the next drawing if nothing changes; None: no drawing is due."""
        if self.shown.playing:
            return self._pause()
        return None if self._charted is self._drawn else CHART_PERIOD_S

    def _draw(self, shown: Shown) -> None:
        before, frame = self._drawn, self.frame(shown)
        with self.server.atomic():
            self.scene.draw(shown.method, frame, shown.layers)
            if before is None or before.method != shown.method:
                self.results.content = words.results(self.task, shown.method)
                self.slider.max = max(self._last(shown), 1)
            for widget, value in self._values(shown):
                if widget.value != value:
                    widget.value = value
            if before is None or before.playing != shown.playing:
                self.play.label = "Stop" if shown.playing else "Play"
                self.play.icon = viser.Icon.PLAYER_PAUSE if shown.playing else viser.Icon.PLAYER_PLAY
            self.where.content = words.where(self.task, shown.method, frame)
            if before is None or (before.method, before.against) != (shown.method, shown.against):
                self._draw_chart(shown)
        self._drawn = shown

    def _values(self, shown: Shown) -> list[tuple[Any, Any]]:
        """Widgets, each with its value."""
        layers = [(getattr(self, name), getattr(shown.layers, name)) for name in LAYERS]
        iteration = min(shown.iteration, self._last(shown))
        return [
            (self.method, self._labels()[shown.method]),
            (self.slider, iteration),
            (self.against, shown.against),
            *layers,
        ]

    def _draw_chart(self, shown: Shown) -> None:
        """Show curves and the present iterate, which costs a browser more than the scene does."""
        before, chart = self._charted, self.charts[shown.against]
        with self.server.atomic():
            if before is None or before.against != shown.against:
                self.plot.scales, self.plot.axes = chart.scales(), chart.axes()
            if before is None or (before.method, before.against) != (shown.method, shown.against):
                self.plot.series = chart.series(shown.method)
            self.plot.data = chart.data(shown.method, self.frame(shown))
        self._charted, self._charted_at = shown, time.monotonic()

    def _pause(self) -> float:
        """Seconds between two played iterates."""
        return float(np.clip(PLAY_DURATION_S / max(self._last(self.shown), 1), MIN_FRAME_S, MAX_FRAME_S))

    def _next(self, shown: Shown) -> Shown:
        """Return the state of the next played iterate; the last one stops playing."""
        last = self._last(shown)
        iteration = min(shown.iteration + max(1, round(last * MIN_FRAME_S / PLAY_DURATION_S)), last)
        return replace(shown, iteration=iteration, playing=iteration < last)

    def _last(self, shown: Shown) -> int:
        """Number of the last iterate of the method."""
        return int(self.task.trajectories[shown.method].iteration[-1])

    def _labels(self) -> tuple[str, ...]:
        """Distinct labels of the methods."""
        labels = [run.label for run in self.task.trajectories]
        return tuple(
            label if labels.count(label) == 1 else f"{label} ({number + 1})" for number, label in enumerate(labels)
        )
