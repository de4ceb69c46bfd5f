"""HTML texts of an alignment task: introduction, present iterate, and result of each method."""

from __future__ import annotations

from html import escape

import numpy as np

from grasp_refine.core.se3 import transform_points
from grasp_refine_apps.bench.align.saved import AlignmentTask
from grasp_refine_apps.viewer.alignment_chart import SOLVED_DISTANCE_M, css
from grasp_refine_apps.viewer.alignment_scene import BODY_COLORS, POINT_COLORS, method_color
from grasp_refine_apps.viewer.colors import distance_legend

STYLE = """<style>
.ga{font:12.5px/1.45 system-ui,sans-serif;margin:.2em 1em .6em}
.ga table{border-collapse:collapse;width:100%}
.ga td,.ga th{padding:1px 4px;text-align:right;vertical-align:top;white-space:nowrap}
.ga td:first-child,.ga th:first-child{text-align:left;white-space:normal}
.ga p{margin:.1em 0 .5em;opacity:.75;font-size:12px}
.ga th{font-weight:600;border-bottom:1px solid rgba(128,128,128,.5)}
.ga tr.on td{background:rgba(34,139,230,.16);font-weight:600}
.ga i{display:inline-block;width:.8em;height:.8em;border-radius:2px;margin-right:.45em}
.ga i.dot{border-radius:50%}
.ga i.ball{border-radius:50%;opacity:.35}
.ga i.bar{height:.25em;vertical-align:middle;width:1.1em}
.ga .yes{color:#1a7f37;font-weight:600}.ga .no{color:#c2410c;font-weight:600}
</style>"""
"""Style sheet for light and dark pages; included once per page, since browsers are slow to apply it."""


def intro(task: AlignmentTask) -> str:
    """Introduction to the task for newcomers."""
    on_a, _, on_b = task.target_class.partition("-")
    a, b = (
        f"{_swatch('', color)}{letter} ({escape(body.name)})"
        for color, letter, body in zip(BODY_COLORS, "AB", task.bodies, strict=True)
    )
    return _page(
        f"<b>Two bodies are to touch at a given point of each.</b> Body {a} rests. Each method moves body {b} until "
        f"the points where the bodies are closest (dots) lie in the targets (spheres): on a {escape(on_a)} of A, and a "
        f"{escape(on_b)} of B."
    )


def where(task: AlignmentTask, method: int, frame: int) -> str:
    """Distance, misses and error of one iterate."""
    run = task.trajectories[method]
    head = f"<b>Iteration {run.iteration[frame]}</b> of {run.iteration[-1]}, after {_time(run.cpu_s[frame])} of CPU"
    if not np.isfinite(run.error[frame]):
        return _page(f"{head}<br>The collision query has no result for these poses.")
    misses = np.linalg.norm(run.witness[frame] - transform_points(run.poses[frame], task.targets), axis=1)
    d = run.distance[frame]
    goal = f" (goal: {mm(run.margin)})" if run.margin else ""
    rows = [
        ("B is inside A by" if d < 0 else "Gap between A and B", f"{mm(abs(d))}{goal}"),
        ("A: closest point to target", mm(misses[0])),
        ("B: closest point to target", mm(misses[1])),
        ("Error, all three together", f"{mm(np.sqrt(run.error[frame]))} {_verdict(run.error[frame])}"),
    ]
    lines = "".join(f"<tr><td>{what}</td><td>{value}</td></tr>" for what, value in rows)
    return _page(f"{head}<table>{lines}</table>")


def results(task: AlignmentTask, method: int) -> str:
    """A table of the methods, with their colours in the chart."""
    rows = []
    for number, run in enumerate(task.trajectories):
        best = run.error[run.result]
        rows.append(
            f"<tr{' class=on' if number == method else ''}><td>{_swatch('bar', method_color(number))}"
            f"{escape(run.label)}</td><td>{_error(best)}</td><td>{run.iteration[run.result]}</td>"
            f"<td>{_time(run.cpu_s[-1])}</td></tr>"
        )
    head = "<tr><th>Method</th><th>Best error</th><th>at</th><th>CPU</th></tr>"
    note = "Thick: the method that is shown; pale: each of its iterates. Below 1 mm (dashed) a task counts as solved."
    return _page(f"<p>{note}</p><table>{head}{''.join(rows)}</table>")


def legend() -> str:
    """Legend of colours and shapes in the scene."""
    rows = [
        (_swatch("", BODY_COLORS[0]) + _swatch("", BODY_COLORS[1]), "bodies A and B"),
        (_swatch("ball", POINT_COLORS[0]) + _swatch("ball", POINT_COLORS[1]), "targets on A and on B"),
        (_swatch("dot", POINT_COLORS[0]) + _swatch("dot", POINT_COLORS[1]), "closest points of A and of B"),
        (_swatch("bar", POINT_COLORS[0]) + _swatch("bar", POINT_COLORS[1]), "from there to the targets"),
        (_swatch("bar", method_color(0)), "thin: the last steps of the target on B"),
    ]
    lines = "".join(f"<tr><td>{marks}</td><td style='text-align:left'>{words}</td></tr>" for marks, words in rows)
    gap = "".join(f"<div>{_swatch('bar', color)}{words}</div>" for words, color in distance_legend())
    return _page(f"<table>{lines}</table>Line between the closest points, by their distance:{gap}")


def mm(metres: float) -> str:
    """Length in mm as text, with more digits for small values; `metres` in metres."""
    value = 1e3 * metres
    if value >= 9.95:
        return f"{value:.0f} mm" if value >= 99.5 else f"{value:.1f} mm"
    return f"{value:.2g} mm" if value >= 1e-3 else "&lt; 0.001 mm"


def _error(error: float) -> str:
    return mm(np.sqrt(error)) if np.isfinite(error) else "none"


def _verdict(error: float) -> str:
    solved = error < SOLVED_DISTANCE_M**2
    return f'<span class="{"yes" if solved else "no"}">{"solved" if solved else "not solved"}</span>'


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 0.9995 else f"{seconds:.1f} s"


def _swatch(kind: str, color: tuple[int, int, int]) -> str:
    return f'<i class="{kind}" style="background:{css(color)}"></i>'


def _page(body: str) -> str:
    return f'<div class="ga">{body}</div>'
