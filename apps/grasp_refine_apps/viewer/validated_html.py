"""Simulation result of a grasp as HTML for newcomers."""

from __future__ import annotations

from html import escape
from math import degrees, isnan

from grasp_refine_apps.viewer.validated import DirectionResult, TrialResult

AXIS_COLORS = {"x": "#e03131", "y": "#2f9e44", "z": "#1c7ed6"}
"""Colours of the axes, as frames in the scene have them."""

COLUMNS = {
    "Push": "axis of the object along which it is pushed",
    "Result": "whether the object stayed; if not, why, and when after the push began",
    "Moved": "how far the object was from where it lay, then or at the end",
    "Turned": "by how much it had turned",
    "Links": "links of the hand that still touched it",
}
"""Headers of the table, and their meaning."""

STYLE = """<style>
.gr-trial{font:13px/1.45 system-ui,sans-serif;margin:.3em .9em .5em}
.gr-trial table{font-size:12px}
.gr-trial .gr-verdict{font-weight:600;padding:.45em .7em;border-radius:6px;border-left:5px solid}
.gr-trial .gr-yes{border-color:#1a8a3a;background:rgba(26,138,58,.13)}
.gr-trial .gr-no{border-color:#d6336c;background:rgba(214,51,108,.12)}
.gr-trial .gr-unsure{border-color:#b06a00;background:rgba(176,106,0,.13)}
.gr-trial table{border-collapse:collapse;width:100%;margin:.5em 0 0}
.gr-trial th,.gr-trial td{padding:3px 4px;text-align:right;white-space:nowrap}
.gr-trial th{font-weight:600;border-bottom:1px solid rgba(128,128,128,.5)}
.gr-trial td{border-bottom:1px solid rgba(128,128,128,.18)}
.gr-trial th:nth-child(-n+2),.gr-trial td:nth-child(-n+2){text-align:left}
.gr-trial .gr-held{color:#1a8a3a;font-weight:600}.gr-trial .gr-lost{color:#d6336c;font-weight:600}
</style>"""
"""Style sheet for both colour schemes of the page."""


def trial_html(trial: TrialResult) -> str:
    """Return the verdict as HTML, and a row for each direction if anything was pushed."""
    kind = "gr-unsure" if trial.barely else "gr-yes" if trial.held else "gr-no"
    sign = "✓" if trial.held else "✗"
    table = "" if trial.before_push is not None else _table(trial)
    verdict = f'<div class="gr-verdict {kind}">{sign} {escape(trial.verdict)}</div>'
    return f'{STYLE}<div class="gr-trial">{verdict}{table}</div>'


def notes_html(trial: TrialResult) -> str:
    """Return the conditions of the simulation as HTML."""
    notes = [trial.conditions]
    if not trial.protocol.tabletop:
        farthest, steepest = trial.protocol.farthest * 1e3, degrees(trial.protocol.steepest)
        notes.append(
            f"an object is lost once it moved by {farthest:g} mm or turned by {steepest:g}°; axes are the object's"
        )
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
    color = "#d6336c" if lost else "inherit"
    return f'<div style="font:13px/1.45 system-ui,sans-serif;margin:.2em 1em .4em;color:{color}">{escape(line)}</div>'
