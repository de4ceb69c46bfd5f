"""Draw the plots of the benchmarks page out of JSON files that `refine-grasp bench` wrote.

    refine-grasp bench success ... --json success.json
    refine-grasp bench align ... --json align.json
    refine-grasp bench queries ... --json queries.json
    python docs/plots.py success.json align.json queries.json

The commands in full stand on the page. The plots are SVG files in `docs/pages/figures`.
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
SOLVERS = {
    "closed-form": "closed form alone",
    "levenberg-marquardt": "Levenberg-Marquardt",
    "closed-form-first": "the same, closed form first",
}
"""Solver of `bench align` -> its name in the plot; descent has those of its derivatives."""


def hold(rows: list[dict[str, Any]], axes: Any) -> None:
    """Draw the share of grasps that hold, by method, at both frictions."""
    rows = [row for row in rows if row["by"] == "all"]
    for offset, key, label, color in (
        (-0.2, "success_dexgraspbench", "friction 0.6", BLUE),
        (0.2, "success_strict", "friction 0.3", ORANGE),
    ):
        bars = axes.bar([i + offset for i in range(len(rows))], [100 * row[key] for row in rows], 0.38, color=color)
        bars.set_label(label)
        axes.bar_label(bars, fmt="%.0f", fontsize=8)
    names = {"as given": "input", "own stages": "own pregrasp, squeeze"}
    labels = [names.get(row["refined"], row["refined"]) for row in rows]
    times = [f"{1e3 * row['cpu_mean_s']:.0f} ms" if row["cpu_mean_s"] else "" for row in rows]
    labels = [f"{label}\n{time}" for label, time in zip(labels, times, strict=True)]
    axes.set_xticks(range(len(rows)), labels, fontsize=8)
    axes.set(ylabel="grasps that hold, %", ylim=(0, 108))
    axes.legend(frameon=False, ncols=2, loc="upper left", fontsize=8)


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


def main(paths: list[str]) -> None:
    """Draw the plots of three files, named in the docstring of this module."""
    documents = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
    plt.rcParams |= {
        "svg.hashsalt": "", "svg.fonttype": "none", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False
    }  # fmt: skip
    plots = {"hold": (hold, (7.5, 3.2), 1), "align": (align, (8.6, 3.0), 2), "queries": (queries, (8.6, 3.2), 1)}
    for (name, (draw, size, columns)), document in zip(plots.items(), documents, strict=True):
        figure, axes = plt.subplots(1, columns, figsize=size, layout="constrained")
        draw(document["rows"], axes)
        figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
