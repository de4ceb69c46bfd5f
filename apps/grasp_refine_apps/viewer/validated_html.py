"""What simulation said of a grasp, as HTML for people who never saw the program."""

from __future__ import annotations

from html import escape
from math import degrees, isnan

from grasp_refine_apps.viewer.validated import TrialResult, Tried

AXIS_COLORS = {"x": "#e03131", "y": "#2f9e44", "z": "#1c7ed6"}
"""Colours of the axes, as frames in the scene have them."""

COLUMNS = {
    "Push": "axis of the object along which it is pushed",
    "Result": "whether the object stayed; if not, why, and when after the push began",
    "Moved": "how far the object was from where it lay, then or at the end",
    "Turned": "by how much it had turned",
    "Links": "links of the hand that still touched it",
}
"""Headers of the table, and what they mean."""

STYLE = """<style>
.gr-proof{font:13px/1.45 system-ui,sans-serif;margin:.3em .9em .5em}
.gr-proof table{font-size:12px}
.gr-proof .gr-verdict{font-weight:600;padding:.45em .7em;border-radius:6px;border-left:5px solid}
.gr-proof .gr-yes{border-color:#1a8a3a;background:rgba(26,138,58,.13)}
.gr-proof .gr-no{border-color:#d6336c;background:rgba(214,51,108,.12)}
.gr-proof .gr-unsure{border-color:#b06a00;background:rgba(176,106,0,.13)}
.gr-proof table{border-collapse:collapse;width:100%;margin:.5em 0 0}
.gr-proof th,.gr-proof td{padding:3px 4px;text-align:right;white-space:nowrap}
.gr-proof th{font-weight:600;border-bottom:1px solid rgba(128,128,128,.5)}
.gr-proof td{border-bottom:1px solid rgba(128,128,128,.18)}
.gr-proof th:nth-child(-n+2),.gr-proof td:nth-child(-n+2){text-align:left}
.gr-proof .gr-held{color:#1a8a3a;font-weight:600}.gr-proof .gr-lost{color:#d6336c;font-weight:600}
</style>"""
"""How it looks, in both colour schemes of the page."""


def trial_html(proved: TrialResult) -> str:
    """The verdict, and a row for each direction if anything was pushed."""
    kind = "gr-unsure" if proved.barely else "gr-yes" if proved.held else "gr-no"
    sign = "✓" if proved.held else "✗"
    table = "" if proved.before_push is not None else _table(proved)
    verdict = f'<div class="gr-verdict {kind}">{sign} {escape(proved.verdict)}</div>'
    return f'{STYLE}<div class="gr-proof">{verdict}{table}</div>'


def notes_html(proved: TrialResult) -> str:
    """How it was tested."""
    notes = [proved.conditions]
    if not proved.protocol.tabletop:
        farthest, steepest = proved.protocol.farthest * 1e3, degrees(proved.protocol.steepest)
        notes.append(f"lost is what moved by {farthest:g} mm or turned by {steepest:g}°; axes are those of the object")
    if proved.closed_by:
        notes.append(proved.closed_by)
    lines = "<br>".join(escape(_sentence(note)) for note in notes)
    return f'<div style="font:12px/1.4 system-ui,sans-serif;margin:.3em 1.1em .8em;opacity:.75">{lines}</div>'


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _table(proved: TrialResult) -> str:
    head = "".join(f'<th title="{hint}">{label}</th>' for label, hint in COLUMNS.items())
    body = "".join(_row(proved, tried) for tried in proved.tried)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _row(proved: TrialResult, tried: Tried) -> str:
    result = (
        '<td class="gr-held">✓ held</td>'
        if tried.held
        else f'<td class="gr-lost">✗ {escape(tried.reason.label + tried.when)}</td>'
    )
    numbers = "".join(f"<td>{text}</td>" for text in (_moved(tried), _turned(tried), len(tried.links)))
    return f'<tr title="{escape(proved.words(tried))}"><td>{_arrow(tried.direction)}</td>{result}{numbers}</tr>'


def _moved(tried: Tried) -> str:
    return "–" if isnan(tried.displacement_m) else f"{tried.displacement_m * 1e3:.1f} mm"


def _turned(tried: Tried) -> str:
    return "–" if isnan(tried.angle_rad) else f"{degrees(tried.angle_rad):.1f}°"


def _arrow(direction: str) -> str:
    """The direction in the colour of its axis."""
    color = AXIS_COLORS.get(direction[-1:], "inherit") if direction[:1] in "+-" else "inherit"
    return f'<b style="color:{color}">{escape(direction)}</b>'


def motion_html(line: str, *, lost: bool) -> str:
    """What is to be seen in a frame of a motion; in red where the object is lost."""
    color = "#d6336c" if lost else "inherit"
    return f'<div style="font:13px/1.45 system-ui,sans-serif;margin:.2em 1em .4em;color:{color}">{escape(line)}</div>'
