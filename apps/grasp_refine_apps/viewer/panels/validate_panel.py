"""Panel that tests the grasp in MuJoCo, reports each direction, and replays it."""

from __future__ import annotations

import threading
from html import escape
from math import degrees, isnan
from typing import Any

import numpy as np
import viser

from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.validation.replay.live_pull import MAX_PULL_N
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.replaying import FRAME_RATE_HZ
from grasp_refine_apps.viewer.jobs.validating import MAX_FRICTION
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.state import Job, State
from grasp_refine_apps.viewer.model.validated import DirectionResult, TrialResult
from grasp_refine_apps.viewer.panels.play_bar import PlayBar
from grasp_refine_apps.viewer.panels.widgets import in_a_row, on_change, on_choice, on_click
from grasp_refine_apps.viewer.server.viser_private import Site, pages_of

AXIS_COLORS = {"x": "#e03131", "y": "#2f9e44", "z": "#1c7ed6"}
"""Colours of the axes, as frames in the scene have them."""

COLUMNS = {
    "Push": "axis of the object along which it is pushed",
    "Result": "whether the object stayed; if not, why, and when after the push began",
    "Moved": "how far the object was from where it lay, then or at the end",
    "Rotated": "by how much it had rotated",
    "Links": "links of the hand that still touched it",
}
"""Headers of the table, and their meaning."""

STYLE = """<style>
.gr-trial{font:13px/1.45 system-ui,sans-serif;margin:.3em .9em .5em}
.gr-trial table{font-size:12px}
.gr-trial .gr-verdict{font-weight:600;padding:.45em .7em;border-radius:6px;border-left:5px solid}
.gr-trial .gr-yes{border-color:var(--gr-good);background:rgba(26,138,58,.13)}
.gr-trial .gr-no{border-color:var(--gr-bad);background:rgba(214,51,108,.12)}
.gr-trial .gr-unsure{border-color:var(--gr-unsure);background:rgba(176,106,0,.13)}
.gr-trial table{border-collapse:collapse;width:100%;margin:.5em 0 0}
.gr-trial th,.gr-trial td{padding:3px 4px;text-align:right;white-space:nowrap}
.gr-trial th{font-weight:600;border-bottom:1px solid rgba(128,128,128,.5)}
.gr-trial td{border-bottom:1px solid rgba(128,128,128,.18)}
.gr-trial th:nth-child(-n+2),.gr-trial td:nth-child(-n+2){text-align:left}
.gr-trial .gr-held{color:var(--gr-good);font-weight:600}.gr-trial .gr-lost{color:var(--gr-bad);font-weight:600}
</style>"""
"""Style sheet for both colour schemes of the page."""


class ValidatePanel:
    """Widgets for one trial, for its replay, and for a live pull."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self._lock = threading.RLock()
        self._trial: TrialResult | None = None
        self._motion: Recording | None = None

        gui = server.gui
        hint = "; ".join(f"{name}: {protocol.summary}" for name, protocol in PROTOCOLS.items())
        self.protocol = gui.add_dropdown(
            "Protocol", tuple(PROTOCOLS), initial_value=controller.state.protocol[0], hint=hint
        )
        self.friction: Any = gui.add_number(
            "Friction",
            PROTOCOLS[self.protocol.value].friction,
            min=0.01,
            max=MAX_FRICTION,
            step=0.01,
            hint="Coefficient of sliding friction of all contacts; the protocol chosen above has its own",
        )
        self.test = gui.add_button("Test in MuJoCo", hint="Simulate whether the grasp that is shown holds the object")
        self.plan = gui.add_button(
            "Plan the trajectory",
            hint="Approach, grasp and lift: report obstacles, and play the motion as far as it is known",
        )
        in_a_row(gui, (self.test, self.plan))
        self.pull = gui.add_button(
            "Pull live",
            icon=viser.Icon.HAND_GRAB,
            hint="Simulate the grasp while you drag the object, or pull it with a steady force: does it hold?",
        )
        self.newtons: Any = gui.add_slider(
            "Pull, N", 0.0, MAX_PULL_N, 0.1, 0.0, visible=False, hint="Steady force at the object's centre of mass"
        )
        self.along: Any = gui.add_dropdown(
            "Along", tuple(AXES), visible=False, hint="Axis of the object, as it was before the hand closed"
        )
        self.bar: Any = gui.add_progress_bar(0.0, visible=False)
        self.doing = gui.add_html("", visible=False)
        self.stop = gui.add_button("Stop", visible=False, hint="End the simulation")
        self.result = gui.add_html(trial_html(None))
        self.trajectory = gui.add_html("", visible=False)
        self.watch = gui.add_button_group(
            "Watch", ("+x",), visible=False, hint="Play the simulation of a push along this axis of the object"
        )
        self.line = gui.add_html("", visible=False)
        self.slider = gui.add_slider("Seconds", 0.0, 1.0, 1.0 / FRAME_RATE_HZ, 0.0, hint="Time in the replay")
        self.replay = PlayBar(gui, self.slider, self._shown, controller.player.show_frame)
        self.replay.set_visible(False)
        self.end = gui.add_button("Close replay", visible=False, hint="Back to the grasp")
        self.notes = gui.add_html("")
        on_change(self.protocol, self._choose)
        on_change(self.friction, lambda friction: self._set_protocol())
        on_click(self.test, controller.simulation.test)
        on_click(self.plan, controller.simulation.plan_trajectory)
        on_click(self.pull, controller.simulation.pull)
        for widget in (self.newtons, self.along):
            on_change(
                widget,
                lambda value: controller.simulation.pull_steadily(float(self.newtons.value), str(self.along.value)),
            )
        on_click(self.stop, controller.stop)
        on_choice(self.watch, controller.simulation.record)
        on_click(self.end, self._end)

    def close(self) -> None:
        """Stop playing."""
        self.replay.close()

    def draw(self, state: State) -> None:
        """Show a state."""
        with self._lock:
            self._draw_job(state.job)
            self._draw_trial(state.trial)
            self._draw_trajectory(state.work.plan)
            self._draw_motion(state.motion, state.motion_frame)

    def _choose(self, protocol: str) -> None:
        """Choose another protocol, with its friction."""
        self.friction.value = PROTOCOLS[protocol].friction
        self._set_protocol()

    def _set_protocol(self) -> None:
        """Choose the protocol of the next simulations, and their friction."""
        self._controller.set(protocol=(self.protocol.value, self._other_friction()))

    def _other_friction(self) -> float | None:
        """The coefficient of friction; None where it is that of the protocol."""
        own, friction = PROTOCOLS[self.protocol.value].friction, float(self.friction.value)
        return None if abs(friction - own) < 1e-9 else friction

    def _shown(self) -> tuple[Recording | None, int]:
        """The simulation, and the number of its shown frame."""
        state = self._controller.state
        return state.motion, state.motion_frame

    def _end(self) -> None:
        """Return to the grasp."""
        self.replay.pause()
        self._controller.player.show(None)

    def _draw_job(self, job: Job | None) -> None:
        """Show the progress of a simulation."""
        ours = job is not None and job.kind in ("validate", "plan", "replay", "pull")
        self.test.disabled = self.plan.disabled = self.pull.disabled = job is not None and job.kind != "measure"
        self.doing.visible = self.stop.visible = ours
        pulling = job is not None and job.kind == "pull"
        # The closing of the hand has a share, the pull has no end.
        self.bar.visible = ours and not (pulling and job is not None and job.share is None)
        if pulling != self.newtons.visible:
            self.newtons.value = 0.0
            self.newtons.visible = self.along.visible = pulling
        if ours and job is not None:
            self.bar.value = round(100.0 * (job.share or 0.0))
            self.doing.content = motion_html(f"{job.what} …", lost=False)

    def _draw_trial(self, trial: TrialResult | None) -> None:
        """Show the verdict, and the directions that can be watched."""
        if trial is self._trial:
            return
        self._trial = trial
        self.result.content = trial_html(trial)
        self.notes.content = "" if trial is None else notes_html(trial)
        if trial is not None:
            self.watch.options = trial.directions
        self.watch.visible = trial is not None and trial.watchable

    def _draw_trajectory(self, plan: Recording | None) -> None:
        """Show the trajectory as far as it is known."""
        self.trajectory.visible = plan is not None
        if plan is not None:
            self.trajectory.content = motion_html(_sentence(plan.summary), lost=not plan.succeeds)

    def _draw_motion(self, motion: Recording | None, frame: int) -> None:
        """Show the text of a frame; a new motion is played at once, if a browser is connected."""
        live = motion is not None and motion.live
        new = motion is not self._motion and not (live and self._motion is not None and self._motion.live)
        if new:
            self._motion = motion
            self.replay.pause()
            self.end.visible = motion is not None
            # The heading also describes the frames of a trajectory; obstacles stand above.
            self.line.visible = motion is not None and not motion.summary
            self.replay.set_visible(motion is not None and not live)
        if motion is None:
            return
        self.line.content = motion_html(motion.text(frame), lost=motion.is_lost(frame))
        if live:
            return
        self.replay.draw(np.round(motion.time - motion.time[0], 2), frame)
        if new and pages_of(self._server):
            self.replay.play()


def trial_html(trial: TrialResult | None) -> str:
    """Return the verdict as HTML, and a row for each direction if anything was pushed; None: not simulated."""
    if trial is None:
        return motion_html("Not tested yet.", lost=False)
    kind = "gr-unsure" if trial.barely else "gr-yes" if trial.held else "gr-no"
    sign = "✓" if trial.held else "✗"
    table = "" if trial.before_push is not None else _table(trial)
    verdict = f'<div class="gr-verdict {kind}">{sign} {escape(trial.verdict)}</div>'
    return f'{STYLE}<div class="gr-trial">{verdict}{table}</div>'


def notes_html(trial: TrialResult) -> str:
    """Return the conditions of the simulation as HTML."""
    notes = [trial.conditions]
    if trial.margins is not None:
        notes.insert(0, f"margins: {trial.margins.text}")
    if not trial.protocol.tabletop:
        bounds = " or rotated by ".join(trial.protocol.bounds()).replace(" degrees", "°")
        notes.append(f"an object is lost once it moved by {bounds}; axes are the object's")
    if trial.closed_by:
        notes.append(trial.closed_by)
    lines = "<br>".join(escape(_sentence(note)) for note in notes)
    return f'<div style="font:12px/1.4 system-ui,sans-serif;margin:.3em 1.1em .8em;opacity:.75">{lines}</div>'


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _table(trial: TrialResult) -> str:
    head = "".join(f'<th title="{hint}">{label}</th>' for label, hint in COLUMNS.items())
    body = "".join(_row(trial, result) for result in trial.results)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _row(trial: TrialResult, result: DirectionResult) -> str:
    cell = (
        '<td class="gr-held">✓ held</td>'
        if result.held
        else f'<td class="gr-lost">✗ {escape(result.reason.label + result.when)}</td>'
    )
    numbers = "".join(f"<td>{text}</td>" for text in (_moved(result), _turned(result), len(result.links)))
    return f'<tr title="{escape(trial.words(result))}"><td>{_arrow(result.direction)}</td>{cell}{numbers}</tr>'


def _moved(result: DirectionResult) -> str:
    return "–" if isnan(result.displacement_m) else f"{result.displacement_m * 1e3:.1f} mm"


def _turned(result: DirectionResult) -> str:
    return "–" if isnan(result.angle_rad) else f"{degrees(result.angle_rad):.1f}°"


def _arrow(direction: str) -> str:
    """The direction in the colour of its axis."""
    color = AXIS_COLORS.get(direction[-1:], "inherit") if direction[:1] in "+-" else "inherit"
    return f'<b style="color:{color}">{escape(direction)}</b>'


def motion_html(line: str, *, lost: bool) -> str:
    """Return the text of a frame of a motion as HTML; in red where the object is lost."""
    color = "var(--gr-bad)" if lost else "inherit"
    return f'<div style="font:13px/1.45 system-ui,sans-serif;margin:.2em 1em .4em;color:{color}">{escape(line)}</div>'
