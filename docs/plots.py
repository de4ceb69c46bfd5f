"""Draw the plots of the benchmarks page out of JSON files that `refine-grasp bench` wrote.

    refine-grasp bench success ... --json success.json
    refine-grasp bench align ... --json align.json
    refine-grasp bench queries ... --json queries.json
    python docs/plots.py hold=success.json align=align.json queries=queries.json

The commands in full stand on the page. The plots are SVG files in `docs/pages/figures`. The rows of the front are kept:

    refine-grasp bench success --methods as-given closest balanced strongest ... --json success.json
    jq '{rows: [.rows[] | select(.by == "all")]}' success.json > docs/front.json
    python docs/plots.py front=docs/front.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.ticker

matplotlib.use("svg")
import matplotlib.pyplot as plt  # noqa: E402

FIGURES = Path(__file__).parent / "pages" / "figures"
BLUE, ORANGE = "#2b5c9e", "#d98a2b"
PROTOCOLS = (("dexgraspbench", "friction 0.6", BLUE), ("strict", "friction 0.3", ORANGE))
"""Protocols of the plots of success, their names and colours."""
SOLVERS = {
    "closed-form": "closed form alone",
    "levenberg-marquardt": "Levenberg-Marquardt",
    "closed-form-first": "the same, closed form first",
}
"""Solver of `bench align` -> its name in the plot; descent has those of its derivatives."""


def hold(rows: list[dict[str, Any]], axes: Any) -> None:
    """Draw the share of grasps that hold, by method, at both frictions."""
    rows = [row for row in rows if row["by"] == "all"]
    for offset, (protocol, label, color) in zip((-0.2, 0.2), PROTOCOLS, strict=True):
        heights = [100 * row[f"success_{protocol}"] for row in rows]
        bars = axes.bar([i + offset for i in range(len(rows))], heights, 0.38, color=color)
        bars.set_label(label)
        axes.bar_label(bars, fmt="%.0f", fontsize=8)
    names = {"as given": "input", "own stages": "own pregrasp, squeeze"}
    labels = [names.get(row["refined"], row["refined"]) for row in rows]
    times = [f"{1e3 * row['cpu_mean_s']:.0f} ms" if row["cpu_mean_s"] else "" for row in rows]
    labels = [f"{label}\n{time}" for label, time in zip(labels, times, strict=True)]
    axes.set_xticks(range(len(rows)), labels, fontsize=8)
    axes.set(ylabel="grasps that hold, %", ylim=(0, 108))
    axes.legend(frameon=False, ncols=2, loc="upper left", fontsize=8)


def front(rows: list[dict[str, Any]], axes: Any) -> None:
    """Draw the share of grasps that hold over their displacement, median and up to the 90th percentile, by method."""
    rows = [row for row in rows if row["by"] == "all"]
    for axis, (protocol, title, _) in zip(axes, PROTOCOLS, strict=True):
        for number, row in enumerate(rows):
            median, most = (1e3 * (row[f"displacement_{key}_m"] or 0.0) for key in ("median", "q90"))
            name = "input" if row["method"] == "as-given" else row["refined"]
            axis.errorbar(
                [median], [100 * row[f"success_{protocol}"]], xerr=[[0.0], [most - median]], fmt="osD^v"[number % 5],
                ms=6, elinewidth=1.0, capsize=3, label=name, zorder=3 - 0.1 * number,
            )  # fmt: skip
        axis.set(xlabel="displacement, mm", ylabel="grasps that hold, %", title=title, xlim=(-2, None), ylim=(35, 101))
    axes[1].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def align(rows: list[dict[str, Any]], axes: Any) -> None:
    """Draw accuracy over CPU time of each method; one axis for convex bodies, one for concave ones."""
    for axis, kind in zip(axes, ("convex", "concave"), strict=True):
        curves: dict[str, list[dict[str, Any]]] = {}
        for row in rows:
            if (row["kind"], row["pair"], row["target_class"], row["witness"]) == (kind, "all", "all", "plain"):
                curves.setdefault(SOLVERS.get(row["solver"]) or f"descent, {row['method']}", []).append(row)
        for name, points in curves.items():
            points.sort(key=lambda row: row["budget"])
            style = {"color": BLUE, "linewidth": 2.2} if name == SOLVERS["levenberg-marquardt"] else {"linewidth": 1.3}
            axis.plot(
                [row["cpu_s_per_pair"] for row in points], [100 * row["acc_1e6"] for row in points], "o-", ms=4,
                label=name, **style,
            )  # fmt: skip
        axis.set(xscale="log", xlabel="CPU s per pair of bodies", ylabel="Acc@1e-6, %", ylim=(-3, 103), title=kind)
        _plain(axis.xaxis)
    axes[1].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def queries(rows: list[dict[str, Any]], axes: Any) -> None:
    """Draw the time of a witness query by engine."""
    rows = [row for row in rows if row["table"] == "queries" and not row["warm"]]
    cases = list(dict.fromkeys((row["kind"], row["pieces"], row["state"]) for row in rows))
    engines = ["native", "coal-reused", "coal-fresh", "mujoco", "python"]
    engines = [engine for engine in engines if any(row["by"] == engine for row in rows)]
    for number, engine in enumerate(engines):
        times = [
            next((r["forward_us"] for r in rows if (r["kind"], r["pieces"], r["state"], r["by"]) == (*case, engine)), 0)
            for case in cases
        ]
        bars = axes.bar([i + 0.16 * (number - 2) for i in range(len(cases))], times, 0.15)
        bars.set_label({"native": "grasp-refine", "python": "grasp-refine, without compiler"}.get(engine, engine))
        axes.bar_label(bars, fmt="%.2g", fontsize=7)
    labels = [f"{kind}, {pieces} {'piece' if pieces == 1 else 'pieces'}\n{state}" for kind, pieces, state in cases]
    axes.set_xticks(range(len(cases)), labels, fontsize=8)
    axes.set(yscale="log", ylabel="CPU µs per query", ylim=(1, 100))
    _plain(axes.yaxis)
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _plain(axis: Any) -> None:
    """Write the ticks of a logarithmic axis as numbers, and only those of decades."""
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(matplotlib.ticker.NullFormatter())


PLOTS = {
    "hold": (hold, (7.5, 3.2), 1),
    "front": (front, (8.6, 3.0), 2),
    "align": (align, (8.6, 3.0), 2),
    "queries": (queries, (8.6, 3.2), 1),
}
"""Name of a plot -> how it is drawn, its size in inches and its columns."""


def main(named: list[str]) -> None:
    """Draw plots of files, each PLOT=FILE, as in the docstring of this module."""
    plt.rcParams |= {
        "svg.hashsalt": "", "svg.fonttype": "none", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False
    }  # fmt: skip
    for name, _, path in (text.partition("=") for text in named):
        draw, size, columns = PLOTS[name]
        figure, axes = plt.subplots(1, columns, figsize=size, layout="constrained")
        draw(json.loads(Path(path).read_text(encoding="utf-8"))["rows"], axes)
        figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
