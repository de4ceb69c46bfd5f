"""Panel that refines: start and stop, progress, plots, a timeline of all iterations, and the settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from grasp_refine.core.plurals import count_text
from grasp_refine.measures.measures import COMPARED, CONTACTS_MOVED, DISPLACEMENT
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.table import measure_text
from grasp_refine.results.verdict import HOLDS, should_hold
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.pose import targets_of
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.panels.form import Form, plain
from grasp_refine_apps.viewer.panels.plots import Plot
from grasp_refine_apps.viewer.panels.timeline import Timeline
from grasp_refine_apps.viewer.panels.units import SETTING_UNITS
from grasp_refine_apps.viewer.panels.widgets import in_a_row, on_change, on_click
from grasp_refine_apps.viewer.server.viser_private import Site

FIRST_SETTINGS = ("prefer", "freeze")
"""Settings that are shown; all others are folded away."""
AS_OPENED = "as opened"
"""Label of the task that the grasps came with."""
HIDDEN_SETTINGS = ("device", "dtype")
"""Settings of batches: one grasp is refined on the CPU here."""


class RefinePanel:
    """Widgets of the refinement."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        gui, settings = server.gui, controller.state.settings
        self._controller = controller
        hint = "What the grasp is for: its pushes or its lift set the forces that should balance.\n" + "\n".join(
            f"{name}: {protocol.summary}" for name, protocol in PROTOCOLS.items()
        )
        self.task: Any = gui.add_dropdown("Task", (AS_OPENED, *PROTOCOLS), hint=hint)
        on_change(self.task, self._set_task)
        self.form = Form(
            gui,
            settings,
            lambda settings: controller.set(settings=settings),
            lambda words: controller.notify(words, bad=True),
            check=lambda settings: settings.config(),
            unused=lambda settings: [name for name, _ in settings.unused()],
            first=FIRST_SETTINGS,
            left_out=HIDDEN_SETTINGS,
            units=SETTING_UNITS,
            rest="",
        )
        self.start = gui.add_button(
            "Start", icon=viser.Icon.PLAYER_PLAY, color="green", hint="Refine the grasp that is shown"
        )
        self.stop = gui.add_button(
            "Stop", icon=viser.Icon.PLAYER_STOP, hint="Stop the running job; the hand stays there"
        )
        self.reset = gui.add_button("Reset", icon=viser.Icon.ROTATE, hint="Reset to the input grasp")
        in_a_row(gui, (self.start, self.stop, self.reset))
        self.text = gui.add_markdown("")
        self.bar: Any = gui.add_progress_bar(0.0)
        self.plot = Plot(gui)
        self.slow_draws = (self.plot.draw,)
        self.history: Any = gui.add_folder("Timeline", visible=False)
        with self.history:
            self.timeline = Timeline(gui, controller)
        with gui.add_folder("Step by step", expand_by_default=False):
            self.step = gui.add_button("Step", icon=viser.Icon.PLAYER_TRACK_NEXT, hint="Do one iteration, then wait")
            self.pause = gui.add_button(
                "Pause", icon=viser.Icon.PLAYER_PAUSE, hint="Pause the refinement, or resume it"
            )
            in_a_row(gui, (self.step, self.pause))
        with gui.add_folder("More settings", expand_by_default=False):
            self.form.make_rest()
            self.defaults = gui.add_button("Default settings", icon=viser.Icon.RESTORE, hint="Reset all settings")
        on_click(self.start, controller.refinement.start)
        on_click(self.pause, controller.refinement.pause)
        on_click(self.step, controller.refinement.step)
        on_click(self.stop, controller.stop)
        on_click(self.reset, controller.editor.reset)
        on_click(self.defaults, lambda: controller.set(settings=settings))

    def draw(self, state: State) -> None:
        """Show a state."""
        job = state.job
        refined = job if job is not None and job.kind == "refine" else None
        refining, paused = refined is not None, refined is not None and refined.paused
        busy = job is not None and job.kind not in ("refine", "measure")
        self.start.disabled = busy or (refining and not paused)
        self.pause.disabled = not refining
        self.pause.label = "Resume" if paused else "Pause"
        self.step.disabled = busy
        self.stop.disabled = not (refining or busy)
        self.reset.disabled = not (refining or busy) and _nothing_to_reset(state)
        self.text.content = job_text(state)
        self.bar.value = 0.0 if refined is None else 100.0 * (refined.share or 0.0)
        self.bar.animated = refined is not None and not paused and refined.share is None
        self.timeline.draw(state)
        self.form.show(state.settings)

        self.history.visible = state.trace is not None
        shown = self._task_of(state)
        if self.task.value != shown:
            self.task.value = shown

    def _set_task(self, name: str) -> None:
        """Refine, and then test, for another task."""
        if name not in (AS_OPENED, *PROTOCOLS):
            # Clients can send arbitrary text.
            return
        with self._controller.lock:
            state = self._controller.state
            collection = state.collection.with_protocol(None if name == AS_OPENED else PROTOCOLS[name])
            protocol = state.protocol[0] if name == AS_OPENED else name
            self._controller.set(collection=collection, scene=collection.scene(state.number), protocol=(protocol, None))

    def _task_of(self, state: State) -> str:
        """Label of the task of the shown grasp."""
        protocol = state.scene.task.protocol
        return protocol.name if state.collection.asked is not None and isinstance(protocol, Protocol) else AS_OPENED

    def close(self) -> None:
        """Stop playing."""
        self.timeline.close()


def job_text(state: State) -> str:
    """Text in Markdown on the running job, or on the outcome."""
    job = state.job
    if job is not None and job.kind == "refine":
        return f"**{'Paused' if job.paused else 'Refining'}**: {job.what}"
    if job is not None and job.kind != "measure":
        return f"Busy: {job.what}"
    if state.outcome is not None:
        return outcome_text(state.outcome)
    if state.trace is not None:
        return "Stopped, or moved since. **Start** refines from the present pose."
    return "**Start** moves the hand until its links touch the object as they should and it holds."


def outcome_text(outcome: Outcome) -> str:
    """Text in Markdown on the outcome of one grasp: status, advice, and a table before and after."""
    status = Status(outcome.status[0])
    rows = (
        (measure.headline, [measure_text(measure, value) for value in outcome[measure.name][0]])
        for measure in COMPARED
        # Settings of scenes and arms are known only where there is one.
        if not (np.isnan(outcome[measure.name][0]).all() and outcome.usable[0])
    )
    table = "\n".join(f"| {name} | {before} | **{after}** |" for name, (before, after) in rows)
    count, seconds = int(outcome["iterations"][0]), float(outcome["wall_s"][0])
    tries = f" from {starts} starts" if (starts := outcome["starts"][0]) > 1 else ""
    head = f"**{status.label.capitalize()}** after {count_text(count, 'iteration')}{tries}, {seconds:.1f} s"
    if outcome.usable[0]:
        moved = (f"{one.title} {measure_text(one, outcome[one.name][0])} mm" for one in (DISPLACEMENT, CONTACTS_MOVED))
        verdict = "Should hold" if should_hold(outcome.quality[:, 1])[0] else "May slip"
        gap = f", with a gap of {outcome.gap[0]}" if outcome.gap[0] else ""
        head = (
            f"**{verdict}**{gap}: by its quality, an estimate (from {HOLDS:.3f} on); **Validate** tests it\n\n"
            f"Change: **{outcome.change[0]}** ({', '.join(moved)})\n\n{head}"
        )
    advice = f"\n\n{plain(status.advice)}" if status.advice else ""
    return f"{head}{advice}\n\n| | before | after |\n|:---|---:|---:|\n{table}"


def _nothing_to_reset(state: State) -> bool:
    """Return whether there is nothing to reset."""
    return (
        state.trace is None
        and np.array_equal(state.T_world_object, state.collection.T_world_object(state.number))
        and state.pose.same(state.initial)
        and [target.values for target in state.targets] == [target.values for target in targets_of(state.scene)]
    )
